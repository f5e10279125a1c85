"""`localiser map check|align|merge|update`, and the pictures of maps."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from folders import ROOT
from map_commands import edge_log, refused, run
from mapping_worlds import world
from matplotlib.figure import Figure

from localiser.commands.map import pictures
from localiser.geometry import pose_from_ros, robot_from_map
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping import FloorPlan, Sightings, coverage, duplicates, in_view, join_maps
from localiser.mapping.check import existence_after
from localiser.mapping.landmarks import fit_landmarks
from localiser.storage import read_map, write_camera, write_map


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCALISER_CACHE", str(tmp_path / "cache"))


def test_doubles_are_near_and_alike() -> None:
    points = np.array([[0.0, 0.0], [0.015, 0.0], [3.0, 0.0], [3.05, 0.0], [6.0, 0.0], [6.01, 0.0], [9.0, 0.0]])
    cov = np.zeros((7, 2, 2))
    cov[2:4] = 0.03**2 * np.eye(2)
    polarity = np.array([0, 1, 1, 1, 1, -1, 0], dtype=np.int8)
    landmarks = replace(LandmarkMap.from_points(points), cov=cov, polarity=polarity)
    assert sorted(map(tuple, duplicates(landmarks).tolist())) == [(0, 1), (2, 3)]
    assert len(duplicates(LandmarkMap.from_points(points[[0, 2, 6]]))) == 0


def test_neighbours_one_behind_the_other_are_not_doubles_for_a_distance_that_all_landmarks_know_badly() -> None:
    """Seen from few degrees apart, the error that images share is larger along the line of sight than across it."""
    points = np.array([[0.0, 0.0], [0.0, 0.03], [1.0, 0.0], [1.0, 0.03], [2.0, 0.0]])
    across_m = np.array([0.006, 0.006, 0.012, 0.012, 0.006])
    cov = across_m[:, None, None] ** 2 * np.diag([1.0, 9.0])
    assert duplicates(replace(LandmarkMap.from_points(points), cov=cov)).tolist() == [[2, 3]]


@pytest.mark.parametrize("shared_m", [0.006, 0.015])
def test_neighbours_are_not_doubles_for_an_error_that_all_landmarks_share(shared_m: float) -> None:
    """Two books 3 cm apart, two that a few images show badly, and a surveyed corner."""
    points = np.array([[0.0, 0.0], [0.03, 0.0], [3.0, 0.0], [3.05, 0.0], [6.0, 0.0]])
    own_m = np.array([0.001, 0.001, 0.03, 0.03, 0.0])
    cov = (own_m**2 + shared_m**2 * (own_m > 0))[:, None, None] * np.eye(2)
    assert duplicates(replace(LandmarkMap.from_points(points), cov=cov)).tolist() == [[2, 3]]


def test_what_is_in_view_depends_on_the_heading() -> None:
    """Three posts ahead, none behind: some headings show all of them, as many show none."""
    camera = world("corridor").camera
    posts = LandmarkMap.from_points(np.array([[-0.5, -4.0], [0.0, -4.0], [0.5, -4.0]]))
    count = in_view(posts, camera, np.array([[0.0, 0.0]]), headings=36)[0]
    assert count[[0, 18]].tolist() == [3, 0]
    assert 4 <= (count == 3).sum() <= 6  # 60° of view, less the 14° that the posts take up
    found = coverage(posts, camera)
    assert ((found.share > 0.5) & (found.share <= 1.0)).all() and found.median == 0


@pytest.mark.slow
def test_the_command_tells_and_draws(tmp_path: Path) -> None:
    drive = world("corridor")
    log = edge_log(tmp_path / "log", drive.edges(seed=0)[:40])
    twice = LandmarkMap.from_points(np.concatenate([drive.landmark_map.points, drive.landmark_map.points[:1] + 0.005]))
    path, picture = tmp_path / "hall.yaml", tmp_path / "hall_coverage.png"
    write_map(twice, path)
    plain = run("map", "check", path)
    assert plain.exit_code == 0 and f"0={len(twice) - 1}" in plain.output and not picture.exists()
    checked = run("map", "check", path, "--log", log)
    assert checked.exit_code == 0 and "fewer than 3 from" in checked.output
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "expected a new file" in refused("map", "check", path, "--log", log, "-o", picture)
    write_camera(drive.camera, tmp_path / "camera.yaml")
    assert "Picture in" in run("map", "check", path, "--camera", tmp_path / "camera.yaml").output


def points(count: int = 30) -> np.ndarray:
    return np.random.default_rng(5).uniform([-6, -9], [6, 1], (count, 2))


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A map of 30 landmarks that are known to 2 cm."""
    plain = LandmarkMap.from_points(points(), name="hall", source="a log")
    unknown = np.full(30, np.nan)
    quality = Quality(np.full(30, 9.0), unknown, np.full(30, 0.9))
    path = tmp_path / "hall.yaml"
    write_map(
        replace(plain, cov=np.tile(4e-4 * np.eye(2), (30, 1, 1)), quality=quality, header={"surveyor": "Ada"}), path
    )
    return path


def test_align_and_merge(made: Path, tmp_path: Path) -> None:
    """The second map has its own frame, lacks ten landmarks and has one more."""
    pose = np.array([3.0, -4.0, 1.0])
    known = read_map(made).take(np.arange(10, 30))
    other = tmp_path / "other.yaml"
    extra = LandmarkMap.from_points(np.array([[20.0, 20.0]]), ids=("new",))
    write_map(join_maps(replace(known, points=robot_from_map(pose, known.points)), extra), other)
    out = tmp_path / "aligned.yaml"
    shown = run("map", "align", made, other, "-o", out)
    assert "20 of 30 and 21 landmarks match" in shown.output
    assert shown.exit_code == 0 and "turned by 57.30°" in shown.output
    assert read_map(out).points[:20] == pytest.approx(known.points, abs=1e-6)
    merged = tmp_path / "merged.yaml"
    told = run("map", "merge", made, other, "--align", "-o", merged)
    assert "31 landmarks" in told.output
    assert "20 of both maps, 10 of the first alone, 1 of the second alone" in told.output
    whole = read_map(merged)
    assert whole.points[:30] == pytest.approx(points(), abs=1e-6)
    assert whole.ids[30] == extra.ids[0]
    # Two sightings of 2 cm each are one of 1.4 cm.
    assert whole.cov[[15, 5], 0, 0] == pytest.approx([2e-4, 4e-4])


def test_maps_that_do_not_fit_are_not_merged(made: Path, tmp_path: Path) -> None:
    far, out = tmp_path / "far.yaml", tmp_path / "out.yaml"
    write_map(LandmarkMap.from_points(points() + 100.0), far)
    assert "one frame" in refused("map", "merge", made, far, "-o", out)
    write_map(LandmarkMap.from_points(points()[:2]), far)
    assert "do not fit" in refused("map", "align", made, far, "-o", out)
    assert not out.exists()


def test_of_a_list_of_maps_the_one_that_is_meant_must_be_named(made: Path, tmp_path: Path) -> None:
    site, out = tmp_path / "site.yaml", tmp_path / "out.yaml"
    write_map(read_map(made), tmp_path / "upper.yaml")
    site.write_text("format: localiser-site/1\nmaps: [hall.yaml, upper.yaml]\n")
    named = (
        ("merge", site),
        ("merge", made, site),
        ("align", site, made),
        ("align", made, site),
        ("update", site, made),
    )
    for words in named:
        assert "expected one map, found a list of 2: name the one" in refused("map", *words, "-o", out)
    site.write_text("format: localiser-site/1\nmaps: [hall.yaml]\n")
    assert run("map", "merge", site, "-o", out).exit_code == 0 and read_map(out).ids == read_map(made).ids


def test_a_map_exists_already(made: Path) -> None:
    before = made.read_bytes()
    assert "expected a new file" in refused("map", "merge", made, "-o", made)
    assert "expected two maps" in refused("map", "merge", made, "--align", "-o", made.with_name("b.yaml"))
    assert made.read_bytes() == before


def test_a_map_is_drawn_in_the_style_of_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    with mpl.rc_context({"axes.facecolor": "black"}):
        pictures.draw_map(read_map(ROOT / "maps" / "corridor.yaml"), tmp_path / "map.png")
    (axes,) = drawn[0].axes
    assert not axes.spines["top"].get_visible() and axes.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
    assert (axes.get_title(loc="left"), axes.get_xlabel()) == ("corridor", "x (m)")


def test_the_walls_of_a_turned_plan_and_the_path_are_drawn_where_they_are() -> None:
    occupied = np.zeros((4, 6), dtype=bool)
    occupied[1, 2:5] = True
    plan = FloorPlan(occupied, ~occupied, 0.5, np.array([1.0, -2.0, np.pi / 2]))
    driven = np.array([[0.0, 0.0, 0.0], [9.0, -9.0, 0.0]])
    landmark_map = LandmarkMap.from_points(np.zeros((1, 2)))
    (axes,) = pictures.map_figure(landmark_map, "map", driven, plan).axes
    (walls,), (path,) = axes.images, axes.lines
    assert np.asarray(path.get_xydata()) == pytest.approx(driven[:, :2])
    # The outer corner of cell (column 2, row 1) is 1 m along the plan's x axis, which points along ROS's y, and 0.5 m
    # along its y axis.
    (corner,) = pose_from_ros(np.array([[1.0 - 0.5, -2.0 + 1.0, 0.0]]))[:, :2]
    drawn = (walls.get_transform() - axes.transData).transform([2.0, 1.0])
    assert drawn == pytest.approx(corner, abs=1e-9)
    (low_x, high_x), (high_z, low_z) = axes.get_xlim(), axes.get_ylim()
    for x, z in (corner, driven[1, :2]):
        assert low_x < x < high_x and low_z < z < high_z
    free = np.ones((2, 2), dtype=bool)
    without = pictures.map_figure(landmark_map, "map", None, FloorPlan(~free, free, 0.1, np.zeros(3)))
    assert np.ptp(without.axes[0].get_xlim()) < 1.0, "a plan without walls reaches nowhere"


def test_gone_and_new_landmarks(tmp_path: Path) -> None:
    """Two posts of the map stand in the corridor no more; a landmark that was often seen is not on the map yet."""
    drive = world("corridor")
    edges = drive.edges(seed=0)
    seen = np.bincount(np.concatenate([frame.landmark_id for frame in edges]) + 1)[1:]
    missing = int(seen.argmax())
    kept = np.setdiff1d(np.arange(len(drive.landmark_map)), [missing])
    posts = np.array([[-0.55, -7.3], [0.5, -7.9]])
    gone = LandmarkMap.from_points(posts, ids=("post", "pole"), bottom_m=np.zeros(2), top_m=np.full(2, 1.5))
    old = join_maps(drive.landmark_map.take(kept), gone)
    old = replace(old, cov=np.tile(1e-4 * np.eye(2), (len(old), 1, 1)))
    path, out = tmp_path / "old.yaml", tmp_path / "new.yaml"
    write_map(old, path)
    before = path.read_bytes()
    log = edge_log(tmp_path / "log", edges)
    told = run("map", "update", path, log, "-o", out)
    assert told.exit_code == 0 and "post" in told.output.split("Gone:")[1].split("New:")[0]
    new = read_map(out)
    assert not {"post", "pole"} & set(new.ids)
    assert np.hypot(*(new.points - drive.landmark_map.points[missing]).T).min() < 0.02
    assert len(set(old.ids) - set(new.ids) - {"post", "pole"}) <= 0.05 * len(old)
    # What the drive saw well stays.
    often = {drive.landmark_map.ids[k] for k in np.flatnonzero(seen >= 10)} - {drive.landmark_map.ids[missing]}
    assert often <= set(new.ids)
    assert path.read_bytes() == before
    assert "expected a new file" in refused("map", "update", path, log, "-o", out)


def test_what_is_in_view_is_asked_of_each_image_as_the_camera_was_mounted() -> None:
    camera, edges = world("corridor").camera, world("corridor").edges(seed=0)
    seen, of = Sightings.from_edges(edges, camera), np.concatenate([frame.landmark_id for frame in edges])
    cameras = camera.pose_in_map(world("corridor").truth.poses)
    built = fit_landmarks(seen, of, cameras, np.full(len(of), 1e-3))
    pole = LandmarkMap.from_points(np.array([[0.5, -7.9]]), bottom_m=np.zeros(1), top_m=np.ones(1))
    upwards = replace(camera, mount=replace(camera.mount, tilt_rad=-1.5))  # as it is else
    moved = replace(seen, mounts=(camera.mount,) * seen.frames)
    found = [existence_after(pole, s, built, c, cameras, 0.9) for s, c in ((seen, camera), (moved, upwards))]
    assert found[1] == pytest.approx(found[0]) and found[0] < 0.5


def test_a_map_of_elsewhere_is_left_alone(tmp_path: Path) -> None:
    drive = world("corridor")
    path, out = tmp_path / "old.yaml", tmp_path / "new.yaml"
    write_map(LandmarkMap.from_points(drive.landmark_map.points + 100.0), path)
    log = edge_log(tmp_path / "log", drive.edges(seed=0))
    assert "frame" in refused("map", "update", path, log, "-o", out)
    assert not out.exists()
