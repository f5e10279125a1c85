"""The compiled likelihood against the same model by plain loops."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_likelihood import by_rate_plain, camera_poses, plain_pairs

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, SightParameters, in_camera, sight
from localiser.observation import DETECTION_RATES, INLIER_RATES, EdgeObservation, ObservationParameters, Sighting
from localiser.observation.frame import bins_of
from localiser.particles import POSE, Particles

FOCAL = 554.0
# Pairs beyond six sigmas add less than 1e-8 of a peak each; log-weights may differ by that over many edges.
HARMLESS = 1e-3


def camera(tilt_deg: float, roll_deg: float = 0.0) -> Camera:
    mount = Mount(np.radians(tilt_deg), 0.9, np.radians(roll_deg), yaw_rad=0.03, back_m=-0.1)
    return Camera(640, 480, FOCAL, FOCAL, 319.5, 239.5, mount)


def some_map(rng: np.random.Generator, count: int) -> LandmarkMap:
    """Landmarks of which some have heights, some only one, some none."""
    bottom, top = rng.uniform(0, 1, count), rng.uniform(1, 3, count)
    bottom[rng.random(count) < 0.3] = np.nan
    top[rng.random(count) < 0.3] = np.nan
    landmark_map = LandmarkMap.from_points(rng.uniform(-6, 6, (count, 2)), bottom_m=bottom, top_m=top)
    return replace(landmark_map, polarity=rng.integers(-1, 2, count).astype(np.int8))


def some_edges(rng: np.random.Generator, count: int, ends: bool) -> Edges:
    bearing = rng.uniform(-0.5, 0.5, count)
    sigma = 10.0 ** rng.uniform(-4, -1.5, count)
    lean = np.arctan(0.34 * np.tan(bearing)) + rng.normal(0, 0.01, count)
    ends_px = np.stack([rng.uniform(0, 639, (count, 2)), rng.uniform([240, 20], [470, 220], (count, 2))], axis=-1)
    polarity = rng.integers(-1, 2, count).astype(np.int8)
    return Edges.from_columns(
        bearing, sigma, lean, sigma * 3, ends_px=ends_px if ends else None, polarity=polarity if ends else None
    )


def cloud(rng: np.random.Generator, count: int) -> Particles:
    poses = np.column_stack([rng.uniform(-4, 4, (count, 2)), rng.uniform(-np.pi, np.pi, count)])
    return Particles(POSE, poses.T.copy(), np.zeros(count))


def difference(observation: EdgeObservation, particles: Particles, edges: Edges, landmark_map: LandmarkMap) -> Array:
    found = observation.by_rate(particles, Sighting(0, edges), landmark_map, 0.004)
    return np.abs(found - by_rate_plain(observation, particles, Sighting(0, edges), landmark_map, 0.004))


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    tilt_deg=st.sampled_from([-15.0, 0.0, 5.0, 20.0, 45.0]),
    kind=st.sampled_from(["line", "slope"]),
    ends=st.booleans(),
    count=st.integers(1, 40),
)
def test_compiled_and_plain_agree(seed: int, tilt_deg: float, kind: str, ends: bool, count: int) -> None:
    if kind == "slope" and tilt_deg == 0.0:
        tilt_deg = 1.0
    rng = np.random.default_rng(seed)
    observation = EdgeObservation(camera(tilt_deg, 2.0), ObservationParameters(kind=kind))  # type: ignore[arg-type]
    landmark_map = some_map(rng, int(rng.integers(1, 60)))
    particles = cloud(rng, 20)
    assert difference(observation, particles, some_edges(rng, count, ends), landmark_map).max() < HARMLESS


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    tilt_deg=st.sampled_from([-15.0, 5.0, 20.0]),
    kind=st.sampled_from(["line", "slope"]),
    ends=st.booleans(),
    landmarks=st.sampled_from([3, 60, 3000]),
)
def test_pairs_of_one_pose_agree(seed: int, tilt_deg: float, kind: str, ends: bool, landmarks: int) -> None:
    """From one pose, and as uncertain as the angles are that a cloud expects."""
    rng = np.random.default_rng(seed)
    parameters = ObservationParameters(kind=kind, sight=SightParameters(range_max_m=3.0, range_far_m=5.0))  # type: ignore[arg-type]
    observation, landmark_map = EdgeObservation(camera(tilt_deg, 2.0), parameters), some_map(rng, landmarks)
    sighting = Sighting(0, some_edges(rng, 12, ends), map_scale=2.0)
    root = rng.normal(0.0, 0.1, (3, 3))

    def expected(pose: np.ndarray) -> np.ndarray:
        right, ahead = in_camera(observation.camera.pose_in_map(pose[None]), landmark_map.points)
        return observation.frame(sighting.edges).predicted(right / ahead)[0][0]

    step = 1e-5 * np.eye(3)
    slope = np.array([expected(one) - expected(-one) for one in step]) / 2e-5
    spread = np.square(root.T @ slope).sum(axis=0)
    found = observation.associate(np.zeros(3), sighting, landmark_map, root @ root.T)
    assert found.pose_var == pytest.approx(spread[found.landmark], rel=1e-5)
    rows = list(zip(found.edge.tolist(), found.landmark[found.pair].tolist(), strict=True))
    assert len(set(rows)) == len(rows)
    for odds, more_var in ((found.odds, np.zeros(landmarks)), (found.all_odds, spread)):
        pairs, is_open = plain_pairs(observation, observation.camera.robot_from_level, sighting, landmark_map, more_var)
        per_density = observation.frame(sighting.edges).span_rad / max(sum(is_open.values()), 1.0)
        assert found.landmark.tolist() == sorted(is_open)
        assert found.in_the_open == pytest.approx([is_open[k] for k in found.landmark.tolist()], rel=1e-9)
        variance = found.map_var[found.pair] + observation.frame(sighting.edges).measured[1][found.edge]
        told = dict(zip(rows, zip(found.residual, variance, odds, strict=True), strict=True))
        for (e, k), (residual, total_var, density) in pairs.items():
            # Not among the rows where the ends do not overlap.
            found_as = told.get((e, k), (residual, total_var - more_var[k], 0.0))
            assert found_as[:2] == pytest.approx((residual, total_var - more_var[k]), rel=1e-5, abs=1e-7)
            assert found_as[2] == pytest.approx(per_density * is_open[k] * density, rel=1e-3, abs=1e-7 * per_density)
    assert set(rows) <= set(pairs)


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_edges_of_which_nothing_is_known_are_clutter(kind: str) -> None:
    rng = np.random.default_rng(1)
    observation = EdgeObservation(camera(20.0), ObservationParameters(kind=kind))  # type: ignore[arg-type]
    edges = some_edges(rng, 12, True)
    unknown = np.where(np.arange(12) % 3 == 0, np.nan, 1.0)
    partly = replace(edges, bearing=edges.bearing * unknown, lean=edges.lean * unknown)
    none = replace(edges, bearing=edges.bearing * np.nan, lean=edges.lean * np.nan)
    landmark_map, particles = some_map(rng, 40), cloud(rng, 200)
    for one in (partly, none):
        assert difference(observation, particles, one, landmark_map).max() < HARMLESS


def test_a_particle_does_not_depend_on_the_others() -> None:
    rng = np.random.default_rng(2)
    observation = EdgeObservation(camera(20.0), ObservationParameters())
    edges, landmark_map, particles = some_edges(rng, 20, True), some_map(rng, 40), cloud(rng, 100)
    together = observation.by_rate(particles, Sighting(0, edges), landmark_map)
    alone = [
        observation.by_rate(Particles(POSE, particles.columns[:, [n]], np.zeros(1)), Sighting(0, edges), landmark_map)[
            :, 0
        ]
        for n in range(100)
    ]
    np.testing.assert_array_equal(together.T, alone)


def test_particles_around_the_world_are_weighed() -> None:
    rng = np.random.default_rng(2)
    observation, near = EdgeObservation(camera(20.0), ObservationParameters()), cloud(rng, 100)
    far = replace(near, columns=near.columns * np.array([[1e9], [1e9], [1.0]]))
    both = replace(near, columns=np.concatenate([near.columns, far.columns], axis=1), log_weight=np.zeros(200))
    sighting, landmark_map = Sighting(0, some_edges(rng, 20, True)), some_map(rng, 40)
    found = observation.by_rate(both, sighting, landmark_map)
    np.testing.assert_array_equal(found[:, :100], observation.by_rate(near, sighting, landmark_map))


def test_hundreds_of_edges_neither_overflow_nor_vanish() -> None:
    observation = EdgeObservation(camera(20.0), ObservationParameters(landmark_sigma_m=1e-4))
    landmark_map = LandmarkMap.from_points(np.array([[0.0, -3.0]]))
    bearing = np.full(600, float(np.arctan2(0.0, 3.0)))
    edges = Edges.from_columns(bearing, np.full(600, 1e-5), bearing, np.full(600, 1e-5))
    poses = Particles(POSE, np.array([[0.0, 0.0], [0.0, 0.0], [-0.03, 3.0]]), np.zeros(2))
    found = observation.by_rate(poses, Sighting(0, edges), landmark_map)
    np.testing.assert_allclose(found, by_rate_plain(observation, poses, Sighting(0, edges), landmark_map), rtol=1e-9)
    assert np.isfinite(found).all()
    assert np.abs(found).max() > 700, "so large that one product would overflow"


@settings(max_examples=50)
@given(angles=st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=40), wanted=st.floats(-2, 2))
def test_a_bin_begins_at_or_before_the_first_edge_above(angles: list[float], wanted: float) -> None:
    angle = np.sort(np.array(angles))
    first, (low, per_rad, last) = bins_of(angle)
    of_bin = int(np.clip((wanted - low) * per_rad, 0.0, last))
    assert first[of_bin] <= np.searchsorted(angle, wanted)
    after = int(np.clip((wanted - low) * per_rad + 2.0, 0.0, last))
    assert first[after] >= np.searchsorted(angle, wanted, side="right")


def test_threads_do_not_change_a_bit() -> None:
    rng = np.random.default_rng(3)
    edges, landmark_map, particles = some_edges(rng, 20, True), some_map(rng, 40), cloud(rng, 20_000)
    one, three = (
        EdgeObservation(camera(20.0), ObservationParameters(threads=threads)).by_rate(
            particles, Sighting(0, edges), landmark_map
        )
        for threads in (1, 3)
    )
    np.testing.assert_array_equal(one, three)


def test_polarity_multiplies_a_pair_by_its_probability_over_a_half() -> None:
    observation = EdgeObservation(camera(20.0), ObservationParameters())
    point, angle, sigma = np.array([[0.0, -3.0]]), np.zeros(1), np.full(1, 0.01)
    here = Particles(POSE, np.array([[0.0], [0.0], [-0.03]]), np.zeros(1))

    def density(landmark: int, edge: int) -> float:
        """Return the edge's density over that of clutter, by the compiled loop."""
        landmark_map = replace(LandmarkMap.from_points(point), polarity=np.array([landmark], dtype=np.int8))
        edges = Edges.from_columns(angle, sigma, angle, sigma, polarity=np.array([edge], dtype=np.int8))
        share = INLIER_RATES[2]
        return float((np.exp(observation.by_rate(here, Sighting(0, edges), landmark_map)[2, 0]) - (1 - share)) / share)

    for sign in (1, -1):
        assert density(sign, sign) == pytest.approx(2 * 0.9 * density(0, 0))
        assert density(sign, -sign) == pytest.approx(2 * 0.1 * density(0, 0))
        assert density(sign, 0) == density(0, sign) == density(0, 0)


@pytest.mark.parametrize("of", ["map", "edges"])
def test_a_polarity_that_only_one_side_knows_changes_no_bit(of: str) -> None:
    rng = np.random.default_rng(4)
    observation = EdgeObservation(camera(20.0), ObservationParameters())
    edges, landmark_map, particles = some_edges(rng, 20, True), some_map(rng, 40), cloud(rng, 500)
    unknown_edges = replace(edges, polarity=np.zeros(20, dtype=np.int8))
    unknown_map = replace(landmark_map, polarity=np.zeros(40, dtype=np.int8))
    one = observation.by_rate(
        particles, Sighting(0, unknown_edges if of == "map" else edges), landmark_map if of == "map" else unknown_map
    )
    np.testing.assert_array_equal(one, observation.by_rate(particles, Sighting(0, unknown_edges), unknown_map))
    assert (one != observation.by_rate(particles, Sighting(0, edges), landmark_map)).any()


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_landmarks_down_a_long_corridor_count_for_what_can_be_seen_of_them(kind: str) -> None:
    rng = np.random.default_rng(8)
    parameters = ObservationParameters(kind=kind, landmark_sigma_m=0.0)  # type: ignore[arg-type]
    observation = EdgeObservation(camera(10.0), parameters)
    bearing, far_m = rng.uniform(-0.4, 0.4, 60), rng.uniform(2.0, 30.0, 60)
    points = np.column_stack([far_m * np.sin(bearing), -far_m * np.cos(bearing)])
    landmark_map, particles = LandmarkMap.from_points(points), cloud(rng, 300)
    sighting = Sighting(0, some_edges(rng, 20, True))
    plain = by_rate_plain(observation, particles, sighting, landmark_map)
    np.testing.assert_allclose(observation.by_rate(particles, sighting, landmark_map), plain, atol=2e-4)
    # A landmark at 24 m, which is twice as far as walls leave open, is in view with a probability of 1/16.
    one = Particles(POSE, np.zeros((3, 1)), np.zeros(1))
    edge = Sighting(0, Edges.from_columns(np.zeros(1), np.full(1, 0.01), np.zeros(1), np.full(1, 0.01)))
    near, far = (
        observation.by_views(one, edge, LandmarkMap.from_points(np.array([[0.0, -each]])), np.ones((1, 1)))[0, -1]
        for each in (11.9, 24.0)
    )
    rate = DETECTION_RATES[-1]
    density = (np.exp(near) * (1.0 + rate) - 1.0) / rate
    np.testing.assert_allclose(np.exp(far), (1.0 + rate * density / 16) / (1.0 + rate / 16), rtol=1e-2)


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_detection_rates_are_a_poisson_process(kind: str) -> None:
    """Against its equation, from what the inlier rates say: both are functions of the same densities."""
    rng = np.random.default_rng(7)
    observation = EdgeObservation(camera(20.0), ObservationParameters(kind=kind))  # type: ignore[arg-type]
    landmark_map, particles = some_map(rng, 40), cloud(rng, 200)
    mount_sees = camera_poses(observation.camera, particles)
    limits = observation.parameters.sight
    views = sight(observation.camera, mount_sees, landmark_map, replace(limits, range_max_m=limits.farthest_m))
    seen = np.bincount(views.pose, np.minimum(1.0, limits.range_max_m / views.range_m) ** 4, minlength=200)
    for edges in (some_edges(rng, 1, True), some_edges(rng, 1, False)):
        inlier = observation.by_rate(particles, Sighting(0, edges), landmark_map)[3]
        rate = INLIER_RATES[3]
        density = (np.expm1(inlier) / rate + 1.0) * np.maximum(seen, 1)  # of the one edge, relative to clutter
        expected = [np.log1p(p * density) - np.log1p(p * seen) for p in DETECTION_RATES]
        (found,) = observation.by_views(particles, Sighting(0, edges), landmark_map, np.ones((1, 40)))
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
    assert (seen == 0).any() and np.ptp(found) > 0.5
    np.testing.assert_array_equal(found[:, seen == 0], 0.0)


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_a_hidden_landmark_counts_for_the_probability_of_being_visible(kind: str) -> None:
    rng = np.random.default_rng(7)
    observation = EdgeObservation(camera(20.0), ObservationParameters(kind=kind))  # type: ignore[arg-type]
    landmark_map, particles, sighting = some_map(rng, 40), cloud(rng, 200), Sighting(0, some_edges(rng, 12, True))

    def by_rate(visibility: Array | None = None, of: LandmarkMap = landmark_map) -> Array:
        views = np.stack([np.ones(len(of)) if visibility is None else visibility, rng.random(len(of))])
        together = observation.by_views(particles, sighting, of, views, 0.004)
        for each, found in zip(views, together, strict=True):  # each is weighed as if alone
            (alone,) = observation.by_views(particles, sighting, of, each[None], 0.004)
            np.testing.assert_allclose(found, alone, rtol=1e-12, atol=1e-12)
        return together[0]

    everything, hidden = by_rate(), rng.random(40) < 0.5
    np.testing.assert_array_equal(by_rate(np.ones(40)), everything)
    shown = landmark_map.take(np.flatnonzero(~hidden))
    np.testing.assert_allclose(by_rate(np.where(hidden, 0.0, 1.0)), by_rate(of=shown), rtol=1e-9, atol=1e-9)
    assert (np.abs(by_rate(of=shown) - everything).max(axis=1) > 0.1).all()
    # Half as visible, twice as often: 0.7 is twice 0.35.
    np.testing.assert_allclose(by_rate(np.full(40, 0.5))[4], everything[3], rtol=1e-9, atol=1e-9)


def test_particles_all_over_a_large_map_are_weighed_as_by_arrays():
    """Cells stay small, however large the building, and hold no landmark too few."""
    rng = np.random.default_rng(4)
    landmark_map = LandmarkMap.from_points(
        rng.uniform(0, 150, (4000, 2)), bottom_m=np.zeros(4000), top_m=rng.uniform(1, 2.5, 4000)
    )
    poses = np.column_stack([rng.uniform(-10, 160, (600, 2)), rng.uniform(-np.pi, np.pi, 600)])
    poses[:5, :2] += 1e7  # where nothing is in view
    spread = Particles(POSE, poses.T.copy(), np.zeros(600))
    observation = EdgeObservation(camera(20.0), ObservationParameters())
    sighting = Sighting(0, some_edges(rng, 12, ends=True))
    fast = observation.by_rate(spread, sighting, landmark_map)
    plain = by_rate_plain(observation, spread, sighting, landmark_map)
    np.testing.assert_allclose(fast, plain, atol=HARMLESS)
    near = Particles(POSE, poses[5:].T.copy(), np.zeros(595))
    np.testing.assert_array_equal(observation.by_rate(near, sighting, landmark_map), fast[:, 5:])


def test_what_is_kept_of_an_image_is_used_for_no_other() -> None:
    rng = np.random.default_rng(4)
    edges, landmark_map, particles = some_edges(rng, 20, True), some_map(rng, 40), cloud(rng, 50)
    pose, kept = particles.poses[0], EdgeObservation(camera(20.0), ObservationParameters())
    plain, moved = Sighting(0, edges), Sighting(0, replace(edges, bearing=edges.bearing + 0.01))
    for sighting in (plain, replace(plain, persistent=rng.uniform(1, 30, 20)), plain, moved):
        fresh = EdgeObservation(camera(20.0), ObservationParameters())
        for blur_rad in (0.0, 0.01):
            found = kept.by_rate(particles, sighting, landmark_map, blur_rad)
            np.testing.assert_array_equal(found, fresh.by_rate(particles, sighting, landmark_map, blur_rad))
        for where in (landmark_map, landmark_map.take(np.arange(20))):
            found = kept.associate(pose, sighting, where).matches().landmark
            np.testing.assert_array_equal(found, fresh.associate(pose, sighting, where).matches().landmark)
