"""The picture of a run: same run, same bytes, nothing needed but poses; and the page that shows it."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from matplotlib.text import Text

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.evaluate import Track, WorstMoments, metrics, report_page
from localiser.evaluate.page import image_svg, map_svg
from localiser.evaluate.report import draw_report, write_report
from localiser.filter import Located, LocatedFrame
from localiser.geometry import Increment, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.observation import Matches
from localiser.particles import POSE, Estimate, Particles

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
    assert cv2.imread(str(tmp_path / "a.png")).shape == (1050, 1600, 3)
    assert b"Software" not in (tmp_path / "a.png").read_bytes()[:400]


@pytest.mark.parametrize(("source", "named"), [(None, "odometry alone"), ("wheel", "odometry alone (wheels)")])
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


CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9))
MAP = LandmarkMap.from_points(np.array([[0.0, -3.0], [1.0, -4.0], [50.0, 50.0]]))


def frame(second: int, p_correct: float = 0.99, error_m: float | None = None, sigma_m: float = 0.01) -> LocatedFrame:
    """An image at the map's origin, with two edges of which the first is matched."""
    pose, cov = np.zeros(3), np.diag([sigma_m**2, sigma_m**2, 1e-4])
    edges = replace(
        Edges.from_columns(np.array([0.0, 0.2]), np.full(2, 0.01), np.zeros(2), np.full(2, 0.01)),
        ends_px=np.array([[[320.0, 400.0], [320.0, 100.0]], [[420.0, 400.0], [430.0, 100.0]]]),
    )
    located = Located(
        second * SECOND, Estimate(POSE, pose, cov), Particles(POSE, np.zeros((3, 50)), np.zeros(50)), 50.0, edges,
        Increment(np.zeros(3), np.zeros((3, 3)), 0.0, 0.0), pose, p_correct,
    )  # fmt: skip
    matches = Matches(
        np.array([0, -1]), np.array([0.01, np.nan]), np.array([True, True, False]), np.array([0.01, np.nan]),
        np.array([3.0, np.nan]),
    )  # fmt: skip
    truth = None if error_m is None else np.array([error_m, 0.0, 0.0])
    return LocatedFrame(replace(located, matches=matches), np.full((480, 640), 128, np.uint8), truth, {})


def taken(frames: list[LocatedFrame]) -> WorstMoments:
    worst = WorstMoments()
    for one in frames:
        worst.frame(one)
    worst.close(True)
    return worst


def numbers_of(worst: WorstMoments, reason: str) -> list[int]:
    return [moment.number for moment in worst.moments if reason in moment.reasons]


def test_worst_images_are_kept_some_seconds_apart() -> None:
    p_correct = {20: 0.5, 21: 0.1, 22: 0.3, 40: 0.6, 50: 0.7}
    worst = taken([frame(second, p_correct.get(second, 0.99)) for second in range(60)])
    assert numbers_of(worst, "least sure") == [21, 40]
    assert [moment.number for moment in worst.moments] == sorted({moment.number for moment in worst.moments})


def test_errors_count_where_the_truth_is_known() -> None:
    without = taken([frame(second) for second in range(9)])
    assert not numbers_of(without, "largest error") and not numbers_of(without, "sure and wrong")
    with_truth = taken([frame(second, 0.95, 0.8 if second == 5 else 0.1) for second in range(9)])
    assert numbers_of(with_truth, "sure and wrong") == [5]
    assert 5 in numbers_of(with_truth, "largest error")


@pytest.mark.parametrize("encoded", [".png", ".jpg", None])
def test_image_holds_its_picture_and_every_line(encoded: str | None) -> None:
    one = frame(0)
    if encoded:
        one = replace(one, image=cv2.imencode(encoded, one.image)[1].tobytes())
    tree = ElementTree.fromstring(image_svg(one, CAMERA, MAP))
    kinds = [line.get("class") for line in tree.iter("polyline")]
    assert (kinds.count("matched"), kinds.count("unmatched"), kinds.count("expected")) == (1, 1, 2)
    (picture,) = tree.iter("image")
    content = base64.b64decode(str(picture.get("href")).removeprefix("data:image/jpeg;base64,"))
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (480, 640)


def test_map_shows_landmarks_by_what_they_are_and_the_belief() -> None:
    one = frame(0, error_m=1.0)
    tree = ElementTree.fromstring(map_svg(one, MAP, np.zeros((2, 3))))
    kinds = [shape.get("class") for shape in tree.iter()]
    assert (kinds.count("matched-point"), kinds.count("expected-point"), kinds.count("unseen")) == (1, 1, 0)
    assert kinds.count("particle") == 50 and {"estimate", "truth", "spread", "path"} <= set(kinds)


class Addresses(HTMLParser):
    """Collects what a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value or "" for name, value in attrs if name in ("src", "href", "srcset")]


def page_of(error_m: float | None) -> str:
    frames = [frame(second, 0.95 - 0.01 * second, error_m) for second in range(9)]
    track = Track.from_poses(
        [one.located.t_ns for one in frames], np.zeros((9, 3)), p_correct=[one.located.p_correct for one in frames]
    )
    figures = metrics(track, None, log="<my> log") | {"warnings": ["The map does not fit."]}
    return report_page(track, figures, taken(frames).moments, camera=CAMERA, landmark_map=MAP, picture=b"png")


def test_page_needs_no_other_file_and_says_what_it_shows(tmp_path: Path) -> None:
    page = page_of(None)
    addresses = Addresses()
    addresses.feed(page)
    assert addresses.found and all(address.startswith("data:") for address in addresses.found)
    assert "<script" not in page and "url(" not in page and "@import" not in page
    assert "&lt;my&gt; log" in page and "<my>" not in page
    assert "Warning: The map does not fit." in page
    assert "Least sure: image 8 at 8.0 s" in page
    assert "Probability of being right 0.870; 3σ 0.042 m" in page
    assert page == page_of(None), "the same run gives the same page"
    assert "error 0.300 m" in page_of(0.3) and "error" not in re.sub(r"<h2>What the.*", "", page, flags=re.DOTALL)


def test_the_page_says_what_the_run_knows_and_each_thing_once() -> None:
    figures = {
        "log": "mine", "position_3sigma_median_m": 0.0312, "edges_matched": 0.664, "distance_m": 18.07,
        "residuals": {"consistency": 0.547}, "pauses": [], "warnings": ["This map does not fit."],
        "confidence": {"found_s": None, "not_found": 1.0, "sure": 0.0}, "map": "rooms 0a1b2c", "start": "anywhere",
        "biases": {"veer": {"value": 0.01, "sigma": 0.005}}, "landmarks": {"known": 40, "in_view": 30, "matched": 20},
    }  # fmt: skip
    page = report_page(Track.from_poses([0], np.zeros((1, 3))), figures, [], camera=CAMERA, landmark_map=MAP)
    for text in (
        ">0.031 m<", ">66 %<", ">18.1 m<", ">0.55<", ">never<", ">100.0 %<", "Warning: This map does not fit.",
        "Learnt: veer +0.57 ± 0.29°/m.", "Of 40 landmarks, 30 were in view and 20 matched.", "map rooms 0a1b2c",
    ):  # fmt: skip
        assert page.count(text) == 1, text
    assert ">position RMSE<" not in page
