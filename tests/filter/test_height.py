"""A camera that sits higher or lower than is stated: found on the shipped drive, told, and harmless."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from short_log import corridor_with_edges

from localiser import Localiser
from localiser.camera import Camera, Mount, MountSigma
from localiser.config import read_config
from localiser.edges import Edges
from localiser.filter import LocatedFrame, Odometry, Start
from localiser.filter.height import OFFSETS_M, Height
from localiser.observation import EndOffsets
from localiser.replay.run import start_of

CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, Mount(np.radians(20.0), 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(("off_m", "seed"), [(0.1, 1), (-0.1, 0), (-0.1, 1), (0.0, 1)])
def test_a_height_that_is_stated_wrong_is_found(off_m: float, seed: int) -> None:
    log, edges = corridor_with_edges()
    stated_m = log.camera.mount.height_m - off_m
    camera = log.camera.with_mount(height_m=stated_m)
    localiser = Localiser(log.landmark_map, camera, read_config(None, (), log.settings), seed=seed)
    start = start_of(log, "truth", localiser.rng)
    assert start is not None and log.groundtruth is not None
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


def ends(off_m: float, count: int, hidden: int, rng: np.random.Generator) -> EndOffsets:
    """Ends of landmarks 1 to 5 m ahead, seen from a camera that is off_m higher; the first `hidden` are anywhere."""
    per_height = -1.0 / rng.uniform(1.0, 5.0, count)
    offset = per_height * off_m + 2.0 / 500.0 * rng.standard_normal(count)
    offset[:hidden] = rng.uniform(-0.5, 0.5, hidden)
    return EndOffsets(offset, per_height)


def test_the_sigma_holds_though_most_ends_are_hidden() -> None:
    rng, far = np.random.default_rng(0), []
    for _ in range(200):
        off_m, height = rng.normal(0.0, 0.03), Height()
        for _ in range(5):
            height = height.seen(1.0).after(ends(off_m, 20, 14, rng), CAMERA)
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
    little = height.with_poses(told, 0.1)
    assert 0.0 < little.mean_m < known.mean_m < tenth


def test_an_image_without_ends_tells_nothing() -> None:
    height = Height().seen(0.5)
    after = height.after(EndOffsets(np.zeros(0), np.zeros(0)), CAMERA)
    np.testing.assert_array_equal(after.probability, height.probability)
    assert after.novelty == 0.0 and height.novelty == 0.5 and height.seen(0.9).novelty == 1.0


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
