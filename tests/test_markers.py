"""Markers, from pixels to poses: a marker tells which of two like places it is, and one that was moved does no harm."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cameras import vga_camera
from simulated_edges import EdgeNoise, simulated_edges

from localiser import (
    Edges,
    InputError,
    LandmarkMap,
    Localiser,
    Trajectory,
    build_map,
    read_config,
    read_map,
    simulate_log,
)
from localiser.camera import Mount
from localiser.edges import EdgeParameters, find_edges
from localiser.geometry import Array, compose
from localiser.markers import DICTIONARIES, code_of, name_of, sides_of_markers
from localiser.simulate.world import world_of

CAMERA = vga_camera(Mount(np.deg2rad(20.0), 0.9))
TAG = EdgeParameters(markers="tag36h11")
LEFT, RIGHT = code_of("tag36h11:7:left")[0], code_of("tag36h11:7:right")[0]


def picture(number: int = 7, side_px: int = 60, turned: int = 0, dictionary: str = "tag36h11") -> np.ndarray:
    """Return an image (480, 640) of one marker in its middle."""
    image = np.full((CAMERA.height, CAMERA.width), 200, np.uint8)
    kind = cv2.aruco.getPredefinedDictionary(DICTIONARIES[dictionary])
    marker = np.rot90(cv2.aruco.generateImageMarker(kind, number, side_px), turned)
    left = (CAMERA.width - side_px) // 2
    image[210 : 210 + side_px, left : left + side_px] = marker
    return cv2.GaussianBlur(image, (0, 0), 0.7)


# -- in an image ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dictionary", ["tag36h11", "tag16h5", "4x4_50", "aruco_original"])
def test_the_sides_of_a_marker_are_edges_with_its_name(dictionary: str) -> None:
    parameters = replace(TAG, markers=dictionary)
    edges = find_edges(picture(dictionary=dictionary), CAMERA, parameters)
    marked = edges.take(edges.landmark_id < -1)
    assert [name_of(code, dictionary) for code in marked.landmark_id] == [
        f"{dictionary}:7:{s}" for s in ("left", "right")
    ]
    assert marked.polarity.tolist() == [-1, 1], "black on white"
    np.testing.assert_allclose(marked.ends_px[:, :, 0].mean(axis=1), [289.5, 349.5], atol=0.5)
    np.testing.assert_allclose(marked.length_px, 60, atol=1.5)


def test_nothing_is_named_unless_asked_for_and_edges_are_the_same() -> None:
    plain, named = find_edges(picture(), CAMERA), find_edges(picture(), CAMERA, TAG)
    assert (plain.landmark_id == -1).all()
    assert len(named.take(named.landmark_id == -1)) <= len(plain)
    empty = np.full((CAMERA.height, CAMERA.width), 90, np.uint8)
    assert len(find_edges(empty, CAMERA, TAG)) == 0


def test_a_marker_is_read_where_its_sides_are_too_short_for_edges() -> None:
    parameters = EdgeParameters(min_length_px=50.0)
    assert not len(find_edges(picture(side_px=34), CAMERA, parameters))
    edges = find_edges(picture(side_px=34), CAMERA, replace(parameters, markers="tag36h11"))
    assert sorted(edges.landmark_id) == [RIGHT, LEFT]


@pytest.mark.parametrize("turned", [1, 2, 3])
def test_a_marker_that_does_not_hang_upright_has_no_sides(turned: int) -> None:
    lines, codes = sides_of_markers(picture(turned=turned), "tag36h11")
    assert len(lines) == len(codes) == 0


def test_a_dictionary_or_a_name_that_is_none_is_refused(tmp_path: pytest.TempPathFactory) -> None:
    with pytest.raises(InputError, match=r"edges.markers: .*expected one of .*tag36h11"):
        read_config(None, ["edges.markers=tag99"])
    path = tmp_path / "map.yaml"
    landmark = "{id: 1, x: 0.0, z: 1.0, identity: 'tag36h11:7:top'}"
    path.write_text(f"format: localiser-map/1\nlandmarks:\n- {landmark}\n")
    with pytest.raises(InputError, match=r"3:\d+: landmarks\[0\].identity: expected a side of a marker"):
        read_map(path)
    other = marked(ROOM, 0)
    with pytest.raises(InputError, match=r"edges\.markers: expected 'tag36h11', of which the map has markers"):
        Localiser(other, CAMERA, read_config(None, ["edges.markers=4x4_50"]))


# -- in the filter ----------------------------------------------------------------------------------------------------

HALF = np.array(
    [[-3.0, -4.0], [-2.8, -4.0], [-1.1, -4.0], [0.2, -4.0], [0.4, -4.0], [1.9, -4.0], [3.0, -4.0], [3.2, -2.1],
     [3.2, -0.9], [-3.2, -2.6], [-3.2, -1.4], [1.0, -2.6], [-1.7, -2.2]]
)  # fmt: skip
ROOM = np.concatenate([HALF, -HALF])  # turned by half a turn it is the same


def marked(points: Array, *left: int) -> LandmarkMap:
    """Return a map in which the landmark `left` and the next are the sides of the marker 7."""
    plain = LandmarkMap.from_points(points, bottom_m=np.zeros(len(points)), top_m=np.full(len(points), 1.4))
    names = {k + side: f"tag36h11:7:{one}" for k in left for side, one in enumerate(("left", "right"))}
    return replace(plain, extra=tuple({"identity": names[k]} if k in names else {} for k in range(len(points))))


def driven(
    world: LandmarkMap, landmark_map: LandmarkMap, start: Array | None, *, is_turned: bool = False
) -> tuple[Array, Array, Array, Localiser]:
    """Return error (T,) m, p_correct (T,), seconds (T,) of a drive on a map, and the localiser.

    Edges of the world that have the name of a marker's side show it. is_turned: whether true poses are those turned by
    half a turn about the origin.
    """
    seconds = np.arange(0.0, 12.0, 0.2)
    poses = np.stack([-0.6 + 0.08 * seconds, 1.0 - 0.12 * seconds, 0.35 * np.sin(seconds)], axis=-1)
    truth = Trajectory((seconds * 1e9).astype(np.int64), poses)
    pose, p_correct, localiser = followed(world, landmark_map, start, truth, poses)
    error = pose - poses * ([-1, -1, 1] if is_turned else 1)
    return np.hypot(*error[:, :2].T), p_correct, seconds, localiser


def followed(
    world: LandmarkMap, landmark_map: LandmarkMap, start: Array | None, truth: Trajectory, odometry: Array
) -> tuple[Array, Array, Localiser]:
    """Return estimates (T, 3), p_correct (T,), and the localiser. odometry: (T, 3) poses as the wheels have them."""
    noise = EdgeNoise(endpoint_sigma_px=0.25, along_sigma_px=2.0, detection_probability=0.9, clutter_per_frame=2.0)
    edges = simulated_edges(world, CAMERA, truth, np.random.default_rng(3), noise=noise)
    names = [code_of(one["identity"])[0] if one else -1 for one in world.extra]
    localiser = Localiser(landmark_map, CAMERA, read_config(None, ["edges.markers=tag36h11"]), seed=1)
    if start is not None:
        localiser.start(start, np.diag([0.1, 0.1, 0.05]) ** 2, int(truth.t_ns[0]))
    frames = []
    for t_ns, pose, seen in zip(truth.t_ns.tolist(), odometry, edges, strict=True):
        localiser.odometry(t_ns, pose)
        frames += localiser.edges(t_ns, as_read(seen, np.array([*names, -1])))
    found = [one.located for one in frames]
    return np.array([one.estimate.pose for one in found]), np.array([one.p_correct for one in found]), localiser


def as_read(edges: Edges, names: np.ndarray) -> Edges:
    return replace(edges, landmark_id=names[edges.landmark_id])


def test_a_marker_tells_which_of_two_like_places_it_is() -> None:
    """In a room that is the same turned by half a turn, the robot is where the map has the marker, at either end."""
    for hung, is_turned in ((3, False), (3 + len(HALF), True)):
        error, p_correct, seconds, localiser = driven(marked(ROOM, 3), marked(ROOM, hung), None, is_turned=is_turned)
        found = (p_correct > 0.9) & (error < 0.2)
        assert found.any() and seconds[found.argmax()] <= 3.0
        assert not ((p_correct > 0.9) & (error > 0.5)).any() and not localiser.markers.warnings(localiser.landmark_map)


def test_a_marker_that_was_moved_by_2_m_is_told_of_and_carries_nothing_away() -> None:
    rng = np.random.default_rng(5)
    points = ROOM + rng.normal(0.0, 0.4, ROOM.shape)  # no two places alike
    moved = points.copy()
    moved[3:5] += [2.0, 0.0]
    for start in (np.array([-0.6, 1.0, 0.0]), None):
        error, p_correct, _, localiser = driven(marked(moved, 3), marked(points, 3), start)
        assert not ((p_correct > 0.9) & (error > 0.5)).any()
        assert (p_correct[30:] > 0.9).mean() > 0.9
        assert localiser.markers.warnings(localiser.landmark_map) == [
            "Marker 7 is not where the map has it: was it moved, or hung twice?"
        ]


def test_a_marker_that_hangs_twice() -> None:
    """A copy that the map does not have is told of; one that it has tells no place, and harms none."""
    rng = np.random.default_rng(5)
    points = ROOM + rng.normal(0.0, 0.4, ROOM.shape)
    start = np.array([-0.6, 1.0, 0.0])
    error, p_correct, _, localiser = driven(marked(points, 3, 0), marked(points, 0), start)
    assert not ((p_correct > 0.9) & (error > 0.5)).any() and (p_correct > 0.9).mean() > 0.9
    assert len(localiser.markers.warnings(localiser.landmark_map)) == 1
    both = marked(points, 3, 0)
    error, p_correct, _, localiser = driven(both, both, start)
    assert (error[p_correct > 0.9] < 0.2).all() and (p_correct > 0.9).mean() > 0.9
    assert localiser.markers.warnings(both) == ["Marker tag36h11:7 is on the map twice: it tells no place."]


def test_a_marker_frees_a_robot_that_was_carried_while_nothing_mapped_was_in_view() -> None:
    """It turned to a bare wall first, where no edge speaks against its place; other edges alone did not free it."""
    seconds = np.arange(0.0, 16.0, 0.2)
    turned = np.clip(seconds - 2.0, 0.0, 3.0) * (np.pi / 3.0)
    poses = np.stack([-0.6 + 0.06 * seconds, np.full(len(seconds), 1.0), turned], axis=-1)
    carried = seconds >= 7.0
    ahead = np.array([0.0, -0.12, 0.0]) * (seconds[carried] - 7.0)[:, None]
    poses[carried] = compose(np.array([1.6, 1.4, 0.3]), ahead)
    odometry = poses.copy()
    odometry[carried] = compose(poses[~carried][-1], ahead)
    world = marked(HALF + np.random.default_rng(5).normal(0.0, 0.3, HALF.shape), 3)
    truth = Trajectory((seconds * 1e9).astype(np.int64), poses)
    pose, p_correct, _ = followed(world, world, poses[0], truth, odometry)
    error = np.hypot(*(pose - poses)[:, :2].T)
    assert (error[~carried] < 0.2).all() and error[carried][0] > 1.5
    assert (error[-15:] < 0.2).all() and (p_correct[-15:] > 0.9).all()


# -- on the map -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_map_that_is_built_has_the_sides_where_they_hang() -> None:
    """Rendered: two shelves, each with a marker at its end."""
    from board.marked import AISLE_M, BOTTOM_M, DEPTH_M, PAPER_M
    from board.marked import world_of as shop

    world = shop("mapping")
    world["drive"] = world["drive"] | {"path": world["drive"]["path"][:4], "image_hz": 4.0}
    made = build_map(simulate_log(world_of(world)), config=read_config(None, ["edges.markers=tag36h11"])).landmark_map
    names = {one["identity"]: k for k, one in enumerate(made.extra) if "identity" in one}
    for side, sign in (("left", -1), ("right", 1)):
        place = names[f"tag36h11:0:{side}"]
        middle = AISLE_M + DEPTH_M / 2
        expected = [middle + sign * 0.4 * PAPER_M, -2.95]
        assert np.hypot(*(made.points[place] - expected)) < 0.03
        assert made.bottom_m[place] == pytest.approx(BOTTOM_M + 0.1 * PAPER_M, abs=0.05)
