"""The command `edges`: what it writes of images and logs, what is wrong with bad input."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from edge_images import camera_of, wall_image
from short_log import CORRIDOR, Localiser, cut_log
from small_log import write_edge_log

from localiser.calibration import LogMount
from localiser.camera import Camera
from localiser.commands.edge_search import EdgeSearch
from localiser.config import Config
from localiser.storage import read_camera, write_camera

BEARINGS_DEG = np.array([-21.0, -6.0, 4.0, 19.0])
GREYS = [60, 170, 90, 200, 110]
CAMERA = camera_of(320, 240, tilt_deg=20.0, k1=-0.2)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with three images of a wall on a floor and the camera that took them."""
    write_camera(CAMERA, tmp_path / "camera.yaml")
    for index in range(3):
        image = wall_image(CAMERA, BEARINGS_DEG, GREYS, wall_ahead_m=2.0, noise_sigma=2.0, seed=index)
        cv2.imwrite(str(tmp_path / f"{index}.png"), image)
    return tmp_path


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows])


def run(localiser: Localiser, folder: Path, *arguments: object, pictures: bool = False) -> Path:
    out = folder / "out"
    drawn = "--pictures" if pictures else "--no-pictures"
    result = localiser("edges", *arguments, "--camera", folder / "camera.yaml", "--out", out, drawn)
    assert result.exit_code == 0, result.err
    return out


# -- what is written --------------------------------------------------------------------------------------------------


def test_help_has_an_example(localiser: Localiser) -> None:
    result = localiser("edges", "--help")
    assert result.exit_code == 0
    assert "localiser edges" in result.out.split("Examples")[1]


def test_the_table_holds_the_true_edges_from_left_to_right(localiser: Localiser, folder: Path) -> None:
    rows = table(run(localiser, folder, folder / "0.png") / "edges.csv")
    assert [row["edge"] for row in rows] == ["1", "2", "3", "4"]
    bearing, lean = column(rows, "bearing_rad"), column(rows, "lean_rad")
    assert np.rad2deg(bearing) == pytest.approx(BEARINGS_DEG, abs=0.05)
    assert np.abs(np.rad2deg(bearing) - BEARINGS_DEG).max() < 6 * np.rad2deg(column(rows, "bearing_sigma_rad")).max()
    assert [int(row["polarity"]) for row in rows] == [1, -1, 1, -1]
    # [Taylor06] eq. 7: m = 1 / (s tan b), shown as the angle of the line from the image's horizontal.
    slope = 1 / (np.sin(CAMERA.mount.tilt_rad) * np.tan(np.deg2rad(BEARINGS_DEG)))
    assert column(rows, "slope_deg") == pytest.approx(np.rad2deg(np.arctan(slope)) % 180, abs=0.5)
    assert np.tan(np.deg2rad(column(rows, "slope_deg"))) == pytest.approx(column(rows, "slope"))
    assert 1 / np.tan(lean) == pytest.approx(column(rows, "slope"))
    # The wall's foot is a line 2 m ahead.
    assert column(rows, "foot_range_m") == pytest.approx(2.0 / np.cos(np.deg2rad(BEARINGS_DEG)), rel=0.05)
    assert column(rows, "foot_back_m") == pytest.approx(np.full(4, -2.0), rel=0.05)
    assert column(rows, "foot_right_m") == pytest.approx(2.0 * np.tan(np.deg2rad(BEARINGS_DEG)), rel=0.05)
    ends = np.stack([column(rows, name) for name in ("bottom_u_px", "bottom_v_px", "top_u_px", "top_v_px")], axis=-1)
    assert CAMERA.bearing_of_segments(ends.reshape(-1, 2, 2)) == pytest.approx(bearing, abs=2e-3)


def test_the_picture_shows_what_was_found(localiser: Localiser, folder: Path) -> None:
    one = cv2.imread(str(run(localiser, folder, folder / "0.png", pictures=True) / "0.png"))
    assert one.shape[1] >= 1000  # a small image is drawn larger
    blue = (one[..., 0].astype(int) - one[..., 2]) > 60  # certain edges are blue, the image is grey
    assert blue.any(axis=0)[100:-100].sum() > 20
    shutil.rmtree(folder / "out")
    plain = folder / "plain.png"
    cv2.imwrite(str(plain), np.full((240, 320), 127, dtype=np.uint8))
    nothing = cv2.imread(str(run(localiser, folder, plain, pictures=True) / "plain.png"))
    assert nothing.shape == one.shape
    empty = (nothing[..., 0].astype(int) - nothing[..., 2]) > 60
    below_the_head, above_the_legend = slice(120, -100), slice(30, -30)
    assert not empty[below_the_head, above_the_legend].any()
    assert table(folder / "out" / "edges.csv") == []


def test_pictures_can_be_left_out(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png")
    assert sorted(file.name for file in out.iterdir()) == ["camera.yaml", "config.yaml", "edges.csv"]


def test_settings_are_those_of_the_configuration(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png", "--set", "edges.min_length_px=900", "--set", "edges.detector=lsd")
    assert table(out / "edges.csv") == []
    assert "min_length_px: 900" in (out / "config.yaml").read_text()


def test_camera_and_configuration_beside_the_results_read_back(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png", pictures=True)
    assert read_camera(out / "camera.yaml").mount == CAMERA.mount
    again = localiser("edges", folder / "0.png", "--camera", out / "camera.yaml", "--config", out / "config.yaml",
                      "--out", folder / "again")  # fmt: skip
    assert again.exit_code == 0
    assert (folder / "again" / "edges.csv").read_bytes() == (out / "edges.csv").read_bytes()
    assert (folder / "again" / "0.png").read_bytes() == (out / "0.png").read_bytes()


def test_one_image_prints_its_edges_and_many_print_counts(localiser: Localiser, folder: Path) -> None:
    one = localiser(
        "edges", folder / "0.png", "--camera", folder / "camera.yaml", "--out", folder / "one", "--no-pictures"
    )
    assert "4 vertical edges in" in one.out
    assert "-21.0" in one.out
    assert "By these edges: tilt 20." in one.out or "By these edges: tilt 19.9" in one.out
    assert "Finding" not in one.err
    many = localiser("edges", folder / "0.png", folder / "1.png", "--camera", folder / "camera.yaml",
                     "--out", folder / "many", "--no-pictures")  # fmt: skip
    assert "vertical edges in 2 images, 4 in an image" in many.out
    assert "2/2" in many.err
    silent = localiser("edges", folder / "0.png", folder / "1.png", "--camera", folder / "camera.yaml",
                       "--out", folder / "silent", "--no-pictures", "--quiet")  # fmt: skip
    assert (silent.out, silent.err) == ("", "")


def test_by_default_every_run_has_a_folder_of_its_own(
    localiser: Localiser, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    for _ in range(2):
        assert localiser("edges", "0.png", "--camera", "camera.yaml", "--no-pictures").exit_code == 0
    assert (folder / "results/edges/1/edges.csv").read_bytes() == (folder / "results/edges/2/edges.csv").read_bytes()


def test_images_of_the_same_name_keep_outputs_each(localiser: Localiser, folder: Path) -> None:
    for name in ("left", "right"):
        (folder / name).mkdir()
        shutil.copy(folder / "0.png", folder / name / "a.png")
    out = run(localiser, folder, folder / "left" / "a.png", folder / "right" / "a.png", pictures=True)
    assert {file.name for file in out.glob("*.png")} == {"left_a.png.png", "right_a.png.png"}


# -- logs -------------------------------------------------------------------------------------------------------------


def test_a_log_brings_its_camera_and_its_times(localiser: Localiser, tmp_path: Path) -> None:
    log = cut_log(CORRIDOR, tmp_path / "log", 3)
    result = localiser("edges", log, "--out", tmp_path / "out", "--no-pictures")
    assert result.exit_code == 0, result.err
    rows = table(tmp_path / "out" / "edges.csv")
    times = [line.split(",")[0] for line in (log / "images.csv").read_text().splitlines()[1:]]
    assert list(dict.fromkeys(row["t_ns"] for row in rows)) == times
    camera = read_camera(log / "camera.yaml")
    assert read_camera(tmp_path / "out" / "camera.yaml").mount == camera.mount
    direct = localiser("edges", *sorted((log / "images").iterdir()), "--camera", log / "camera.yaml",
                       "--out", tmp_path / "direct", "--no-pictures")  # fmt: skip
    assert direct.exit_code == 0
    same = ("edge", "bearing_rad", "lean_rad", "foot_range_m")
    by_file = table(tmp_path / "direct" / "edges.csv")
    assert [[row[name] for name in same] for row in rows] == [[row[name] for name in same] for row in by_file]


def test_each_image_of_a_log_has_its_own_mount(localiser: Localiser, tmp_path: Path) -> None:
    log = cut_log(CORRIDOR, tmp_path / "log", 2)
    header, first, second = (log / "images.csv").read_text().splitlines()
    (log / "images.csv").write_text(f"{header},tilt_deg,roll_deg\n{first},,\n{second},17,3\n")
    assert localiser("edges", log, "-o", tmp_path / "log_edges", "--no-pictures").exit_code == 0
    camera = read_camera(log / "camera.yaml").with_mount(tilt_rad=np.deg2rad(17), roll_rad=np.deg2rad(3))
    write_camera(camera, tmp_path / "turned.yaml")
    image = log / second.split(",")[1]
    result = localiser("edges", image, "--camera", tmp_path / "turned.yaml", "-o", tmp_path / "one", "--no-pictures")
    assert result.exit_code == 0, result.err
    rows = [row for row in table(tmp_path / "log_edges" / "edges.csv") if row["image"] == second.split(",")[1]]
    assert len(rows) > 0
    assert [row["bearing_rad"] for row in rows] == [row["bearing_rad"] for row in table(tmp_path / "one" / "edges.csv")]


def test_a_log_of_edges_has_no_images(localiser: Localiser, tmp_path: Path) -> None:
    result = localiser("edges", write_edge_log(tmp_path / "log"), "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "expected a log with images" in result.err


def test_a_log_stands_alone(localiser: Localiser, folder: Path) -> None:
    result = localiser("edges", folder / "0.png", CORRIDOR, "--camera", folder / "camera.yaml")
    assert result.exit_code == 2
    assert f"{CORRIDOR}: expected images or one log" in result.err


def test_a_camera_of_another_size_than_the_logs(localiser: Localiser, folder: Path) -> None:
    result = localiser("edges", CORRIDOR, "--camera", folder / "camera.yaml")
    assert result.exit_code == 2
    assert "--camera: expected a camera of 640×480 pixels, found one of 320×240" in result.err


# -- what is told -----------------------------------------------------------------------------------------------------


def test_a_stated_tilt_that_the_edges_contradict_is_told(localiser: Localiser, folder: Path) -> None:
    image = wall_image(CAMERA, np.linspace(-24, 24, 11), [70, 150] * 6, wall_ahead_m=2.0, noise_sigma=1.0)
    cv2.imwrite(str(folder / "wall.png"), image)
    for off_deg, told in ((0.0, False), (3.0, True)):
        mount = CAMERA.with_mount(tilt_rad=CAMERA.mount.tilt_rad + np.deg2rad(off_deg))
        write_camera(mount, folder / f"{off_deg}.yaml")
        result = localiser("edges", folder / "wall.png", "--camera", folder / f"{off_deg}.yaml",
                           "--out", folder / f"{off_deg}", "--no-pictures")  # fmt: skip
        assert result.exit_code == 0
        assert ("See `localiser camera tilt`" in result.err) == told
        assert ("say that the camera's tilt is 20." in result.err or "tilt is 19.9" in result.err) == told


def test_a_roll_a_little_below_zero_is_told_without_a_sign(monkeypatch: pytest.MonkeyPatch) -> None:
    stated, found = np.deg2rad([15.0, 0.0]), np.deg2rad([18.0, -0.01])
    check = LogMount(stated, found, np.diag(np.deg2rad([0.1, 0.1]) ** 2), 9, 9.0, 0.0, 1, disagrees=True)
    monkeypatch.setattr("localiser.commands.edge_search.check_mount", lambda *_: check)
    warning = EdgeSearch(CAMERA, [], Config()).mount_warning()
    assert warning is not None and "roll 0.0° ± 0.1°" in warning


def test_an_image_without_edges_is_told_in_a_line(localiser: Localiser, folder: Path) -> None:
    cv2.imwrite(str(folder / "black.png"), np.zeros((240, 320), dtype=np.uint8))
    camera = ("--camera", folder / "camera.yaml", "--no-pictures")
    one = localiser("edges", folder / "black.png", *camera, "--out", folder / "one")
    assert one.out.splitlines()[0].startswith("No vertical edges in")
    assert "bearing" not in one.out
    two = localiser("edges", folder / "black.png", folder / "0.png", *camera, "--out", folder / "two")
    assert "4 vertical edges in 2 images" in two.out


# -- bad input --------------------------------------------------------------------------------------------------------


def test_images_need_a_camera(localiser: Localiser, folder: Path) -> None:
    result = localiser("edges", folder / "0.png")
    assert result.exit_code == 2
    assert "0.png: expected --camera FILE" in result.err


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def other_size(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((100, 100), dtype=np.uint8))


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (cut_off, "expected a whole image, found one that is cut off"),
        (other_size, "expected an image of 320×240 pixels, as the camera says, found 100×100"),
        (lambda path: path.write_text("no image"), "expected a JPEG or PNG image, found something else"),
        (lambda path: path.write_bytes(b""), "expected a JPEG or PNG image, found an empty file"),
        (Path.unlink, "no such file"),
    ],
    ids=["cut off", "other size", "text", "empty", "missing"],
)
def test_a_bad_image_ends_the_run_and_keeps_what_was_done(localiser: Localiser, folder: Path, spoil, told: str) -> None:
    images = [folder / f"{index}.png" for index in range(3)]
    whole = run(localiser, folder, images[0])
    expected = table(whole / "edges.csv")
    spoil(images[1])
    out = folder / "broken"
    result = localiser("edges", *images, "--camera", folder / "camera.yaml", "--out", out)
    assert result.exit_code == 2
    assert f"{images[1]}: {told}" in result.err
    assert f"ended after 1 of 3 images; what was done is in {out}" in result.err
    assert "Traceback" not in result.err
    assert table(out / "edges.csv") == expected
    assert {file.name for file in out.glob("[0-9]*")} == {"0.png"}


def test_a_bad_first_image_leaves_no_folder(localiser: Localiser, folder: Path) -> None:
    cut_off(folder / "0.png")
    result = localiser("edges", folder / "0.png", "--camera", folder / "camera.yaml", "--out", folder / "out")
    assert result.exit_code == 2
    assert not (folder / "out").exists()


def test_nothing_is_overwritten(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png")
    before = {file: file.read_bytes() for file in out.iterdir()}
    again = localiser("edges", folder / "1.png", "--camera", folder / "camera.yaml", "--out", out)
    assert again.exit_code == 2
    assert f"{out}: expected a new or empty folder" in again.err
    assert {file: file.read_bytes() for file in out.iterdir()} == before


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--detector", "canny"], "Error: --detector: expected 'columns', 'lsd' or 'hough', found 'canny'"),
        (["--set", "edges.min_length=3"], "min_length"),
        (["--camera", "nowhere.yaml"], "nowhere.yaml: no such file"),
    ],
)
def test_wrong_options_are_told(localiser: Localiser, folder: Path, arguments: list[str], told: str) -> None:
    result = localiser("edges", folder / "0.png", "--camera", folder / "camera.yaml", *arguments)
    assert result.exit_code == 2
    assert told in result.err


def test_the_same_image_twice(localiser: Localiser, folder: Path) -> None:
    result = localiser("edges", folder / "0.png", folder / "0.png", "--camera", folder / "camera.yaml")
    assert result.exit_code == 2
    assert "0.png: expected each image once" in result.err


# -- pictures of other cameras ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "camera",
    [
        camera_of(176, 144, tilt_deg=18.97),
        camera_of(320, 240, tilt_deg=0.0),
        camera_of(320, 240, tilt_deg=-15.0),
        camera_of(320, 240, tilt_deg=55.0),
        camera_of(200, 150, tilt_deg=20.0, focal_px=80.0, k1=-0.3),
    ],
    ids=["the paper's", "level", "looking up", "looking down", "wide"],
)
def test_any_camera_has_a_picture(localiser: Localiser, tmp_path: Path, camera: Camera) -> None:
    write_camera(camera, tmp_path / "camera.yaml")
    cv2.imwrite(str(tmp_path / "0.png"), wall_image(camera, BEARINGS_DEG, GREYS))
    out = run(localiser, tmp_path, tmp_path / "0.png", "--set", "edges.min_length_px=20", pictures=True)
    height, width = cv2.imread(str(out / "0.png")).shape[:2]
    assert 1000 <= width < 2000
    assert height > width * camera.height / camera.width
    assert len(table(out / "edges.csv")) >= 3
