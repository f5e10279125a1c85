"""Write the report of a run as one HTML page that needs no other file: figures, the picture, the worst moments."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.evaluate.accuracy import Track
from localiser.evaluate.moment_pictures import LIKELY, image_svg, map_svg
from localiser.evaluate.moments import Moment, error_m, position_sigma_m
from localiser.evaluate.report import ABOUT, ERROR_FIGURES, OWN_FIGURES, KeyFigure, known_figures, remarks
from localiser.evaluate.residuals import residual_sums
from localiser.landmarks import LandmarkMap

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
MEANINGS = (
    ("found after", "from when on the probability of being right was above 0.9 for the first time"),
    ("images sure", "images in which that probability was above 0.9"),
    ("edges matched", "measured edges that match a landmark of the map"),
    ("residuals", "squared distance of matched edges from their landmarks, over what their sigmas make expect: "
     "1 is right, more means that sigmas are too small, or the map or the camera is wrong"),
    ("3σ", "three times the distance that the filter expects to be off, since it was found"),
    ("sure and wrong", "images above 0.9 that were not within 0.5 m and 10° of the truth"),
    ("NEES", "squared error over what the covariance makes expect: 3 is right, more is too sure"),
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
    known = {"What the run knows of itself": OWN_FIGURES, "Errors against the truth": ERROR_FIGURES}
    body = [
        f"<h1>{name}</h1>",
        f'<p class="muted">{escape(about)}</p>',
        *(_remark(remark) for remark in remarks(figures) if remark.startswith("Warning")),
        *(_figures(title, figures, chosen) for title, chosen in known.items()),
        *(_remark(remark) for remark in remarks(figures) if not remark.startswith("Warning")),
    ]
    if picture:
        body.append(f'<img alt="Report" src="data:image/png;base64,{b64encode(picture).decode()}">')
    body += ["<h2>Worst moments</h2>", _key(), *(_moment(moment, track, camera, landmark_map) for moment in moments)]
    meanings = "".join(f"<dt><b>{escape(word)}</b></dt><dd>{escape(meaning)}</dd>" for word, meaning in MEANINGS)
    body += ["<h2>What the figures mean</h2>", f"<dl>{meanings}</dl>"]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{name}</title>'
    return f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head>\n<body>\n' + (
        "\n".join(body) + "\n</body></html>\n"
    )


def _figures(title: str, figures: Mapping[str, Any], chosen: Sequence[KeyFigure]) -> str:
    known = known_figures(figures, chosen)
    tiles = "".join(f"<div><dd>{escape(value)}</dd><dt>{escape(label)}</dt></div>" for label, value in known)
    return f'<h2>{title}</h2><dl class="figures">{tiles}</dl>' if known else ""


def _remark(text: str) -> str:
    return f'<p class="{"warning" if text.startswith("Warning") else "muted"}">{escape(text)}</p>'


def _key() -> str:
    return (
        '<p class="key">Image: <b style="color:#1fa35c">green</b> edges that match a landmark, '
        '<b style="color:#ff5a36">red</b> edges without one, <b style="color:#2b7fd6">blue</b> where landmarks are '
        "expected. Map: the same colours for landmarks, grey those out of view; "
        '<b style="color:#d55e00">orange</b> particles, <b style="color:#0072b2">blue</b> estimate with its path and '
        "3σ ellipses of all likely places, <b>black</b> the truth where it is known.</p>"
    )


def _moment(moment: Moment, track: Track, camera: Camera, landmark_map: LandmarkMap) -> str:
    frame = moment.frame
    seconds = float(track.seconds[moment.number])
    title = f"{', '.join(moment.reasons).capitalize()}: image {moment.number} at {seconds:.1f} s"
    pictures = (
        image_svg(frame, camera, landmark_map),
        map_svg(frame, landmark_map, track.poses[: moment.number + 1], camera.width / camera.height),
    )
    return (
        f'<figure class="moment"><h3>{escape(title)}</h3><div>{pictures[0]}</div><div>{pictures[1]}</div>'
        f"<figcaption>{escape(_caption(moment))}</figcaption></figure>"
    )


def _caption(moment: Moment) -> str:
    """Return the figures of a moment in words."""
    frame, located = moment.frame, moment.frame.located
    matches = frame.matches
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
    return "; ".join(parts) + "."
