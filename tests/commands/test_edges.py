"""The command `edges`: what it writes of images and logs, what is wrong with bad input."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from edge_images import camera_of, wall_image
from short_log import CORRIDOR, Localiser, cut_log
from small_log import write_edge_log

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


def run(localiser: Localiser, folder: Path, *arguments: object, pictures: bool = False, out: str = "out") -> Path:
    drawn = "--pictures" if pictures else "--no-pictures"
    result = localiser("edges", *arguments, "--camera", folder / "camera.yaml", "--out", folder / out, drawn)
    assert result.exit_code == 0, result.err
    return folder / out


# -- what is written --------------------------------------------------------------------------------------------------


def test_the_table_holds_the_true_edges_from_left_to_right(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png")
    assert sorted(file.name for file in out.iterdir()) == ["camera.yaml", "config.yaml", "edges.csv"]
    rows = table(out / "edges.csv")
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


def test_the_picture_shows_where_the_edges_are(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png", pictures=True)
    drawn = cv2.imread(str(out / "0001_0.png")).astype(int)
    assert drawn.shape[:2] == (960, 1280), "a small image is drawn larger"
    blue = drawn[..., 0] - drawn[..., 2] > 60
    for row in table(out / "edges.csv"):
        u, v = (4 * (float(row[f"bottom_{axis}_px"]) + float(row[f"top_{axis}_px"])) / 2 for axis in "uv")
        assert blue[round(v), round(u) - 8 : round(u) + 9].any()
    assert blue.mean() < 0.02, "nothing else is blue"


def test_camera_and_configuration_beside_the_results_read_back(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png", "--set", "edges.detector=lsd")
    assert read_camera(out / "camera.yaml").mount == CAMERA.mount
    again = run(localiser, folder, folder / "0.png", "--config", out / "config.yaml", out="again")
    assert (again / "edges.csv").read_bytes() == (out / "edges.csv").read_bytes()
    assert table(out / "edges.csv")[0]["detector"] == "lsd"


def test_one_image_prints_its_edges_and_many_print_counts(localiser: Localiser, folder: Path) -> None:
    cv2.imwrite(str(folder / "black.png"), np.zeros((240, 320), dtype=np.uint8))
    how = ("--camera", folder / "camera.yaml", "--no-pictures", "--out")
    one = localiser("edges", folder / "0.png", *how, folder / "one")
    assert "4 vertical edges in" in one.out and "Finding" not in one.err
    many = localiser("edges", folder / "0.png", folder / "1.png", *how, folder / "many")
    assert "8 vertical edges in 2 images, 4 each" in many.out and "2/2" in many.err
    silent = localiser("edges", folder / "0.png", folder / "1.png", *how, folder / "silent", "--quiet")
    assert (silent.out, silent.err) == ("", "")
    none = localiser("edges", folder / "black.png", *how, folder / "none")
    assert none.out.startswith("0 vertical edges in")
    assert table(folder / "none" / "edges.csv") == []


def test_by_default_every_run_has_a_folder_of_its_own(localiser, folder, monkeypatch):
    monkeypatch.chdir(folder)
    for _ in range(2):
        assert localiser("edges", "0.png", "--camera", "camera.yaml", "--no-pictures").exit_code == 0
    assert (folder / "results/edges/1/edges.csv").read_bytes() == (folder / "results/edges/2/edges.csv").read_bytes()


# -- logs -------------------------------------------------------------------------------------------------------------


def test_a_log_brings_its_camera_its_times_and_a_mount_of_each_image(localiser: Localiser, tmp_path: Path) -> None:
    log = cut_log(CORRIDOR, tmp_path / "log", 2)
    header, first, second = (log / "images.csv").read_text().splitlines()
    (log / "images.csv").write_text(f"{header},tilt_deg,roll_deg\n{first},,\n{second},17,3\n")
    assert localiser("edges", log, "-o", tmp_path / "all", "--no-pictures").exit_code == 0
    rows = table(tmp_path / "all" / "edges.csv")
    assert list(dict.fromkeys(row["t_ns"] for row in rows)) == [first.split(",")[0], second.split(",")[0]]
    camera = read_camera(log / "camera.yaml")
    assert read_camera(tmp_path / "all" / "camera.yaml").mount == camera.mount
    write_camera(camera.with_mount(tilt_rad=np.deg2rad(17), roll_rad=np.deg2rad(3)), tmp_path / "camera.yaml")
    one = table(run(localiser, tmp_path, log / second.split(",")[1]) / "edges.csv")
    assert len(one) > 3
    assert [row["bearing_rad"] for row in rows][-len(one) :] == [row["bearing_rad"] for row in one]


# -- what is told -----------------------------------------------------------------------------------------------------


def test_a_bad_image_ends_the_run_and_keeps_what_was_done(localiser: Localiser, folder: Path) -> None:
    images = [folder / f"{index}.png" for index in range(3)]
    expected = table(run(localiser, folder, images[0], out="whole") / "edges.csv")
    images[1].write_bytes(images[1].read_bytes()[:-40])
    out = folder / "broken"
    result = localiser("edges", *images, "--camera", folder / "camera.yaml", "--out", out)
    assert result.exit_code == 2
    assert f"{images[1]}: expected a whole image, found one that is cut off" in result.err
    assert f"ended after 1 of 3 images; what was done is in {out}" in result.err
    assert table(out / "edges.csv") == expected
    assert {file.name for file in out.glob("[0-9]*")} == {"0001_0.png"}
    first = localiser("edges", images[1], "--camera", folder / "camera.yaml", "--out", folder / "none")
    assert first.exit_code == 2 and not (folder / "none").exists(), "a bad first image leaves no folder"


def test_nothing_is_overwritten(localiser: Localiser, folder: Path) -> None:
    out = run(localiser, folder, folder / "0.png")
    before = {file: file.read_bytes() for file in out.iterdir()}
    again = localiser("edges", folder / "1.png", "--camera", folder / "camera.yaml", "--out", out)
    assert again.exit_code == 2
    assert f"{out}: expected a new or empty folder" in again.err
    assert {file: file.read_bytes() for file in out.iterdir()} == before


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["0.png"], "0.png: expected --camera FILE"),
        (
            ["0.png", "--camera", "camera.yaml", "--detector", "canny"],
            "edges.detector: expected 'columns', 'lsd' or 'hough'",
        ),
        (["0.png", "--camera", "nowhere.yaml"], "nowhere.yaml: no such file"),
        (["edges", "--out", "made"], "expected a log with images"),
        (["0.png", CORRIDOR, "--camera", "camera.yaml"], "corridor: expected images or one log"),
        ([CORRIDOR, "--camera", "camera.yaml"], "--camera: expected a camera of 640×480 pixels, found one of 320×240"),
    ],
)
def test_bad_input_is_told(localiser, folder, monkeypatch, words, told):
    monkeypatch.chdir(folder)
    write_edge_log(folder / "edges")
    result = localiser("edges", *words)
    assert result.exit_code == 2 and told in result.err
