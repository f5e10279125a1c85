"""Write the report of a run as one HTML page that needs no other file: figures, the picture, the worst moments."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import cv2
import numpy as np

from localiser.camera import Camera
from localiser.evaluate.accuracy import Track, residual_sums
from localiser.evaluate.metrics import PAUSE_LONGER_THAN_S
from localiser.evaluate.tables import OWN, TABLES, figure_at, learnt_constants
from localiser.filter import CORRECT_M, CORRECT_RAD, SURE, LocatedFrame
from localiser.geometry import Array, forward, wrap_angle
from localiser.image_files import decode
from localiser.landmarks import LandmarkMap, landmark_ends, predicted_lines

# -- the worst moments ------------------------------------------------------------------------------------------------

APART_NS = 3_000_000_000
MOST_OF_A_KIND = 2


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """An image of a run, and in what it is the worst. number: of the image, from 0."""

    number: int
    frame: LocatedFrame
    reasons: tuple[str, ...]


def error_m(frame: LocatedFrame) -> float:
    """Return the distance from the truth, nan where it is not known."""
    return float("nan") if frame.truth is None else float(np.hypot(*(frame.located.estimate.pose - frame.truth)[:2]))


def wrong_though_sure(frame: LocatedFrame) -> float:
    """Return the error of an image whose pose is sure and not within 0.5 m and 10°, else nan."""
    if frame.truth is None or frame.located.p_correct <= SURE:
        return float("nan")
    turn = abs(float(wrap_angle(frame.located.estimate.pose[2] - frame.truth[2])))
    return error_m(frame) if error_m(frame) > CORRECT_M or turn > CORRECT_RAD else float("nan")


def position_sigma_m(frame: LocatedFrame) -> float:
    """Return the RMS distance that the filter expects to be off."""
    return float(np.sqrt(np.trace(frame.located.estimate.pose_cov[:2, :2])))


def while_found(score: Callable[[LocatedFrame], float]) -> Callable[[LocatedFrame], float]:
    """Return a score that says nothing of a pose that is no ordinary one."""
    return lambda frame: score(frame) if frame.is_found else float("nan")


SCORES: dict[str, Callable[[LocatedFrame], float]] = {
    "sure and wrong": wrong_though_sure,
    "largest error": while_found(error_m),
    "least sure": lambda frame: 1.0 - float(frame.located.p_correct),
    "largest uncertainty": while_found(position_sigma_m),
}
"""What an image can be the worst in, and its score: the larger the worse, nan where it says nothing."""


Kept = list[tuple[float, int, LocatedFrame]]
"""Score, number and content of images, the worst first."""


@dataclass(slots=True, eq=False)
class WorstMoments:
    """Keeps the worst images of a run, a sink of `replay`."""

    _kept: dict[str, Kept] = field(default_factory=lambda: {kind: [] for kind in SCORES})
    _number: int = 0

    def frame(self, frame: LocatedFrame) -> None:
        """Take an image, and keep it where it is among the worst."""
        for kind, score_of in SCORES.items():
            score = score_of(frame)
            if np.isfinite(score):
                self._keep(kind, score, frame)
        self._number += 1

    def _keep(self, kind: str, score: float, frame: LocatedFrame) -> None:
        """Keep an image, and of images close in time the worst alone."""
        kept, t_ns = self._kept[kind], frame.located.t_ns
        near = [one for one in kept if abs(one[2].located.t_ns - t_ns) < APART_NS]
        if all(one[0] < score for one in near):
            far = [one for one in kept if abs(one[2].located.t_ns - t_ns) >= APART_NS]
            worst = sorted([*far, (score, self._number, frame)], key=lambda one: (-one[0], one[1]))
            self._kept[kind] = worst[:MOST_OF_A_KIND]

    def close(self, complete: bool) -> None:
        """End; what was kept stays."""

    @property
    def moments(self) -> list[Moment]:
        """The worst images, each once, in the order of time."""
        frames: dict[int, LocatedFrame] = {}
        reasons: dict[int, list[str]] = {}
        for kind, kept in self._kept.items():
            for _, number, frame in kept:
                frames[number] = frame
                reasons.setdefault(number, []).append(kind)
        return [Moment(number, frames[number], tuple(reasons[number])) for number in sorted(frames)]


# -- a moment as pictures ---------------------------------------------------------------------------------------------

JPEG_QUALITY = 80
PARTICLES = 400  # as many as show where the cloud is
AROUND_M = 4.0
LIKELY = 0.02  # the weight from which on a place is drawn


def image_svg(frame: LocatedFrame, camera: Camera, landmark_map: LandmarkMap) -> str:
    """Return the image; green: edges that match a landmark, red: edges without one, blue: where landmarks are expected.

    Without an image there are the lines alone.
    """
    edges, matches = frame.located.edges, frame.matches
    parts = [f'<rect width="{camera.width}" height="{camera.height}" class="empty"/>']
    if frame.image is not None:
        content = frame.image if isinstance(frame.image, bytes) else b""
        if content[:2] != b"\xff\xd8":  # another file than a JPEG, or pixels
            pixels: Any = decode(content, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if content else frame.image
            content = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
        uri = f"data:image/jpeg;base64,{b64encode(content).decode()}"
        parts.append(f'<image width="{camera.width}" height="{camera.height}" href="{uri}"/>')
    ends = landmark_ends(landmark_map, camera)
    _, lines = predicted_lines(
        camera.at(frame.located.edges.mount), frame.located.estimate.as_seen.pose, ends, matches.visible
    )
    parts += [_line(line, "expected") for line in lines]
    known = np.isfinite(edges.ends_px).all(axis=(1, 2))
    for ends_px, landmark in zip(edges.ends_px[known], matches.landmark[known], strict=True):
        parts.append(_line(ends_px, "matched" if landmark >= 0 else "unmatched"))
    return f'<svg viewBox="0 0 {camera.width} {camera.height}" role="img">{"".join(parts)}</svg>'


def map_svg(frame: LocatedFrame, landmark_map: LandmarkMap, path: Array, aspect: float = 4 / 3) -> str:
    """Return the map around the robot as seen from above, x to the right and map -z up, with all that is believed.

    path: (T, 3) estimates up to this image. aspect: width over height.
    """
    located, matches, points = frame.located, frame.matches, landmark_map.points
    low, high = _frame_of(frame, points, aspect)
    size = high - low
    dot = float(size[0]) / 160

    def dots(at: Array, kind: str, radius: float) -> list[str]:
        inside = at[((at >= low) & (at <= high)).all(axis=1)]
        return [f'<circle cx="{x:.3f}" cy="{z:.3f}" r="{radius:.3f}" class="{kind}"/>' for x, z in inside]

    matched = np.unique(matches.landmark[matches.landmark >= 0])
    expected = np.setdiff1d(np.flatnonzero(matches.visible), matched)
    unseen = np.setdiff1d(np.arange(len(points)), np.concatenate([matched, expected]))
    pose = located.estimate.pose
    parts = [f'<rect x="{low[0]:.3f}" y="{low[1]:.3f}" width="{size[0]:.3f}" height="{size[1]:.3f}" class="floor"/>']
    parts += [_line(np.stack([pose[:2], points[landmark]]), "sight") for landmark in matched]
    parts += dots(points[unseen], "unseen", dot) + dots(points[expected], "expected-point", dot)
    parts += dots(points[matched], "matched-point", 1.2 * dot)
    parts.append(_line(path[:, :2], "path"))
    places = located.clusters
    if places is not None:
        parts += [_ellipse(m, c) for w, m, c in zip(places.weight, places.mean, places.cov, strict=True) if w >= LIKELY]
    parts.append(_ellipse(pose, located.estimate.pose_cov))
    if frame.truth is not None:
        parts.append(_arrow(frame.truth, 5 * dot, "truth"))
    parts.append(_arrow(pose, 5 * dot, "estimate"))
    every = max(1, len(located.particles) // PARTICLES)
    parts += dots(located.particles.poses[::every, :2], "particle", 0.5 * dot)
    left, level = low[0] + 0.04 * size[0], high[1] - 0.05 * size[1]
    parts.append(_line(np.array([[left, level], [left + 1, level]]), "scale"))
    at, font = f'x="{left:.3f}" y="{level - 0.015 * size[1]:.3f}"', f"{0.04 * size[1]:.3f}"
    parts.append(f'<text {at} font-size="{font}">1 m</text>')
    box = f"{low[0]:.3f} {low[1]:.3f} {size[0]:.3f} {size[1]:.3f}"
    return f'<svg viewBox="{box}" role="img">{"".join(parts)}</svg>'


def _frame_of(frame: LocatedFrame, points: Array, aspect: float) -> tuple[Array, Array]:
    """Return the corners (2,) and (2,) of what is drawn.

    That is estimate, truth and likely places, some metres around them, and the landmarks in view that are not far.
    """
    located = frame.located
    poses = [located.estimate.pose[:2]] + ([] if frame.truth is None else [frame.truth[:2]])
    if located.clusters is not None:
        poses += list(located.clusters.mean[located.clusters.weight >= LIKELY, :2])
    low, high = np.min(poses, axis=0) - AROUND_M, np.max(poses, axis=0) + AROUND_M
    seen = points[frame.matches.visible]
    seen = seen[((seen > low - AROUND_M) & (seen < high + AROUND_M)).all(axis=1)]
    low, high = np.min([low, *(seen - 0.3)], axis=0), np.max([high, *(seen + 0.3)], axis=0)
    size = np.maximum(high - low, (high - low)[::-1] * [aspect, 1 / aspect])
    return (low + high - size) / 2, (low + high + size) / 2


def _line(points: Array, kind: str) -> str:
    known = points[np.isfinite(points).all(axis=1)]
    text = " ".join(f"{x:.3f},{y:.3f}" for x, y in known)
    return f'<polyline points="{text}" class="{kind}"/>'


def _arrow(pose: Array, length: float, kind: str) -> str:
    """Return a triangle that points where the robot faces."""
    ahead = forward(pose[2]) * length
    aside = np.array([-ahead[1], ahead[0]]) * 0.4
    corners = [pose[:2] + ahead, pose[:2] - 0.4 * ahead + aside, pose[:2] - 0.4 * ahead - aside]
    return f'<polygon points="{" ".join(f"{x:.3f},{z:.3f}" for x, z in corners)}" class="{kind}"/>'


def _ellipse(mean: Array, cov: Array) -> str:
    """Return the 3σ ellipse of a position."""
    variance, axes = np.linalg.eigh(cov[:2, :2])
    minor, major = 3 * np.sqrt(np.maximum(variance, 0))
    angle_deg = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
    place = f"translate({mean[0]:.3f} {mean[1]:.3f}) rotate({angle_deg:.1f})"
    return f'<ellipse rx="{major:.4f}" ry="{minor:.4f}" transform="{place}" class="spread"/>'


# -- the page ---------------------------------------------------------------------------------------------------------

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1f2933; margin: 2rem auto; max-width: 1320px; padding: 0 1rem; }
h1 { margin: 0; } h2 { margin: 2.2rem 0 .4rem; } .muted, figcaption, dt { color: #56616d; }
.figures { display: flex; flex-wrap: wrap; gap: .6rem 2rem; margin: .8rem 0; }
.figures dd { margin: 0; font-size: 1.35rem; font-weight: 650; } .figures dt { font-size: .85rem; }
.warning { color: #b34700; font-weight: 600; }
.moment { display: grid; grid-template-columns: 1fr 1fr; gap: .8rem; margin: 1.2rem 0 2rem; }
.moment > * { min-width: 0; } .moment h3, .moment figcaption { grid-column: 1 / -1; margin: 0; }
@media (max-width: 800px) { .moment { grid-template-columns: 1fr; } }
figure { margin: 0; } svg, img { width: 100%; height: auto; display: block; } svg { border: 1px solid #cbd2d9; }
polyline { fill: none; vector-effect: non-scaling-stroke; } .empty { fill: #2b333c; } .floor { fill: #fbfcfd; }
.matched { stroke: #36d17c; stroke-width: 2.2; } .unmatched { stroke: #ff5a36; stroke-width: 2.2; }
.expected { stroke: #4da3ff; stroke-width: 1.4; stroke-dasharray: 5 4; }
.sight { stroke: #009e73; stroke-width: 1; opacity: .45; } .path { stroke: #0072b2; stroke-width: 1.6; }
.unseen { fill: #9aa5b1; } .expected-point { fill: #4da3ff; } .matched-point { fill: #009e73; }
.particle { fill: #d55e00; opacity: .35; } .estimate { fill: #0072b2; opacity: .75; }
.truth { fill: #1f2933; opacity: .75; }
.spread { fill: #56b4e9; fill-opacity: .2; stroke: #0072b2; stroke-width: 1; vector-effect: non-scaling-stroke; }
.scale { stroke: #1f2933; stroke-width: 2; } .key b { padding-left: .9rem; }
"""
# Key in the metrics, how it reads: what tells runs apart.
ABOUT = (
    ("observation", "{}"),
    ("association", "associations {}"),
    ("odometry", "odometry {}"),
    ("start", "start {}"),
    ("map", "map {}"),
    ("particles", "{} particles"),
    ("seed", "seed {}"),
    ("frames", "{} frames"),
)


KEY = (
    '<p class="key">Image: <b style="color:#1fa35c">green</b> edges that match a landmark, '
    '<b style="color:#ff5a36">red</b> edges without one, <b style="color:#2b7fd6">blue</b> where landmarks are '
    "expected. Map: the same colours for landmarks, grey those out of view; "
    '<b style="color:#d55e00">orange</b> particles, <b style="color:#0072b2">blue</b> estimate with its path and '
    "3σ ellipses of all likely places, <b>black</b> the truth where it is known.</p>"
)
MEANINGS = (
    ("found after", "when the probability of being right was above 0.9 for the first time; 0 for a stated start"),
    ("not found yet", "images before that; all figures of path and error leave them out"),
    ("images sure", "images in which that probability was above 0.9"),
    ("edges matched", "measured edges that match a landmark of the map"),
    ("residuals", "squared distance of matched edges from their landmarks, over what their sigmas make expect: 1 is "
     "right; below, the filter is cautious; above, sigmas are too small, or the map or the camera is wrong"),
    ("3σ", "three times the distance that the filter expects to be off"),
    ("odometry alone", "RMSE of the path by odometry, from where the robot was found"),
    ("sure and wrong", "images above 0.9 that were not within 0.5 m and 10° of the truth"),
    ("NEES", "squared error over what the covariance makes expect: 3 is right; below, the filter is cautious; above, "
     "it is too sure"),
)  # fmt: skip


def report_page(
    track: Track,
    figures: Mapping[str, Any],
    moments: Sequence[Moment],
    *,
    camera: Camera,
    landmark_map: LandmarkMap,
    picture: bytes = b"",
) -> str:
    """Return the page. figures: as `metrics` returns them. picture: the report as PNG."""
    name = escape(str(figures["log"]))
    about = "  ·  ".join(text.format(figures[key]) for key, text in ABOUT if figures.get(key) is not None)
    body = [
        f"<h1>{name}</h1>",
        f'<p class="muted">{escape(about)}</p>',
        *(_remark(remark) for remark in remarks(figures) if remark.startswith("Warning")),
    ]
    for title, columns in TABLES.items():
        known = [(one.label, one.text(value) + one.unit) for one in columns if one.is_known(value := one.of(figures))]
        if columns is OWN and figure_at(figures, "confidence.not_found") == 1:
            known.insert(0, ("found after", "never"))
        tiles = (f"<div><dd>{escape(value)}</dd><dt>{escape(label)}</dt></div>" for label, value in known if label)
        body += [f'<h2>{title}</h2><dl class="figures">{"".join(tiles)}</dl>'] if known else []
    body += [_remark(remark) for remark in remarks(figures) if not remark.startswith("Warning")]
    if picture:
        body.append(f'<img alt="Report" src="data:image/png;base64,{b64encode(picture).decode()}">')
    body += ["<h2>Worst moments</h2>", KEY, *(_moment(moment, track, camera, landmark_map) for moment in moments)]
    meanings = "".join(f"<dt><b>{escape(word)}</b></dt><dd>{escape(meaning)}</dd>" for word, meaning in MEANINGS)
    body += ["<h2>What the figures mean</h2>", f"<dl>{meanings}</dl>"]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{name}</title>'
    return f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head>\n<body>\n' + (
        "\n".join(body) + "\n</body></html>\n"
    )


def remarks(figures: Mapping[str, Any]) -> list[str]:
    """Return what a run says in words: learnt constants, gaps, warnings."""
    found = []
    if constants := learnt_constants(figures):
        found.append(f"Learnt: {', '.join(constants)}.")
    if gaps := figures.get("pauses"):
        longest = max(gap["duration_s"] for gap in gaps)
        found.append(
            f"{len(gaps)} gaps of more than {PAUSE_LONGER_THAN_S:g} s without edges, the longest {longest:.1f} s."
        )
    if used := figures.get("landmarks"):
        found.append(f"Of {used['known']} landmarks, {used['in_view']} were in view and {used['matched']} matched.")
    return [*found, *(f"Warning: {warning}" for warning in figures.get("warnings") or ())]


def _remark(text: str) -> str:
    return f'<p class="{"warning" if text.startswith("Warning") else "muted"}">{escape(text)}</p>'


def _moment(moment: Moment, track: Track, camera: Camera, landmark_map: LandmarkMap) -> str:
    """Return the pictures of a moment, and its figures in words."""
    frame, located, matches = moment.frame, moment.frame.located, moment.frame.matches
    matched = int((matches.landmark >= 0).sum())
    found, expected, _ = residual_sums(matches)
    parts = [
        f"Probability of being right {located.p_correct:.3f}" + (f" ({located.reason})" if located.reason else ""),
        f"3σ {3 * position_sigma_m(frame):.3f} m and {np.degrees(3 * np.sqrt(located.estimate.pose_cov[2, 2])):.2f}°",
        f"{matched} of {len(matches.landmark)} edges matched, {int(matches.visible.sum())} landmarks in view",
    ]
    if np.isfinite(found):
        parts.append(f"residuals {found / expected:.2f}")
    likely = np.zeros(0) if located.clusters is None else located.clusters.weight[located.clusters.weight >= LIKELY]
    if len(likely) > 1:
        parts.append(f"{len(likely)} places with weights {', '.join(f'{weight:.2f}' for weight in likely[:5])}")
    if frame.truth is not None:
        parts.append(f"error {error_m(frame):.3f} m")
    seconds = float(track.seconds[moment.number])
    title = f"{', '.join(moment.reasons).capitalize()}: image {moment.number} at {seconds:.1f} s"
    path = track.poses[: moment.number + 1] - landmark_map.origin(frame.map_name)
    landmark_map = landmark_map.seen_on(frame.map_name)
    image = image_svg(frame, camera, landmark_map)
    on_map = map_svg(frame, landmark_map, path, camera.width / camera.height)
    return (
        f'<figure class="moment"><h3>{escape(title)}</h3><div>{image}</div><div>{on_map}</div>'
        f"<figcaption>{escape('; '.join(parts))}.</figcaption></figure>"
    )
