"""The belief: no right place is left for its like, no floor is taken for another; what the scene knows of the past."""

from dataclasses import replace

import numpy as np
import pytest
from board.run import located, run
from board.worlds import hours_of
from simulated_edges import EdgeNoise, simulated_edges

from localiser import Localiser, LocatedFrame, read_config
from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter.belief import Belief
from localiser.filter.scene import APART, SCENE_M, Scene
from localiser.geometry import Increment, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.motion import MotionParameters
from localiser.observation import EdgeObservation, Matches, ObservationParameters, PlaceLandmarks, Sighting
from localiser.observation.place_landmarks import NEAR_SCENES
from localiser.particles import POSE, Particles
from localiser.relocalisation import Candidates
from localiser.storage import Site

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9))
STEP_M, STEP_NS, IMAGES = 0.1, 200_000_000, 60
START = np.diag([0.1, 0.1, np.radians(3.0)]) ** 2


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_hidden_landmarks_do_not_speak_for_a_place_that_has_none(seed: int) -> None:
    """A robot drives down a corridor with rooms behind its walls; at its copy, 40 m away, there are none.

    Both explain all that is seen. What the copy gains while nobody knows what is hidden, is soon over.
    """
    rng = np.random.default_rng(seed)
    shown = np.stack([np.tile([-1.0, 1.0], 8) + rng.normal(0, 0.1, 16), -rng.uniform(2, 12, 16)], axis=-1)
    side = np.tile([-1.0, 1.0], 12)
    hidden = np.stack([side * rng.uniform(1.3, 5.0, 24), -rng.uniform(2, 14, 24)], axis=-1)
    points = np.concatenate([shown, hidden, np.add(shown, [40.0, 0.0])])
    landmark_map = LandmarkMap.from_points(points, bottom_m=np.zeros(len(points)), top_m=np.full(len(points), 2.0))
    poses = np.stack([np.zeros(IMAGES), -STEP_M * np.arange(IMAGES), np.zeros(IMAGES)], axis=-1)
    truth = Trajectory(STEP_NS * np.arange(1, IMAGES + 1), poses)
    visible = np.tile(np.arange(len(points)) < len(shown), (IMAGES, 1))
    noise = EdgeNoise(detection_probability=0.85, clutter_per_frame=3.0)
    images = simulated_edges(landmark_map, CAMERA, truth, rng, noise=noise, visible=visible)
    robot = Localiser(landmark_map, CAMERA, read_config(None, ["observation.kind=line"]), seed)
    robot.start(poses[0], START, 0)
    there = replace(robot.state.particles, columns=robot.state.particles.columns.copy())
    there.columns[0] += 40.0
    robot.state.belief = Belief(0.99, 0.01, 0.0, 0.0, candidates=Candidates.of(there))
    robot.odometry(0, poses[0])
    for t_ns, pose, edges in zip(truth.t_ns, poses, images, strict=True):
        robot.edges(int(t_ns), edges)
        for frame in robot.odometry(int(t_ns), pose):
            assert np.hypot(*(frame.located.estimate.pose - pose)[:2]) < 0.5
    assert frame.located.p_correct > 0.9


def drive_with_a_wrong_map(seed: int, most_edges: int, images: int = 100) -> list[LocatedFrame]:
    """Return what a robot says in a corridor 2 m wide with the map of one 3 m wide."""
    rng = np.random.default_rng(seed)
    here, other = (
        np.stack([np.tile([-width / 2, width / 2], 16) + rng.normal(0, 0.1, 32), -rng.uniform(1, 24, 32)], axis=-1)
        for width in (2.0, 3.0)
    )
    maps = [LandmarkMap.from_points(one, bottom_m=np.zeros(32), top_m=np.full(32, 2.0)) for one in (here, other)]
    poses = np.stack([np.zeros(images), -STEP_M * np.arange(images), np.zeros(images)], axis=-1)
    truth = Trajectory(STEP_NS * np.arange(1, images + 1), poses)
    seen = simulated_edges(maps[0], CAMERA, truth, rng, noise=EdgeNoise(clutter_per_frame=3.0))
    robot = Localiser(maps[1], CAMERA, read_config(None, ["observation.kind=line"]), 0)
    robot.start(poses[0], START, 0)
    robot.odometry(0, poses[0])
    frames = []
    for t_ns, pose, edges in zip(truth.t_ns, poses, seen, strict=True):
        robot.edges(int(t_ns), edges.take(np.arange(len(edges)) < most_edges))
        frames += robot.odometry(int(t_ns), pose)
    return frames


@pytest.mark.slow
@pytest.mark.parametrize("most", [4, 100])
def test_a_map_is_said_not_to_fit_by_images_with_enough_edges_alone(most: int) -> None:
    """Where a robot sees few edges, they may be anything."""
    located = [frame.located for frame in drive_with_a_wrong_map(0, most)]
    assert located[-1].p_correct < 0.2
    assert (located[-1].warning == "this map does not fit") == (most > 4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["line", "slope"])
def test_the_map_of_another_floor_is_found_out(kind: str) -> None:
    """Its corridor is as wide, so the likelihood believes it for most of the way; the robot passes 10 m of doors."""
    drive, other = hours_of("floor", 1, 0.7), hours_of("floor", 2, 0.1).landmark_map
    start = drive.truth[0]
    runs = [run(drive, i, observation=kind, start=start, landmark_map=other, same_building=False) for i in range(5)]
    after_s = [told.seconds[told.warned.argmax()] if told.warned.any() else np.inf for told in runs]
    assert np.median(after_s) < 20.0 and sorted(after_s)[3] < 30.0, after_s
    assert all(told.sure[told.warned.argmax() :].mean() < 0.05 for told in runs if told.warned.any())
    right = run(drive, 1, observation=kind)
    assert not right.warned.any() and right.right.all() and right.sure.mean() > 0.95


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_robot_that_drives_on_where_nothing_is_mapped_keeps_its_place(seed: int) -> None:
    """The corridor goes on beyond its mapped part as one that is mapped 40 m away, so that this one fits by chance."""
    rng, images = np.random.default_rng(seed), 140
    z_m = -np.concatenate([rng.uniform(1, 7, 16), rng.uniform(7.5, 22, 32)])
    points = np.stack([np.tile([-1.0, 1.0], 24) + rng.normal(0, 0.1, 48), z_m], axis=-1)
    both = np.concatenate([points[:16], np.add(points[16:], [40.0, 0.0])])
    world, landmark_map = (
        LandmarkMap.from_points(one, bottom_m=np.zeros(48), top_m=np.full(48, 2.0)) for one in (points, both)
    )
    poses = np.stack([np.zeros(images), -STEP_M * np.arange(images), np.zeros(images)], axis=-1)
    truth = Trajectory(STEP_NS * np.arange(1, images + 1), poses)
    seen = simulated_edges(world, CAMERA, truth, rng, noise=EdgeNoise(clutter_per_frame=3.0))
    robot = Localiser(landmark_map, CAMERA, read_config(None, ["observation.kind=line"]), seed)
    robot.start(poses[0], START, 0)
    robot.odometry(0, poses[0])
    for t_ns, pose, edges in zip(truth.t_ns, poses, seen, strict=True):
        robot.edges(int(t_ns), edges)
        for frame in robot.odometry(int(t_ns), pose):
            assert np.hypot(*(frame.located.estimate.pose - pose)[:2]) < 0.5


CLOUD = Particles(POSE, np.zeros((3, 10)), np.zeros(10))
NINE, NONE = np.full((30, 1), 9.0), np.zeros((30, 1))
MISSED, MATCHED = (
    PlaceLandmarks(np.arange(30), scenes, scenes) for scenes in (np.hstack([NONE, NINE]), np.hstack([NINE, NONE]))
)


def test_landmarks_that_are_missing_speak_against_the_map_at_the_tracked_place() -> None:
    belief = Belief(0.9, 0.05, 0.0, 0.05, landmarks=MISSED)
    assert belief.warning and belief.p_correct(CLOUD, np.zeros(3), is_tracked=True) < 0.1
    assert belief.reason(0.1, Sighting(0, measurement=np.zeros(1))) == "edges contradict the map"


def test_landmarks_that_are_missing_say_nothing_of_the_map_where_the_robot_is_elsewhere() -> None:
    """It was carried, say, and the place that is still tracked is improbable."""
    belief = Belief(0.05, 0.6, 0.25, 0.1, landmarks=MISSED)
    assert not belief.warning
    assert belief.reason(0.1, Sighting(0, measurement=np.zeros(1))) == "several places fit"


@pytest.mark.parametrize("known", [MISSED, MATCHED])
def test_a_place_that_is_tracked_anew_is_tested_anew(known: PlaceLandmarks) -> None:
    """What was seen from another place speaks against the map, not for this place, and fades."""
    others = Candidates.of(replace(CLOUD, columns=CLOUD.columns + 5.0))
    found = Belief(0.001, 0.99, 0.0, 0.009, candidates=others, landmarks=known).found(is_tracked=True)
    for belief in (found[1], Belief(0.9, 0.05, 0.0, 0.05, landmarks=known).released(CLOUD)):
        assert not len(belief.landmarks.landmark)
        assert belief.landmarks.log_odds == min(known.log_odds, 0.0)
        later = belief.landmarks.after(Matches.none(5, 30), np.zeros((30, 2)), np.zeros(3), 1.0)
        assert later.log_odds == pytest.approx(np.exp(-1 / NEAR_SCENES) * belief.landmarks.log_odds)


def test_they_are_not_asked_for_where_nothing_can_be_elsewhere() -> None:
    """With known landmarks there is no global localisation, and p_correct does not judge the map."""
    drive, other = hours_of("floor", 1, 0.1), hours_of("floor", 2, 0.1)
    robot = Localiser(other.landmark_map, drive.camera, read_config(None, ["observation.association=known"]), 0)
    robot.start(drive.truth[0], np.diag([0.1, 0.1, np.radians(3.0)]) ** 2, int(drive.t_ns[0]))
    known = [replace(one, landmark_id=np.full(len(one), -1)) for one in drive.edges]
    assert len(list(located(robot, replace(drive, edges=known)))) == 30
    assert not len(robot.state.belief.landmarks.landmark)


def test_a_floor_that_nobody_mapped_is_as_likely_as_one_that_was_until_landmarks_tell() -> None:
    """Of a place that was found among two maps; one that was stated, or found on a single map, needs no proof."""
    drive, other = hours_of("floor", 1, 0.1), hours_of("floor", 2, 0.1)
    site = Site.beside([replace(drive.landmark_map, name="own"), replace(other.landmark_map, name="other")])
    for landmark_map, start, maps in ((site, None, 2), (site, drive.truth[0], 1), (drive.landmark_map, None, 1)):
        robot = Localiser(landmark_map, drive.camera, read_config(None), 0)
        if start is not None:
            robot.start(start, START, int(drive.t_ns[0]))
        list(located(robot, replace(drive, t_ns=drive.t_ns[:4], edges=drive.edges[:4])))
        assert robot.state.belief.landmarks.maps == maps
    found = PlaceLandmarks(maps=2)
    assert found.probability == found.elsewhere(2).probability == pytest.approx(2 / 3)
    belief = Belief(0.9, 0.05, 0.0, 0.05, landmarks=found)
    assert belief.p_correct(CLOUD, np.zeros(3), is_tracked=True) == pytest.approx(0.6) and not belief.warning
    assert belief.reason(0.6, Sighting(0, measurement=np.zeros(1))) == "several places fit"
    nine = [PlaceLandmarks(np.arange(9), one.seen[:9], one.near[:9], maps=2) for one in (MATCHED, MISSED)]
    seen, missed = (replace(belief, landmarks=one) for one in nine)
    assert seen.p_correct(CLOUD, np.zeros(3), is_tracked=True) > 0.89 and missed.warning


OBSERVATION = EdgeObservation(CAMERA, ObservationParameters())


def image(bearings: list[float], t_ns: int = 0) -> Sighting:
    angle = np.array(bearings)
    return Sighting(t_ns, Edges.from_columns(angle, np.full(len(angle), 0.002), angle, np.full(len(angle), 0.002)))


def driven(step_m: float, images: int) -> tuple[Scene, list[float]]:
    """Return the scene after so many images of the same edges, and the novelty of each."""
    scene, novelties = Scene(), []
    for index in range(images):
        increment = Increment.from_mean([0.0, -step_m if index else 0.0, 0.0])
        scene, _, jump = scene.followed(OBSERVATION, MotionParameters(), image([-0.2, 0.0, 0.3]), increment)
        novelties.append(jump.novelty)
    return scene, novelties


@pytest.mark.parametrize("step_m", [0.0, 1e-4, 1e-3, 0.02])
def test_few_images_are_kept_however_slowly_the_robot_moves(step_m: float) -> None:
    scene, _ = driven(step_m, 500)
    assert len(scene.images) <= 2 / APART + 3
    if step_m * 500 > 2 * SCENE_M:
        assert SCENE_M <= (scene.moved.path_m - scene.images[0].moved.path_m) < SCENE_M * (1 + 3 * APART)


def test_an_image_is_as_new_as_the_way_is_long() -> None:
    _, novelties = driven(0.06, 10)
    assert novelties[0] == 1.0
    np.testing.assert_allclose(novelties[1:], 0.06 / SCENE_M)


@pytest.mark.parametrize(
    ("bearings", "least", "most"),
    [
        ([-0.2, 0.0, 0.3], 0.0, 3e-5),  # all continue
        ([], 3e-4, 3e-4),  # dark: what remains is the chance of being led astray
        ([0.12], 3e-4, 0.01),  # one new edge is hardly evidence
        ([-0.2, 0.0, 0.3, 0.12, 0.45], 1e-5, 5e-4),  # two come into view
        ([-0.5, -0.4, 0.12, 0.2, 0.45], 0.01, 0.2),
        ([-0.5, -0.45, -0.4, -0.35, -0.3, 0.12, 0.15, 0.2, 0.4, 0.45], 0.1, 0.6),
        ([*np.linspace(-0.6, -0.25, 15), *np.linspace(0.05, 0.25, 10), *np.linspace(0.35, 0.6, 15)], 0.5, 1.0),
    ],
)
def test_a_robot_was_carried_where_many_edges_continue_none(bearings: list[float], least: float, most: float) -> None:
    scene, _ = driven(0.06, 10)
    whole_scene = Increment.from_mean(np.array([0.0, -SCENE_M, 0.0]))
    found = scene.followed(OBSERVATION, MotionParameters(), image(bearings), whole_scene)[2]
    assert least * 0.999 <= found.carried(3e-4) <= most * 1.001
