"""Tilt, roll and height of a camera that hangs otherwise than stated, found while the robot is located by its edges."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from short_log import corridor_with_edges
from simulated_edges import EdgeNoise, simulated_edges

from localiser import Localiser
from localiser.camera import Camera, Mount, MountSigma
from localiser.config import read_config
from localiser.edges import Edges, mount_error_of_edges
from localiser.edges.measure import common_error
from localiser.evaluate import nees
from localiser.filter import LocatedFrame, Odometry, Start, mcl
from localiser.filter.attitude import MEMORY_M, Attitude, Level
from localiser.filter.height import OFFSETS_M, Height, raised
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.motion import EXACT, MotionParameters
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.replay.run import start_of

STATED = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9, back_m=-0.1))
ERROR = np.radians([0.5, -0.3])
HANGING = STATED.with_mount(tilt_rad=STATED.mount.tilt_rad + ERROR[0], roll_rad=ERROR[1])
SIGMA = np.radians([0.5, 0.3])
PLUMB = np.radians(0.3)
NOISE = EdgeNoise(endpoint_sigma_px=0.3, along_sigma_px=1.0)
ANGLES = np.linspace(0.0, 2 * np.pi, 48, endpoint=False) + 0.05 * np.sin(np.arange(48))
MAP = replace(
    LandmarkMap.from_points(np.array([4.0, 3.0]) * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)),
    bottom_m=np.zeros(48),
    top_m=np.full(48, 2.0),
)


def measured(edges: Edges, camera: Camera) -> Edges:
    """The edges as one measures their ends who takes `camera` to have seen them."""
    bearing, middle_e = camera.bearing_of_segments(edges.ends_px), camera.upright_from_pixels(edges.ends_px)[..., 1]
    return replace(
        edges,
        bearing=bearing,
        bearing_sigma=camera.bearings_of_segments(edges.ends_px, NOISE.endpoint_sigma_px)[1],
        lean=camera.lean_of_segments(edges.ends_px),
        lean_sigma=np.sqrt(2) * NOISE.endpoint_sigma_px / edges.length_px,
        common=common_error(bearing, middle_e.mean(axis=1), camera, SIGMA),
    )


def drive(steps: int = 60) -> Trajectory:
    """A round of 1 m through the room, 11 cm and 6° from image to image."""
    turn = np.linspace(0.0, 2 * np.pi, steps + 1)
    poses = np.stack([1.1 * np.cos(turn), -1.1 * np.sin(turn), turn], axis=1)
    return Trajectory(np.arange(len(turn)) * 200_000_000, poses)


def frames_of(camera: Camera, noise: EdgeNoise = NOISE) -> list[Edges]:
    edges = simulated_edges(MAP, camera, drive(), np.random.default_rng(0), noise=noise)
    return [measured(one, STATED) for one in edges]


def test_levelled_edges_are_those_of_a_camera_that_hangs_as_stated() -> None:
    exact = EdgeNoise(endpoint_sigma_px=1e-6)
    known = Attitude(ERROR, np.zeros((2, 2)))
    feet = 0
    for pose, hanging in list(zip(drive().poses, frames_of(HANGING, exact), strict=True))[::10]:
        found = known.levelled(hanging, STATED.image_from_pixels(hanging.ends_px), STATED)
        true_bearing = HANGING.bearing_of_segments(hanging.ends_px)
        true_lean = np.arctan(np.sin(STATED.mount.tilt_rad) * np.tan(true_bearing))
        # Second order in the error is left: a hundredth of it.
        assert np.abs(hanging.lean - true_lean).max() > np.radians(0.3)
        np.testing.assert_allclose(found.bearing, true_bearing, atol=np.radians(0.01))
        np.testing.assert_allclose(found.lean, true_lean, atol=np.radians(0.02))
        x, z = MAP.points[hanging.landmark_id].T
        foot_px = STATED.project(pose, np.stack([x, 0 * x, z], axis=-1))
        inside = hanging.ends_px[:, 0, 1] < STATED.height - 10
        np.testing.assert_allclose(found.ends_px[inside, 0], foot_px[inside], atol=1e-3)
        feet += int(inside.sum())
    assert feet > 20


def test_edges_tell_tilt_and_roll_within_the_sigma_they_claim() -> None:
    attitude, level, off = None, Level(STATED, PLUMB), []
    for edges in frames_of(HANGING):
        _, attitude = level.levelled(attitude, edges, path_m=0.11, novelty=1.0)
        off.append(np.abs(attitude.mean - ERROR) / np.sqrt(np.diag(attitude.cov)))
    assert (np.sqrt(np.diag(attitude.cov)) < np.radians([0.15, 0.1])).all()
    assert np.mean(np.square(off[5:])) < 1.5
    assert np.max(off[5:]) < 3.0


@pytest.mark.parametrize("seed", range(5))
def test_the_update_is_filterpys(seed: int) -> None:
    """The measurement is what an image tells without the prior on the mount, and counts by its novelty."""
    rng, edges = np.random.default_rng(seed), frames_of(HANGING)[seed]
    root = rng.standard_normal((2, 2)) * SIGMA
    known = Attitude(ERROR * rng.standard_normal(2), root @ root.T)
    novelty = rng.uniform(0.1, 1.0)
    ends = STATED.image_from_pixels(edges.ends_px)
    image = mount_error_of_edges(edges, ends, STATED, SIGMA, PLUMB, lens_sigma=0.0)
    noise = np.linalg.inv(novelty * (np.linalg.inv(image.cov) - np.diag(SIGMA**-2.0)))
    kalman = KalmanFilter(dim_x=2, dim_z=2)
    kalman.x, kalman.P, kalman.H = known.mean.copy(), known.cov.copy(), np.eye(2)
    kalman.update(noise @ (novelty * np.linalg.inv(image.cov) @ image.mean), R=noise)
    found = known.given(edges, ends, STATED, PLUMB, novelty)
    np.testing.assert_allclose(found.mean, kalman.x, rtol=1e-9)
    np.testing.assert_allclose(found.cov, kalman.P, rtol=1e-9, atol=1e-9 * np.trace(kalman.P))


def test_an_image_seen_again_tells_nothing_and_what_was_learnt_is_forgotten() -> None:
    stated = np.diag(SIGMA**2)
    known = Attitude(ERROR, stated / 100)
    edges = frames_of(HANGING)[0]
    again = known.given(edges, STATED.image_from_pixels(edges.ends_px), STATED, PLUMB, novelty=0.0)
    np.testing.assert_allclose(again.mean, known.mean)
    np.testing.assert_allclose(again.cov, known.cov)
    standing, far = known.after(0.0, stated), known.after(20 * MEMORY_M, stated)
    np.testing.assert_allclose(standing.mean, ERROR)
    np.testing.assert_allclose(far.mean, np.zeros(2), atol=1e-9)
    np.testing.assert_allclose(far.cov, stated, rtol=1e-9)


def test_a_mount_that_is_certain_stays_as_it_is_stated() -> None:
    edges = frames_of(HANGING)[0]
    edges = replace(edges, common=replace(edges.common, cov=np.zeros((2, 2))))
    found, attitude = Level(STATED, PLUMB).levelled(None, edges, path_m=1.0, novelty=1.0)
    np.testing.assert_array_equal(attitude.mean, np.zeros(2))
    np.testing.assert_allclose(found.lean, edges.lean, rtol=1e-12)
    np.testing.assert_allclose(found.ends_px, edges.ends_px, atol=1e-6)


@pytest.mark.parametrize("which", ["none", "no ends", "no mount"])
def test_edges_that_tell_nothing_of_the_mount_stay_as_they_are(which: str) -> None:
    one = frames_of(HANGING)[0]
    edges = {
        "none": Edges.none(),
        "no ends": replace(one, ends_px=np.full_like(one.ends_px, np.nan)),
        "no mount": Edges.from_columns(one.bearing, one.bearing_sigma, one.lean, one.lean_sigma, ends_px=one.ends_px),
    }[which]
    before = Attitude(ERROR, np.diag(SIGMA**2))
    assert Level(STATED, PLUMB).levelled(before, edges, path_m=0.1, novelty=1.0) == (edges, before)


@pytest.mark.parametrize("tilt_rad", [0.0, np.sin(np.pi)])
def test_a_camera_without_tilt_tells_it_by_bearings_alone(tilt_rad: float) -> None:
    camera = STATED.with_mount(tilt_rad=tilt_rad)
    edges = simulated_edges(MAP, camera, drive(), np.random.default_rng(0), noise=NOISE)[0]
    edges = replace(edges, common=common_error(edges.bearing, np.zeros(len(edges)), camera, SIGMA))
    found, attitude = Level(camera, PLUMB).levelled(None, edges, path_m=0.1, novelty=1.0)
    assert attitude is not None
    assert np.isfinite(found.bearing).all()
    np.testing.assert_array_equal(found.lean, edges.lean)


def located(kind: str, level: Level | None, seed: int = 1) -> tuple[Array, Array]:
    """Errors (F, 3) of a filter that sees by a camera that hangs otherwise than stated, and their covariances."""
    parameters = ObservationParameters(kind=kind, landmark_sigma_m=0.003)  # type: ignore[arg-type]
    filter_ = mcl.Mcl(
        MAP,
        EdgeObservation(STATED, parameters),
        mcl.MclParameters(particles=500, start_particles=2000),
        MotionParameters(bias=EXACT),
        parameters,
        level=level,
    )
    truth, state, rng = drive(), mcl.FilterState(), np.random.default_rng(seed)
    events: list[mcl.Event] = [mcl.Start(0, truth.poses[0], np.diag([0.1, 0.1, 0.05]) ** 2)]
    for t_ns, pose, edges in zip(truth.t_ns, truth.poses, frames_of(HANGING), strict=True):
        events += [mcl.Odometry(int(t_ns), pose), mcl.Sighting(int(t_ns), edges)]
    found = [one for event in events for one in mcl.step(filter_, state, event, rng)]
    error = np.array([one.estimate.pose for one in found]) - truth.poses
    error[:, 2] = np.angle(np.exp(1j * error[:, 2]))
    return error[20:], np.array([one.estimate.pose_cov for one in found])[20:]


@pytest.mark.parametrize("kind", ["line", pytest.param("slope", marks=pytest.mark.slow)])
def test_a_robot_whose_camera_hangs_otherwise_than_stated_is_where_it_says(kind: str) -> None:
    """Without that, half a degree of tilt biases every image in the same way, and the filter knows nothing of it."""
    drives = [located(kind, Level(STATED, PLUMB), seed) for seed in range(1, 7)]
    error, cov = np.concatenate([one[0] for one in drives]), np.concatenate([one[1] for one in drives])
    astray, claimed = located(kind, None)
    assert np.mean(nees(error, cov)) < 3.0
    assert np.mean(nees(astray, claimed)) > 5.0
    rmse, without = (np.sqrt(np.mean(np.square(e[:, :2]).sum(axis=1))) for e in (error, astray))
    assert rmse < 0.5 * without


CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, Mount(np.radians(20.0), 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(("off_m", "seed"), [(0.1, 1), (-0.1, 0), (-0.1, 1), (0.0, 1)])
def test_a_height_that_is_stated_wrong_is_found(off_m: float, seed: int) -> None:
    log, edges = corridor_with_edges()
    stated_m = log.camera.mount.height_m - off_m
    camera = log.camera.with_mount(height_m=stated_m)
    localiser = Localiser(log.landmark_map, camera, read_config(None, (), log.settings), seed=seed)
    start = start_of(log, "truth", localiser.rng)
    frames: list[LocatedFrame] = localiser.start(start.mean, start.cov, start.t_ns)
    for event in log.events(start, anywhere=False):
        if isinstance(event, Odometry):
            frames += localiser.odometry(event.t_ns, event.pose)
        elif not isinstance(event, Start):
            seen = edges[event.t_ns]
            scale = stated_m / log.camera.mount.height_m  # as the front end would have ranged the feet
            frames += localiser.edges(event.t_ns, replace(seen, foot_range_m=seen.foot_range_m * scale))
    frames += localiser.finish()

    truth = log.groundtruth.sampled([frame.located.t_ns for frame in frames]).poses
    error_m = np.hypot(*(np.array([frame.located.estimate.pose for frame in frames]) - truth)[:, :2].T)
    height = frames[-1].located.height
    assert abs(height.mean_m - off_m) < 0.015 < 3 * height.sigma_m
    text = height.warning(stated_m)
    if off_m == 0.0:
        assert text == ""
    else:
        assert f"m {'higher' if off_m > 0 else 'lower'} than the {stated_m:.3f} m that are stated" in text
    assert np.sqrt((error_m**2).mean()) < 0.01


def ends(off_m: float, count: int, hidden: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Ends of landmarks 1 to 5 m ahead, seen from a camera that is off_m higher; the first `hidden` are anywhere."""
    per_height = -1.0 / rng.uniform(1.0, 5.0, count)
    offset = per_height * off_m + 2.0 / 500.0 * rng.standard_normal(count)
    offset[:hidden] = rng.uniform(-0.5, 0.5, hidden)
    return offset, per_height


def test_the_sigma_holds_though_most_ends_are_hidden() -> None:
    rng, far = np.random.default_rng(0), []
    for _ in range(200):
        off_m, height = rng.normal(0.0, 0.03), Height()
        for _ in range(5):
            height = replace(height, novelty=1.0).after(*ends(off_m, 20, 14, rng), CAMERA)
        far.append((height.mean_m - off_m) / height.sigma_m)
    assert np.mean(np.abs(far) < 3.0) >= 0.98 and np.std(far) < 1.2


def test_until_it_is_known_the_height_is_weighed_together_with_poses() -> None:
    """The offset that particles explain an image by is found, though the stated one is three sigmas off."""
    height, tenth = Height(), 0.1
    assert height.is_unknown

    def told(offset_m: float) -> float:
        return float(-0.5 * ((offset_m - tenth) / 0.02) ** 2)

    known = height.with_poses(told, 1.0)
    prior, likelihood = -0.5 * (OFFSETS_M / 0.03) ** 2, 0.6 * -0.5 * ((OFFSETS_M - tenth) / 0.02) ** 2
    exact = np.exp(prior + np.where(np.abs(OFFSETS_M) <= 0.2, likelihood, -np.inf))
    assert known.mean_m == pytest.approx(exact @ OFFSETS_M / exact.sum(), abs=0.003)
    assert not known.with_poses(told, 1.0).is_unknown
    flat = height.with_poses(lambda _: 3.0, 1.0)
    np.testing.assert_allclose(flat.probability, height.probability, rtol=1e-9)
    assert 0.0 < height.with_poses(told, 0.1).mean_m < known.mean_m < tenth


def test_an_image_without_ends_tells_nothing() -> None:
    height = Height(novelty=0.5)
    after = height.after(np.zeros(0), np.zeros(0), CAMERA)
    np.testing.assert_array_equal(after.probability, height.probability)
    assert after.novelty == 0.0


def test_edges_are_seen_from_the_height_that_was_found() -> None:
    edges = replace(Edges.from_bearings([0.1, 0.2], 0.01), foot_range_m=np.array([2.0, np.nan]))
    known = Height((np.abs(OFFSETS_M - 0.1) < 1e-9).astype(float))
    moved = known.corrected(edges, CAMERA, is_tracked=True)
    assert moved.mount is not None and moved.mount.height_m == pytest.approx(1.1) and moved.height_sigma_m == 0.0
    np.testing.assert_allclose(moved.foot_range_m, [2.2, np.nan])
    unknown = Height().corrected(edges, CAMERA, is_tracked=True)
    assert unknown.mount is None and unknown.height_sigma_m == pytest.approx(0.03, abs=0.001)
    assert Height().corrected(edges, CAMERA, is_tracked=False).height_sigma_m == 0.0, "ends must tell places apart"
    measured = replace(edges, mount=replace(CAMERA.mount, sigma=MountSigma(height_m=0.02)))
    assert known.corrected(measured, CAMERA, is_tracked=True).mount == measured.mount, "measured for this image alone"
    assert known.corrected(measured, CAMERA, is_tracked=True).height_sigma_m == 0.02
    low = CAMERA.with_mount(height_m=0.1)
    assert all(raised(edges, low, off_m).mount.height_m > 0.0 for off_m in OFFSETS_M), "no camera is in the floor"
