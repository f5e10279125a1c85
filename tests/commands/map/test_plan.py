"""`localiser map plan`: floor plans in, maps out, and every bad plan."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from folders import ROOT
from map_commands import edge_log, refused, run
from mapping_worlds import world
from world_plan import draw_plan, write_plan

from localiser.commands.map.plan import map_of_plan
from localiser.errors import InputWarning
from localiser.storage import find_run, read_json, read_map, read_plan, read_world
from localiser.storage.plans import PlanFile, classify

WORLD = ROOT / "configs" / "worlds" / "corridor.yaml"
HEAD = {"image": "hall.pgm", "resolution": 0.1, "origin": "[1.0, 2.0, 0.0]", "negate": 0}


def pillar(dark: int = 0, light: int = 254) -> np.ndarray:
    """Return a picture of one pillar, 1 m by 1.5 m, in a hall of 5 m by 6 m; its upper left corner is 1 m, 2 m off."""
    picture = np.full((60, 50), light, dtype=np.uint8)
    picture[20:35, 10:20] = dark
    return picture


def plan_file(folder: Path, picture: np.ndarray | bytes | None = None, **fields: object) -> Path:
    """Write a plan; `fields` change or, when None, remove lines of its YAML file."""
    settings = {**HEAD, "occupied_thresh": 0.65, "free_thresh": 0.196, **fields}
    image = folder / str(settings["image"])
    if isinstance(picture, bytes):
        image.write_bytes(picture)
    elif image.suffix == ".png":
        assert picture is not None
        cv2.imwrite(str(image), picture)
    else:
        grey = pillar() if picture is None else picture
        image.write_bytes(f"P5\n# made by hand\n{grey.shape[1]} {grey.shape[0]}\n255\n".encode() + grey.tobytes())
    path = folder / "hall.yaml"
    path.write_text("".join(f"{name}: {value}\n" for name, value in settings.items() if value is not None))
    return path


def corners(path: Path) -> list[tuple[float, float]]:
    """Return the landmarks that `map plan` makes of a plan, rounded to a centimetre and sorted."""
    out = path.with_name("map.yaml")
    out.unlink(missing_ok=True)
    assert run("map", "plan", path, "-o", out, "-q").exit_code == 0
    return sorted((round(float(x), 2), round(float(z), 2)) for x, z in read_map(out).points)


# The picture's lower left corner is ROS (1, 2), our (1, -2); rows 20 to 34 from above are 25 to 39 from below.
PILLAR = [(2.0, -6.0), (2.0, -4.5), (3.0, -6.0), (3.0, -4.5)]


def test_a_plan_becomes_a_map(tmp_path: Path) -> None:
    assert corners(plan_file(tmp_path)) == PILLAR
    made = run("map", "plan", tmp_path / "hall.yaml", "-o", tmp_path / "other.yaml")
    assert "4 landmarks" in made.output and "5.0 m × 6.0 m" in made.output


def test_unknown_cells_of_map_saver_are_not_free_whatever_the_threshold(tmp_path: Path) -> None:
    picture = pillar()
    picture[18:37, 8:10] = 205  # nothing is known to the left of the pillar, so its left corners have no floor beside
    expected = corners(plan_file(tmp_path, picture))
    for fields in ({"free_thresh": 0.25}, {"free_thresh": 0.25, "image": "hall.png"}):
        with pytest.warns(InputWarning, match="38 pixels of grey 205 are unknown"):
            assert corners(plan_file(tmp_path, picture, **fields)) == expected
    with pytest.warns(InputWarning, match="38 pixels of grey 205"):
        plan = read_plan(plan_file(tmp_path, 255 - picture, negate=1, free_thresh=0.25))
    assert plan.free.sum() == plan.free.size - 150 - 38


def test_every_kind_of_picture(tmp_path: Path) -> None:
    grey = pillar()
    text = "P2 # text\n50 60\n255\n" + " ".join(str(value) for value in grey.ravel())
    assert corners(plan_file(tmp_path, text.encode())) == PILLAR
    deep = b"P5 50 60 65535\n" + (grey.astype(">u2") * 257).tobytes()
    assert corners(plan_file(tmp_path, deep)) == PILLAR
    few = b"P5 50 60 1\n" + (grey > 0).astype(np.uint8).tobytes()
    assert corners(plan_file(tmp_path, few)) == PILLAR
    for picture in (grey, cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), cv2.cvtColor(grey, cv2.COLOR_GRAY2BGRA)):
        opaque = picture.copy()
        mode = "scale" if opaque.ndim == 3 and opaque.shape[2] == 4 else "trinary"
        assert corners(plan_file(tmp_path, opaque, image="hall.png", mode=mode)) == PILLAR
    assert corners(plan_file(tmp_path, grey.astype(np.uint16) * 257, image="hall.png")) == PILLAR


def test_negated_and_raw_plans(tmp_path: Path) -> None:
    assert corners(plan_file(tmp_path, pillar(254, 0), negate=1)) == PILLAR
    assert corners(plan_file(tmp_path, pillar(100, 0), mode="raw")) == PILLAR


def test_the_origin_turns_the_plan(tmp_path: Path) -> None:
    turned = corners(plan_file(tmp_path, origin="[1.0, 2.0, 1.5707963267948966]"))
    # The picture's right is ROS y: (east, north) of the corner becomes (-north, east).
    assert turned == sorted((round(1 - (-z - 2), 2), round(-(2 + (x - 1)), 2)) for x, z in PILLAR)


def test_map_servers_rules_pixel_by_pixel() -> None:
    """Values of trinary, scale and raw maps as map_server's source has them: 1 wall, 0 floor, -1 unknown."""
    values = np.array([0, 89, 90, 204, 205, 206, 255, 100, 66, 19], dtype=np.uint8)
    picture = values.reshape(1, -1, 1)

    def classes(mode: str, negate: int = 0, picture: np.ndarray = picture) -> list[int]:
        file = PlanFile(
            image="a", resolution=1, origin=[0, 0, 0], negate=negate, occupied_thresh=0.65, free_thresh=0.196, mode=mode
        )
        occupied, free = classify(picture, file)
        assert not (occupied & free).any()
        return (occupied.astype(int) - (~occupied & ~free))[0].tolist()

    assert classes("trinary") == [1, 1, -1, -1, -1, 0, 0, -1, 1, 1]
    assert classes("trinary", 1) == [0, -1, -1, 1, 1, 1, 1, -1, -1, 0]
    assert classes("scale") == [1, 1, 1, 0, 0, 0, 0, 1, 1, 1]
    assert classes("raw") == [0, 1, 1, -1, -1, -1, -1, 1, 1, 0]
    clear = np.concatenate([np.repeat(picture, 3, axis=2), np.zeros_like(picture)], axis=2)
    assert classes("scale", picture=clear) == [1, 1, -1, -1, -1, 0, 0, -1, 1, 1]


@pytest.mark.slow
def test_the_map_of_a_drawn_plan_localises(tmp_path: Path) -> None:
    plan, out = tmp_path / "plan.yaml", tmp_path / "map.yaml"
    write_plan(draw_plan(read_world(WORLD), 0.05, np.deg2rad(20)), plan)
    assert run("map", "plan", plan, "-o", out, "-q").exit_code == 0
    drive, frames = world("corridor"), 60
    # Another map has other landmarks: who saw which does not count.
    edges = [replace(seen, landmark_id=np.full(len(seen), -1)) for seen in drive.edges(seed=0)[:frames]]
    log = edge_log(tmp_path / "log", edges)
    options = ("--start", "truth", "--no-rrd", "--out", tmp_path / "runs", "-q")
    assert run("replay", log, "--map", out, *options).exit_code == 0
    figures = read_json(find_run(tmp_path / "runs" / "drive" / "latest") / "metrics.json")
    assert figures["position_rmse_m"] < 0.2


def test_a_plan_is_refined_by_a_log(tmp_path: Path) -> None:
    """The plan's file itself, merged with a map of the log: corners go to where the log saw them, names stay."""
    plan, built, out = (tmp_path / name for name in ("plan.yaml", "log.yaml", "whole.yaml"))
    write_plan(draw_plan(read_world(WORLD), 0.05), plan)
    drive = world("corridor")
    log = edge_log(tmp_path / "log", drive.edges(seed=0))
    assert run("map", "build", log, "-o", built, "-q").exit_code == 0
    assert run("map", "merge", plan, built, "-o", out).exit_code == 0
    drawn, whole = map_of_plan(plan)[0], read_map(out)
    assert whole.ids[: len(drawn)] == drawn.ids
    both = np.flatnonzero(np.isfinite(whole.quality.sightings[: len(drawn)]))
    assert len(both) > 15  # doors are shut on the drive, and open on a plan
    truth = drive.landmark_map.points

    def off(points: np.ndarray) -> float:
        return float(np.median(np.linalg.norm(points[:, None] - truth[None], axis=-1).min(axis=1)))

    assert off(whole.points[both]) < 0.5 * off(drawn.points[both])
    assert run("map", "align", plan, built).exit_code == 0


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"image": None}, "image"),
        ({"resolution": 0}, "resolution"),
        ({"resolution": "nan"}, "resolution"),
        ({"origin": "[0, 0]"}, "origin"),
        ({"origin": "[0, 0, .inf]"}, "origin"),
        ({"negate": 2}, "negate"),
        ({"occupied_thresh": None}, "occupied_thresh"),
        ({"occupied_thresh": 0.1}, "free_thresh"),
        ({"mode": "fancy"}, "mode"),
        ({"image": "gone.png"}, "gone.png"),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, fields: dict[str, object], expected: str) -> None:
    path = plan_file(tmp_path)
    kept = {**HEAD, "occupied_thresh": 0.65, "free_thresh": 0.196, **fields}
    path.write_text("".join(f"{name}: {value}\n" for name, value in kept.items() if value is not None))
    assert expected in refused("map", "plan", path, "-o", tmp_path / "map.yaml")
    assert not (tmp_path / "map.yaml").exists()


@pytest.mark.parametrize(
    ("picture", "expected"),
    [
        (b"", "empty"),
        (b"GIF89a", "PGM or PNG"),
        (b"P5\n", "head"),
        (b"P5\n4000000 4000000\n255\n" + bytes(100), "4000000×4000000"),
        (b"P5\n999999999999 2\n255\n" + bytes(100), "999999999999×2"),
        (b"P5\n" + b"9" * 10_000 + b" 2\n255\n", "head"),
        (b"P5" + b" " * 50 + b"x", "head"),
        (b"P5\n0 10\n255\n", "0×10"),
        (b"P5\n50 60\n255\n" + bytes(10), "cut off"),
        (b"P5\n5 6\n0\n" + bytes(30), "largest value"),
        (b"P5\n2 2\n7\n" + bytes([0, 9, 0, 0]), "up to 7"),
        (b"P2\n2 2\n255\n0 0 x 0", "numbers"),
        (b"\x89PNG\r\n\x1a\n" + bytes(8), "PNG"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\x3d\x09\0\0\x3d\x09\0\x08\0\0\0\0" + bytes(9), "4000000×4000000"),
        (np.full((60, 50), 254, dtype=np.uint8), "expected walls"),
        (np.zeros((60, 50), dtype=np.uint8), "floor that is free"),
        (np.where(np.arange(3000).reshape(60, 50) % 53 == 0, 0, 254).astype(np.uint8), "corners of walls"),
        (np.random.default_rng(0).integers(0, 2, (400, 400), dtype=np.uint8) * 254, "no building"),
    ],
)
def test_a_bad_picture_is_refused(tmp_path: Path, picture: np.ndarray | bytes, expected: str) -> None:
    path = plan_file(tmp_path, picture)
    out = tmp_path / "map.yaml"
    assert expected in refused("map", "plan", path, "-o", out)
    assert not out.exists()


def test_the_plan_that_ships_is_that_of_its_world() -> None:
    shipped, drawn = read_plan(ROOT / "configs" / "plans" / "corridor.yaml"), draw_plan(read_world(WORLD), 0.05)
    assert np.array_equal(shipped.occupied, drawn.occupied) and np.array_equal(shipped.free, drawn.free)
    assert shipped.origin_ros == pytest.approx(drawn.origin_ros)
