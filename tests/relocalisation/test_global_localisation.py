"""A robot whose place is not known, or is known wrongly, or is not on the map: the belief, and what is said of it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from proposal_room import CAMERA, room
from simulated_edges import EdgeNoise, simulated_edges

from localiser import geometry, particles
from localiser.edges import Edges
from localiser.filter import FilterState, Located, Mcl, MclParameters, Odometry, Sighting, Start, step
from localiser.filter.belief import BARE, Belief
from localiser.filter.events import is_near
from localiser.filter.motion_hypotheses import Jump
from localiser.geometry import Array, Increment, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.motion import MotionParameters
from localiser.observation import DETECTION_RATES, EdgeObservation, ObservationParameters
from localiser.particles import CAMERA_YAW, POSE, Clusters, Particles, cells_of, find_clusters
from localiser.relocalisation import Candidates, History
from localiser.relocalisation.global_localisation import FEWEST_EDGES, GlobalLocalisation, SearchParameters
from localiser.relocalisation.hypotheses import Feet

SECOND = 1_000_000_000
ROOM = room(80)
CORRELATION = ObservationParameters()
OBSERVATION = EdgeObservation(CAMERA, CORRELATION)
SEARCH = GlobalLocalisation.of(OBSERVATION, ROOM, SearchParameters(particles_most=3000))
FILTER = Mcl(ROOM, OBSERVATION, MclParameters(particles=500, start_particles=2000), search=SEARCH)


def cloud(poses: Array, log_weight: Array | None = None) -> Particles:
    return Particles(
        POSE, np.asarray(poses, dtype=float).T.copy(), np.zeros(len(poses)) if log_weight is None else log_weight
    )


@dataclass(frozen=True)
class Drive:
    """Where a robot truly was, what its wheels say of it, and what it saw."""

    truth: Array
    odometry: Array
    events: list[object]


def drive(frames: int, carried_at: int | None = None, seed: int = 0, clutter: float = 4.0) -> Drive:
    """A robot that drives in a circle; `carried_at` an image it stands elsewhere, which its wheels do not know."""
    motion = np.array([0.0, -0.12, 0.05])
    truth, odometry = [np.array([1.0, 1.5, 0.3])], [np.zeros(3)]
    for frame in range(1, frames):
        truth.append(geometry.compose(truth[-1], motion))
        odometry.append(geometry.compose(odometry[-1], motion))
        if frame == carried_at:
            truth[-1] = np.array([-1.5, 0.5, -2.5])
    rng = np.random.default_rng(seed)
    t_ns = np.arange(frames) * SECOND // 5
    noise = EdgeNoise(detection_probability=0.8, clutter_per_frame=clutter)
    edges = simulated_edges(ROOM, CAMERA, Trajectory(t_ns, np.array(truth)), rng, noise=noise)
    pairs = zip(t_ns, odometry, edges, strict=True)
    events = [event for t, pose, seen in pairs for event in (Odometry(int(t), pose), Sighting(int(t), seen))]
    return Drive(np.array(truth), np.array(odometry), events)


def located(events: list[object], seed: int = 0, mcl: Mcl = FILTER) -> list[Located]:
    state, rng = FilterState(), np.random.default_rng(seed)
    return [found for event in events for found in step(mcl, state, event, rng)]  # type: ignore[arg-type]


def is_right(found: list[Located], truth: Array) -> Array:
    return np.array([is_near(one.estimate.pose[None], pose)[0] for one, pose in zip(found, truth, strict=True)])


# -- the whole way ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_without_a_start_is_found(seed: int) -> None:
    driven = drive(20, seed=seed)
    found = located(driven.events, seed)
    assert np.hypot(*(found[-1].estimate.pose - driven.truth[-1])[:2]) < 0.1
    assert found[-1].p_correct > 0.9 and found[-1].reason == ""
    assert len(found[-1].particles) == FILTER.parameters.particles, "as many as the way needs"
    sure = np.array([one.p_correct > 0.9 for one in found])
    assert is_right(found, driven.truth)[sure].all()


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_is_carried_away_is_found_again(seed: int) -> None:
    driven = drive(50, carried_at=15, seed=seed)
    start = Start(0, driven.truth[0], np.diag([0.1, 0.1, 0.05]) ** 2)
    found = located([start, *driven.events], seed)
    right = is_right(found, driven.truth)
    sure = np.array([one.p_correct > 0.9 for one in found])
    assert right[:15].all() and right[20:].all() and sure[-1]
    jumps = np.flatnonzero([one.took_over for one in found])
    assert len(jumps) and (jumps >= 15).all() and right[jumps[-1]]
    assert (sure & ~right).sum() <= 3


def test_a_wrong_start_is_noticed() -> None:
    driven = drive(40)
    start = Start(0, np.array([-2.0, -1.5, 2.0]), np.diag([0.1, 0.1, 0.05]) ** 2)
    state, rng, found, paces = FilterState(), np.random.default_rng(0), [], []
    for event in [start, *driven.events]:
        found += step(FILTER, state, event, rng)
        paces += [state.wheels.pace] if isinstance(event, Sighting) else []
    assert is_right(found, driven.truth)[-5:].all()
    jumped = [pace for pace, one in zip(paces, found, strict=True) if one.took_over]
    assert jumped and all(pace is None for pace in jumped) and paces[-1] is not None


def test_a_search_changes_nothing_while_the_robot_is_where_it_is_believed() -> None:
    """The same estimates as without a search, to a millimetre: only p_correct differs, by which clutter is expected."""
    driven = drive(25)
    start = Start(0, driven.truth[0], np.diag([0.1, 0.1, 0.05]) ** 2)
    for one, other in zip(
        located([start, *driven.events]),
        located([start, *driven.events], mcl=replace(FILTER, search=None)),
        strict=True,
    ):
        np.testing.assert_allclose(one.estimate.pose, other.estimate.pose, atol=1e-3)
        assert one.p_correct > 0.9


def test_edges_that_show_no_landmark_cost_confidence_and_are_named() -> None:
    driven = drive(30)
    noise = EdgeNoise(detection_probability=0.0, clutter_per_frame=25.0)
    truth = Trajectory(np.arange(30) * SECOND // 5, driven.truth)
    empty = simulated_edges(ROOM, CAMERA, truth, np.random.default_rng(5), noise=noise)
    events = [replace(event, edges=empty.pop(0)) if isinstance(event, Sighting) else event for event in driven.events]
    found = located([Start(0, driven.truth[0], np.diag([0.05, 0.05, 0.02]) ** 2), *events])
    assert found[-1].p_correct < 0.9
    assert found[-1].reason in ("edges contradict the map", "several places fit")


@pytest.mark.parametrize("seed", [0, *(pytest.param(each, marks=pytest.mark.slow) for each in (1, 2))])
def test_a_robot_off_the_map_is_never_sure(seed: int) -> None:
    """The mirrored room has as many landmarks, but the edges are of none of them."""
    driven = drive(40, seed=seed)
    mirrored = replace(ROOM, points=ROOM.points * [-1.0, 1.0])
    elsewhere = replace(FILTER, landmark_map=mirrored, search=GlobalLocalisation.of(OBSERVATION, mirrored))
    assert max(one.p_correct for one in located(driven.events, seed, elsewhere)) < 0.9


def another_room() -> LandmarkMap:
    few = ROOM.take(np.arange(0, len(ROOM), 10))
    return replace(few, points=few.points * [-1.0, 1.0])


@pytest.mark.slow  # quick: edges that show no landmark, above
def test_a_map_that_does_not_fit_is_named() -> None:
    """A tenth of the landmarks, mirrored: the map of another room."""
    driven, named = drive(150), []
    for landmark_map in (ROOM, another_room()):
        search = GlobalLocalisation.of(OBSERVATION, landmark_map, SearchParameters(particles_most=3000))
        found = located(driven.events, mcl=replace(FILTER, landmark_map=landmark_map, search=search))
        named.append(np.flatnonzero([bool(one.warning) for one in found]))
    assert len(named[0]) == 0 and len(named[1]) and named[1][0] < 120


# -- the belief -------------------------------------------------------------------------------------------------------


def places(poses: Array, log_weight: Array | None = None) -> Candidates:
    return Candidates.of(cloud(poses, log_weight))


def total(belief: Belief) -> float:
    return belief.tracked + belief.unmapped + belief.elsewhere + belief.unexplored + belief.off_map


def seen(
    belief: Belief,
    sighting: Sighting,
    at: Array,
    novelty: float = 1.0,
    log_ratio: float = 0.0,
    search: GlobalLocalisation = SEARCH,
) -> Belief:
    few = cloud(np.tile(at, (50, 1)))
    return after(belief, sighting, Jump(novelty, log_ratio), few, few, search)


def after(
    belief: Belief,
    sighting: Sighting,
    jump: Jump,
    few: Particles | None,
    like: Particles,
    search: GlobalLocalisation = SEARCH,
) -> Belief:
    """Return the belief after an image of a robot that stood still."""
    still = Increment.from_mean(np.zeros(3))
    return belief.after(search, few, like, sighting, jump, still, MotionParameters(), np.random.default_rng(0))


def test_probabilities_add_up_to_one_and_follow_the_edges() -> None:
    driven = drive(1)
    sighting, truth = driven.events[1], driven.truth[0]
    right = seen(Belief.stated(), sighting, truth)  # type: ignore[arg-type]
    wrong = seen(Belief.stated(), sighting, truth + np.array([1.0, 0.5, 2.0]))  # type: ignore[arg-type]
    for belief in (right, wrong, right.beside(truth)):
        assert total(belief) == pytest.approx(1.0)
    assert right.tracked > 0.99 and wrong.tracked < 0.5
    assert wrong.elsewhere > 0.1 and wrong.candidates is not None, "the image proposes where else the robot may be"


def test_an_image_of_the_same_scene_changes_nothing() -> None:
    driven = drive(1)
    belief = Belief(0.7, 0.0, 0.1, 0.2, unproposed=0.0)
    again = seen(belief, driven.events[1], driven.truth[0] + 1.0, novelty=0.0)  # type: ignore[arg-type]
    assert (again.tracked, again.unexplored, again.off_map) == pytest.approx((0.7, 0.1, 0.2))


def test_a_robot_that_stands_still_gets_the_same_candidates() -> None:
    """Moving copies of them in every image of one scene would spread them."""
    driven, poses = drive(1), np.random.default_rng(1).normal(0, 0.3, (300, 3))
    belief = replace(Belief.stated(), tracked=0.6, elsewhere=0.2, candidates=places(poses), unproposed=0.0)
    for _ in range(20):
        belief = seen(belief, driven.events[1], driven.truth[0], novelty=0.0)  # type: ignore[arg-type]
    np.testing.assert_array_equal(belief.candidates.particles.poses[:, :2], poses[:, :2])


def test_a_robot_that_creeps_looks_elsewhere_too() -> None:
    """Each image is hardly new, but five of them together are."""
    driven = drive(1)
    belief = replace(Belief.stated(), tracked=0.1, off_map=0.8, unproposed=0.0)
    proposed = []
    for _ in range(12):
        belief = seen(belief, driven.events[1], driven.truth[0] + 1.0, novelty=0.022)  # type: ignore[arg-type]
        proposed.append(belief.unproposed == 0.0)
    assert np.flatnonzero(proposed).tolist() == [4, 9] and belief.candidates is not None


def test_a_robot_that_sees_nothing_of_the_map_becomes_unsure() -> None:
    """From five metres outside the room, looking away, no landmark is in view; edges are."""
    sighting, away = drive(1).events[1], np.array([0.0, 40.0, np.pi])
    belief = replace(Belief.stated(), tracked=0.98, unexplored=0.01, off_map=0.01)
    bare = seen(belief, sighting, away)  # type: ignore[arg-type]
    odds = (bare.off_map / bare.here) / (belief.off_map / belief.here)
    assert np.log(odds) == pytest.approx(BARE, abs=0.003)
    empty = seen(Belief.stated(), Sighting(0, Edges.from_columns(*np.full((4, 0), 0.1))), away)
    assert empty.off_map / empty.here == pytest.approx(0.25 / 0.7, abs=0.01), "an image without edges says nothing"


def test_surroundings_that_are_not_mapped_leave_the_place_known() -> None:
    """A robot that is surely tracked, and then sees things that fit nothing for ten scenes."""
    truth = np.array([1.0, 1.5, 0.3])
    noise = EdgeNoise(detection_probability=0.0, clutter_per_frame=25.0)
    still = Trajectory(np.arange(10) * SECOND, np.tile(truth, (10, 1)))
    belief = Belief(1.0 - 2e-12, 0.0, 1e-12, 1e-12, history=History(entered=np.array([1e-12])))
    for edges in simulated_edges(ROOM, CAMERA, still, np.random.default_rng(5), noise=noise):
        belief = seen(belief, Sighting(0, edges), truth)
    assert belief.unmapped > 1e-3, "beside a tracked place of which hardly anything is seen"
    assert belief.here > 0.8 and total(belief) == pytest.approx(1.0)


def test_candidates_can_be_wrong_too() -> None:
    """Without tracked particles, the robot may have been carried, or have left the map, just the same."""
    belief = Belief(0.0, 1.0, 0.0, 0.0, places(np.random.default_rng(1).normal(0, 0.1, (200, 3))), unproposed=0.0)

    def carried(log_ratio: float) -> Belief:
        return after(belief, Sighting(0), Jump(1.0, log_ratio), None, cloud(np.zeros((5, 3))))

    assert carried(9.0).unexplored == pytest.approx(Jump(1.0, 9.0).carried(3e-4), abs=0.01)
    moved = carried(100.0)
    assert moved.unexplored == pytest.approx(0.9, abs=0.01), "an image may also be blurred, or a turn missed"
    assert moved.off_map > 1e-5 and total(moved) == pytest.approx(1.0)


def test_a_robot_that_begins_in_the_dark_and_stands_is_found_when_it_sees() -> None:
    driven, still = drive(1), []
    for number in range(6):
        edges = driven.events[1].edges if number else Edges.from_columns(*np.full((4, 0), 0.1))  # type: ignore[attr-defined]
        still += [Odometry(number * SECOND, np.zeros(3)), Sighting(number * SECOND, edges)]
    found = located(still)
    assert is_near(found[-1].estimate.pose[None], driven.truth[0])[0]


def test_particles_that_are_released_keep_their_odds() -> None:
    poses = np.random.default_rng(0).normal(2.0, 0.1, (50, 3))
    belief = Belief(4e-4, 0.8, 0.0, 0.1994, places(np.zeros((100, 3))), unmapped=2e-4)
    found = belief.released(cloud(poses))
    assert found.here == 0.0 and total(found) == pytest.approx(total(belief))
    weight = found.candidates.particles.weight
    assert weight[100:].sum() / weight[:100].sum() == pytest.approx(6e-4 / 0.8)
    alone = Belief(0.0, 0.0, 0.0, 1.0).released(cloud(poses))
    assert alone.elsewhere == 0.0 and alone.candidates is not None and len(alone.candidates) == 50


def test_a_place_takes_over_when_nothing_else_explains_the_edges() -> None:
    rng = np.random.default_rng(0)
    one, many = places(rng.normal(0, 0.05, (500, 3))), places(rng.uniform(-3, 3, (500, 3)))

    def wins(tracked: float, elsewhere: float, candidates: Candidates, *, is_tracked: bool = True) -> bool:
        belief = Belief(tracked, elsewhere, 0.0, 1.0 - tracked - elsewhere, candidates)
        return belief.found(is_tracked=is_tracked) is not None

    assert wins(0.0005, 0.9, one)
    assert wins(0.0, 0.9, one), "the particles' probability may be too small for a number"
    assert not wins(0.03, 0.9, one), "not yet fifty to one"
    assert not wins(0.0001, 0.2, one), "most probably off the map"
    assert not wins(0.0005, 0.9, many)
    assert wins(0.0, 0.2, one, is_tracked=False)
    assert not wins(0.0, 0.02, one, is_tracked=False), "the best of all places, and an improbable one"
    found = Belief(0.0, 0.6, 0.0, 0.4, one).found(is_tracked=False)
    assert found is not None and found[1].tracked == pytest.approx(0.6) and len(found[0]) == 500


def test_a_place_that_an_image_proposed_is_sure_when_the_true_one_can_hardly_have_been_overlooked() -> None:
    """A stated place needs no search. One that was found does, until it counts as one that was stated."""
    driven, pose = drive(1), drive(1).truth[0]
    assert Belief.stated().p_correct(cloud(pose[None]), pose, is_tracked=True) == pytest.approx(0.7)
    found = Belief(0.999, 0.0, 0.0, 0.001, is_known=False)
    p_correct, known = [], []
    for _ in range(15):
        found = seen(found, driven.events[1], pose, novelty=0.4)  # type: ignore[arg-type]
        p_correct.append(found.p_correct(cloud(pose[None]), pose, is_tracked=True))
        known.append(found.is_known)
    assert p_correct[:4] == pytest.approx(1.0 - 0.3 ** (0.4 * np.arange(1, 5)), abs=0.01)
    assert known == [False] * 11 + [True] * 4 and p_correct[-1] > 0.995


def test_a_known_place_is_not_looked_for_however_large_the_doubt_that_is_allowed() -> None:
    driven, pose = drive(1), drive(1).truth[0]
    search = replace(SEARCH, parameters=replace(SEARCH.parameters, doubt=0.9))
    found = Belief(0.999, 0.0, 0.0, 0.001, is_known=False)
    for _ in range(10):
        found = seen(found, driven.events[1], pose, novelty=0.5, search=search)  # type: ignore[arg-type]
    assert found.p_correct(cloud(pose[None]), pose, is_tracked=True) > 0.9


def test_a_place_that_takes_over_is_one_that_was_found() -> None:
    one = places(np.random.default_rng(0).normal(0, 0.05, (500, 3)))
    carried = Belief(0.0005, 0.9, 0.0, 0.0995, one, overlooked=0.3).found(is_tracked=True)
    assert carried is not None and not carried[1].is_known and carried[1].overlooked == 0.3
    released = Belief(4e-4, 0.8, 0.0, 0.1996, one, overlooked=0.3).released(cloud(np.zeros((5, 3))))
    assert not released.is_known and released.overlooked == 0.3
    assert not Belief.anywhere().is_known and Belief.stated().is_known


def test_who_is_carried_may_be_where_nobody_looked() -> None:
    """The search before counts for nothing. The image itself may look for as much as it takes."""
    driven = drive(1)
    belief = Belief(0.9, 0.0, 0.05, 0.05, overlooked=0.01)
    moved = seen(belief, driven.events[1], driven.truth[0] + 1.0, novelty=0.2, log_ratio=100.0)  # type: ignore[arg-type]
    assert moved.overlooked == pytest.approx(0.9 * 0.3, abs=0.01)


def test_only_the_first_image_of_a_search_takes_twice_the_effort() -> None:
    """Also where none of its poses explains the edges."""
    driven, pose = drive(1), drive(1).truth[0]
    after_first = replace(Belief.anywhere(), overlooked=0.09)
    first, second = (
        after(belief, driven.events[1], Jump(0.2), None, cloud(pose[None]))  # type: ignore[arg-type]
        for belief in (Belief.anywhere(), replace(after_first, unproposed=0.0))
    )
    assert first.overlooked == pytest.approx(0.09)
    assert second.overlooked == pytest.approx(0.09 * 0.3**0.2, rel=0.01)


def test_what_was_overlooked_is_another_place_and_not_a_contradiction() -> None:
    held_back = Belief(0.985, 0.0, 0.005, 0.01, is_known=False, overlooked=0.5)
    sighting = drive(1).events[1]
    assert held_back.reason(0.49, sighting) == "several places fit"  # type: ignore[arg-type]
    assert replace(held_back, is_known=True).reason(0.49, sighting) == "edges contradict the map"  # type: ignore[arg-type]


def test_candidates_are_not_where_the_robot_is_tracked() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 0.1], [3.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    belief = Belief(0.5, 0.4, 0.0, 0.1, places(poses)).beside(np.zeros(3))
    np.testing.assert_array_equal(belief.candidates.particles.poses, poses[2:])
    assert (belief.tracked, belief.elsewhere) == pytest.approx((0.7, 0.2))
    near = Belief(0.5, 0.4, 0.0, 0.1, places(poses[:2])).beside(np.zeros(3))
    assert near.candidates is None and near.tracked == pytest.approx(0.9)


# -- places that are proposed late -------------------------------------------------------------------------------------


def followed_from(
    first: int, monkeypatch: pytest.MonkeyPatch, carried_at: int | None = None, *, is_told: bool = True
) -> list[Belief]:
    """Return what is believed in twelve images, of which one, `first`, proposes 400 poses around the true one.

    They are so small a part of the region that it takes all images to believe in them. carried_at: image before which
    the robot was carried. is_told: whether its edges tell so. Odometry is exact but for that.
    """
    images, increment, model = (
        drive(12, carried_at),
        Increment.from_mean([0.0, -0.12, 0.05]),
        MotionParameters(0, 0, 0, 0),
    )
    rng, belief, believed = np.random.default_rng(0), Belief.anywhere(), []

    def proposed(*_: object) -> object:
        if len(believed) != first:
            return places(np.zeros((0, 3))), 0.0
        poses = images.truth[first] + rng.normal(0.0, [0.03, 0.03, 0.01], (400, 3))
        return places(poses, np.full(400, np.log(1e-80 / 400))), 0.0

    monkeypatch.setattr(GlobalLocalisation, "proposed", proposed)
    for index, sighting in enumerate(images.events[1::2]):
        jump = Jump(0.6 if index else 1.0, 20.0 if is_told and index == carried_at else 0.0)
        if belief.candidates is not None:
            moved = model.predict(belief.candidates.particles, increment, rng)
            belief = replace(belief, candidates=replace(belief.candidates, particles=moved))
        like = cloud(np.zeros((5, 3)))
        belief = belief.after(SEARCH, None, like, sighting, jump, increment, model, rng)  # type: ignore[arg-type]
        believed.append(belief)
    return believed


def gained(belief: Belief) -> float:
    """Return by how many nats the odds of the poses that were proposed have grown."""
    return float(np.log(belief.elsewhere) - np.log(belief.off_map) + 80 * np.log(10.0))


def test_a_place_is_as_likely_whenever_it_is_proposed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Images before count for it. The last image alone tells less by far."""
    at_once, late = (followed_from(first, monkeypatch) for first in (0, 10))
    assert gained(late[-1]) == pytest.approx(gained(at_once[-1]), rel=0.15)
    assert late[9].elsewhere == 0.0
    monkeypatch.setattr(History, "with_image", lambda history, _: replace(history, new=0.0))
    assert gained(followed_from(10, monkeypatch)[-1]) < 0.3 * gained(late[-1])


def test_images_before_a_robot_was_carried_do_not_count_for_where_it_is_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """The place is proposed by the first image there, or three images later."""
    at_once, late = (followed_from(first, monkeypatch, carried_at=7)[-1] for first in (7, 10))
    assert gained(late) == pytest.approx(gained(at_once), rel=0.15)
    assert gained(followed_from(10, monkeypatch, 7, is_told=False)[-1]) < gained(late) - 8.0


def test_what_is_unexplored_and_what_entered_it_agree_while_nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    for belief in followed_from(99, monkeypatch, carried_at=5):
        history = belief.history
        assert history.entered.sum() == pytest.approx(belief.unexplored)


def test_a_pose_near_the_tracked_place_is_no_other_place(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = drive(1).truth[0]
    near = places(truth + np.random.default_rng(0).normal(0.0, 0.05, (50, 3)))
    monkeypatch.setattr(GlobalLocalisation, "proposed", lambda *_: (near, 0.0))
    belief = seen(Belief.stated(), drive(1).events[1], truth)  # type: ignore[arg-type]
    assert belief.candidates is None and belief.elsewhere == 0.0


# -- candidates -------------------------------------------------------------------------------------------------------


def test_proposed_poses_keep_the_constant_errors_and_see_through_them() -> None:
    """A robot whose camera is turned by 0.02 has a heading that is as much less, and is as likely."""
    sighting = drive(1).events[1]
    straight, turned = (
        Particles((*POSE, CAMERA_YAW), np.array([[0.0, 0.0, 0.0, yaw]]).T, np.zeros(1)) for yaw in (0.0, 0.02)
    )
    (first, _), (second, _) = (
        SEARCH.proposed(like, sighting, 0.5, np.random.default_rng(0))  # type: ignore[arg-type]
        for like in (straight, turned)
    )
    one, other = first.particles, second.particles
    assert (other[CAMERA_YAW] == 0.02).all() and np.array_equal(one.log_weight, other.log_weight)
    np.testing.assert_allclose(geometry.wrap_angle(one["heading"] - other["heading"]), 0.02)
    np.testing.assert_allclose(*(SEARCH.evidence(each, sighting)[0] for each in (one, other)), atol=1e-6)  # type: ignore[arg-type]


def test_joined_candidates_have_the_odds_that_are_asked_for() -> None:
    both = places(np.zeros((3, 3))).joined(places(np.ones((5, 3)), np.arange(5.0)), np.log(0.25))
    weight = both.particles.weight
    assert weight[3:].sum() / weight[:3].sum() == pytest.approx(0.25)
    np.testing.assert_allclose(weight[4:] / weight[3:-1], np.e)
    assert both.rates.shape == (len(DETECTION_RATES), 8)


def test_a_place_of_little_weight_is_kept_with_its_weight() -> None:
    rng = np.random.default_rng(0)
    poses = np.concatenate([rng.normal(0.1, 0.01, (1000, 3)), rng.normal(2.1, 0.01, (10, 3))])
    log_weight = np.concatenate([np.zeros(1000), np.full(10, np.log(1e-3))])
    before = places(poses, log_weight)
    after = before.resampled(4000, rng)
    away = [float(one.particles.weight[one.particles.poses[:, 0] > 1.0].sum()) for one in (before, after)]
    assert away[1] == pytest.approx(away[0], rel=1e-6)
    assert (after.particles.poses[:, 0] > 1.0).sum() >= 3
    assert len(before.resampled(50, rng)) == 50


def test_candidates_learn_the_detection_rate_where_they_are() -> None:
    fits_often, fits_seldom = np.linspace(0, 20, len(DETECTION_RATES)), np.linspace(0, -20, len(DETECTION_RATES))
    found = places(np.zeros((2, 3)))
    for _ in range(3):
        found, log_mean = found.weighed(np.stack([fits_often, fits_seldom], axis=1), 1.0, needs_landmarks=False)
    assert found.rates[-1, 0] > 0.9 and found.rates[0, 1] > 0.9
    np.testing.assert_allclose(found.rates.sum(axis=0), 1.0)
    assert found.particles.weight[0] > 0.999 and log_mean > 15.0


def test_places_from_which_nothing_of_the_map_is_seen_are_given_up() -> None:
    by_rate = np.zeros((len(DETECTION_RATES), 2))
    by_rate[:, 1] = -0.5
    kept, _ = places(np.zeros((2, 3))).weighed(by_rate, 1.0, needs_landmarks=True)
    assert kept.particles.weight[0] < 1e-100


# -- particles of one place -------------------------------------------------------------------------------------------


def two_places(rng: np.random.Generator) -> Candidates:
    """40 particles in one cell of floor and heading, and 60 in another one."""
    poses = np.concatenate(
        [rng.uniform([0, 0, 0], [0.2, 0.2, 0.1], (40, 3)), rng.uniform([5, 5, 1.1], [5.1, 5.1, 1.2], (60, 3))]
    )
    assert len(np.unique(cells_of(poses))) == 2
    return Candidates.of(cloud(poses, rng.normal(size=100)))


def test_particles_of_a_cell_share_its_weight_as_tracked_ones_would() -> None:
    """Σ over a cell is that by p(edges | pose, p_k); within it w_i ∝ w_i p(edges | pose_i)^ν of the filter."""
    rng = np.random.default_rng(0)
    before, by_rate, within, novelty = two_places(rng), rng.normal(size=(6, 100)), 3.0 * rng.normal(size=100), 0.4
    plain, log_plain = before.weighed(by_rate, novelty, needs_landmarks=False)
    after, log_mean = before.weighed(by_rate, novelty, needs_landmarks=False, within=within)
    assert log_mean == log_plain
    assert np.array_equal(after.rates, plain.rates)
    for one in (slice(0, 40), slice(40, 100)):
        weight = np.exp(after.particles.log_weight[one])
        assert weight.sum() == pytest.approx(np.exp(plain.particles.log_weight[one]).sum())
        expected = np.exp(before.particles.log_weight[one] + novelty * within[one])
        assert weight / weight.sum() == pytest.approx(expected / expected.sum())


def test_a_pose_that_sees_no_landmark_is_given_up_however_well_the_filter_likes_it() -> None:
    rng = np.random.default_rng(1)
    before, by_rate = two_places(rng), rng.normal(size=(6, 100))
    by_rate[:, 3] = 0.0
    after, _ = before.weighed(by_rate, 1.0, needs_landmarks=True, within=np.where(np.arange(100) == 3, 50.0, 0.0))
    assert after.particles.weight[3] < 1e-150


@pytest.mark.parametrize("seed", range(3))
def test_images_are_likelier_where_the_particles_of_a_place_lie_as_near_the_edges_as_tracked_ones(seed: int) -> None:
    """The evidence of the true place over 40 images, with and without weights by the filter's own likelihood."""
    as_tracked, as_places_are = (
        evidence_of_the_truth(drive(40, seed=seed), seed, as_tracked=one) for one in (True, False)
    )
    assert as_tracked > as_places_are + 3.0


def evidence_of_the_truth(images: Drive, seed: int, *, as_tracked: bool) -> float:
    """Return the sum over images of log mean p(edges | candidate), for candidates from near the true start on."""
    rng, motion = np.random.default_rng(seed), MotionParameters()
    start = particles.from_gaussian(images.truth[0], np.diag([0.1, 0.1, 0.05]) ** 2, 2000, rng)
    candidates, total, before = Candidates.of(start), 0.0, images.odometry[0]
    sightings = [event for event in images.events if isinstance(event, Sighting)]
    for odometry, sighting in zip(images.odometry, sightings, strict=True):
        increment, before = Increment.from_mean(geometry.between(before, odometry)), odometry
        moved = replace(candidates, particles=motion.predict(candidates.particles, increment, rng))
        within = OBSERVATION.log_likelihood(moved.particles, sighting, ROOM) if as_tracked else None
        by_rate, _ = SEARCH.evidence(moved.particles, sighting)
        candidates, log_mean = moved.weighed(by_rate, 0.4, needs_landmarks=False, within=within)
        candidates = candidates.resampled(2000, rng)
        total += log_mean
    return total


# -- what is said of it -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("poses", "off_map", "edges", "p_correct", "reason"),
    [
        ([[0, 0, 0], [0.1, 0, 0]], 0.0, 5, 1.0, ""),
        ([[0, 0, 0], [3, 0, 0]], 0.0, 5, 0.5, "several places fit"),
        ([[0, 0, 0], [0.1, 0, 0]], 0.7, 5, 0.3, "edges contradict the map"),
        ([[0, 0, 0], [0.1, 0, 0]], 0.7, 0, 0.3, "no edges"),
    ],
)
def test_confidence(poses: list[list[float]], off_map: float, edges: int, p_correct: float, reason: str) -> None:
    belief = Belief(1.0 - off_map, 0.0, 0.0, off_map)
    found = belief.p_correct(cloud(np.array(poses)), np.zeros(3), is_tracked=True)
    sighting = Sighting(0, Edges.from_columns(*np.full((4, edges), 0.1)))
    assert found == pytest.approx(p_correct)
    assert belief.reason(found, sighting) == reason


def test_clusters_of_belief_and_candidates_share_the_weight() -> None:
    rng = np.random.default_rng(0)
    here, there = (find_clusters(rng.normal(at, 0.02, (200, 3)), np.ones(200), mass=1.0) for at in (0.1, 2.0))
    both: Clusters = here.beside(there, 0.7)
    assert both.weight.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(both.mean[0, :2], 2.0, atol=0.1)


@pytest.mark.parametrize("unknown", [0, 1, 2])
def test_an_edge_of_which_nothing_was_measured_tells_nothing(unknown: int) -> None:
    bearing, sigma = np.linspace(-0.3, 0.3, FEWEST_EDGES + 1), np.full(FEWEST_EDGES + 1, 0.01)
    sigma[:unknown] = np.nan
    edges = Edges.from_columns(bearing, sigma, bearing, sigma)
    assert SEARCH.known_edges(Sighting(0, edges)) == FEWEST_EDGES + 1 - unknown
    assert SEARCH.evidence(cloud(np.zeros((5, 3))), Sighting(0, edges))[1] == (unknown < 2)
    assert len(Feet.of(OBSERVATION.frame(edges)).bearing) == FEWEST_EDGES + 1 - unknown
