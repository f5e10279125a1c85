"""The worst moments of a run, and the page that shows them and needs no other file."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.evaluate import Track, WorstMoments, metrics, report_page
from localiser.evaluate.page import image_svg, map_svg
from localiser.filter import Located, LocatedFrame
from localiser.geometry import Increment
from localiser.landmarks import LandmarkMap
from localiser.observation import Matches
from localiser.particles import POSE, Estimate, Particles

SECOND = 1_000_000_000
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
    return LocatedFrame(located, matches, np.full((480, 640), 128, np.uint8), truth, {})


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
