"""The picture of a run: same run, same bytes; nothing needed but poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.text import Text

from localiser.evaluate import Track, metrics
from localiser.evaluate.report import draw_report, write_report
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap

SECOND = 1_000_000_000


def run(height: float = 1.0) -> dict[str, Any]:
    """A circle (an ellipse for other heights), with a pause, and all that a run can know."""
    angle = np.linspace(0, 2 * np.pi, 90)
    poses = np.stack([3 * np.cos(angle), 3 * height * np.sin(angle), -angle], axis=-1)
    truth = Trajectory((np.arange(90) * SECOND) // 2, poses)
    rng = np.random.default_rng(0)
    edges = rng.integers(0, 20, 90)
    edges[40:50] = 0
    covs = np.tile(np.diag([0.01, 0.04, 0.001]), (90, 1, 1))
    track = Track.from_poses(
        truth.t_ns, poses + rng.normal(size=poses.shape) * [0.1, 0.2, 0.03], covs=covs, odometry=poses * 1.02,
        edges=edges, matched=edges // 2,
    )  # fmt: skip
    points = rng.uniform(-5, 5, (40, 2)) * [1, height]
    figures = metrics(track, truth, log="circle", about={"observation": "line", "seed": 1, "particles": 100})
    return {
        "track": track, "figures": figures, "truth": truth, "landmark_map": LandmarkMap.from_points(points),
    }  # fmt: skip


def test_same_run_same_bytes_of_the_promised_size(tmp_path: Path) -> None:
    write_report(tmp_path / "a.png", **run())
    write_report(tmp_path / "b.png", **run())
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image is not None
    assert image.shape == (1050, 1600, 3)
    assert b"Software" not in (tmp_path / "a.png").read_bytes()[:400]


@pytest.mark.parametrize(
    ("source", "named"),
    [(None, "odometry alone"), ("wheel", "odometry alone (wheels)")],
)
def test_it_says_whose_odometry_it_is_and_no_title_covers_a_legend(source: str | None, named: str) -> None:
    given = run()
    given["figures"] |= {"odometry": source}
    figure = draw_report(**given)
    assert named in [label.get_text() for label in figure.axes[0].get_legend().get_texts()]
    figure.canvas.draw()
    for axes in figure.axes:
        if (legend := axes.get_legend()) is not None:
            (title,) = [one for one in axes.findobj(Text) if one.get_text() == axes.get_title(loc="left")]
            assert title.get_window_extent().y0 > legend.get_window_extent().y1 - 2


def test_whole_path_is_inside_the_map_panel() -> None:
    for height in (0.1, 1.0, 5.0):
        given = run(height)
        on_map = draw_report(**given).axes[0]
        inside = on_map.get_window_extent()
        at = on_map.transData.transform(given["truth"].poses[:, :2])
        assert inside.x0 < at[:, 0].min() < at[:, 0].max() < inside.x1
        assert inside.y0 < at[:, 1].min() < at[:, 1].max() < inside.y1


def test_error_curve_is_the_error(tmp_path: Path) -> None:
    given = run()
    position = draw_report(**given).axes[1]
    curve = next(line for line in position.get_lines() if line.get_label() == "error")
    error = np.hypot(*(given["track"].poses - given["truth"].poses)[:, :2].T)
    np.testing.assert_allclose(curve.get_ydata(), error)
    assert position.get_ylim()[1] > error.max()


@pytest.mark.parametrize(("widening", "whole"), [(1.5, True), (40.0, False)], ids=["a turn", "a long pause"])
def test_band_is_shown_whole_unless_it_flattens_the_rest(widening: float, whole: bool) -> None:
    given = run()
    track, covs = given["track"], given["track"].covs.copy()
    covs[10:13] *= widening**2  # fewer than the twentieth part of the images
    wide = Track.from_poses(track.t_ns, track.poses, covs=covs, edges=track.edges)
    _, position, heading, *_ = draw_report(wide, given["figures"], truth=given["truth"]).axes
    assert (position.get_ylim()[1] > 3 * wide.position_sigma_m.max()) == whole
    assert (heading.get_ylim()[1] > np.degrees(3 * wide.heading_sigma_rad.max())) == whole
    error_m = np.hypot(*(wide.poses - given["truth"].poses)[:, :2].T)
    assert error_m.max() < position.get_ylim()[1] < 10 * error_m.max()


def test_without_truth_map_and_edges_uncertainty_is_drawn() -> None:
    track = run()["track"]
    bare = Track.from_poses(track.t_ns, track.poses, covs=track.covs)
    figure = draw_report(bare, metrics(bare, None, log="bare"))
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "Path on the map", "Position uncertainty, no truth", "Heading uncertainty, no truth", "Edges",
        "Probability of being right", "Residuals of matched edges",
    ]  # fmt: skip


def test_a_trajectory_alone_and_a_single_image_make_a_picture(tmp_path: Path) -> None:
    track = run()["track"]
    poses_only = Track.from_poses(track.t_ns, track.poses)
    write_report(tmp_path / "poses.png", poses_only, metrics(poses_only, None, log="poses"))
    single = Track.from_poses([0], [[1.0, 2.0, 0.3]], edges=[4])
    truth = Trajectory(np.array([0]), np.array([[1.0, 2.0, 0.3]]))
    write_report(tmp_path / "single.png", single, metrics(single, truth, log="single"), truth=truth)
    assert (tmp_path / "single.png").stat().st_size > 20_000


def test_poses_while_the_robot_is_not_found_are_faint_points_and_no_errors() -> None:
    given = run()
    track = given["track"]
    found = np.arange(90) >= 12
    lost = Track.from_poses(track.t_ns, track.poses, covs=track.covs, odometry=track.odometry, found=found)
    figure = draw_report(lost, given["figures"], truth=given["truth"])
    lines = {line.get_label(): np.asarray(line.get_xdata(), float) for line in figure.axes[0].get_lines()}
    assert len(lines["not found yet"]) == 12 and np.isnan(lines["estimate"]).sum() == 12
    assert np.isnan(lines["odometry alone"]).sum() == 12
    assert lines["odometry alone"][12] == pytest.approx(given["truth"].poses[12, 0])
    error = next(line for line in figure.axes[1].get_lines() if line.get_label() == "error")
    assert np.isnan(np.asarray(error.get_ydata())).sum() == 12


def test_nothing_is_drawn_across_a_time_without_images() -> None:
    given = run()
    keep = np.r_[0:30, 60:90]  # 15 s without an image
    track = given["track"]
    cut = Track.from_poses(track.t_ns[keep], track.poses[keep], covs=track.covs[keep], edges=track.edges[keep])
    position = draw_report(cut, given["figures"], truth=given["truth"]).axes[1]
    curve = next(line for line in position.get_lines() if line.get_label() == "error")
    error = np.asarray(curve.get_ydata())
    assert np.flatnonzero(np.isnan(error)).tolist() == [30]
    assert np.isfinite(error).sum() == 60
