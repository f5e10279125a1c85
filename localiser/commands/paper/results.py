"""The measured motions as tables, beside what the paper has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np

from localiser import geometry
from localiser.commands.paper import measured
from localiser.commands.paper.arithmetic import TABLE_2, TILT_2_DEG
from localiser.commands.paper.measured import DRIVE_M, TURNS_RAD, VIEWS, Measured, Pair, turn_rad
from localiser.commands.paper.room import SIZES, camera_of
from localiser.commands.paper.sheet import Sheet
from localiser.geometry import Array

_TILT_RAD = float(np.deg2rad(TILT_2_DEG))
_ROBUST = 0.6745  # median |error| of a normal distribution of unit spread


@dataclass(frozen=True, slots=True)
class Method:
    """How an edge is found and what of it is used."""

    name: str
    detector: str
    kind: str


METHODS = (
    Method("Hough, slope (the paper's way)", "hough", "slope"),
    Method("columns, slope", "columns", "slope"),
    Method("columns, line", "columns", "line"),
)
GROUPS = (("< 5°", 0.0, 5.0), ("5–15°", 5.0, 15.0), ("> 15°", 15.0, 90.0))
"""Bearings of edges, by how far they lie from straight ahead."""


# -- turns ------------------------------------------------------------------------------------------------------------


def turn_errors(found: Measured, size: tuple[int, int], method: Method, by: int) -> tuple[Array, Array]:
    """Return the errors (K,) rad of all turns from a view to the `by`-th after it, by one edge, and sigmas (K,)."""
    pairs = measured.turns(found[size, method.detector], by, camera_of(size, TILT_2_DEG))
    errors = [_turn(pair, method.kind)[0] - true_rad for pair, true_rad in pairs]
    return np.concatenate(errors), np.concatenate([_turn(pair, method.kind)[1] for pair, _ in pairs])


def _turn(pair: Pair, kind: str) -> tuple[Array, Array]:
    if kind == "slope":
        return measured.turn_by_slope(pair, _TILT_RAD), np.hypot(*pair.slope_sigma.T)
    return measured.turn_by_line(pair), np.hypot(*pair.line_sigma.T)


def _together(found: Measured, size: tuple[int, int], by: int) -> Array:
    """Return the errors (P,) rad of turns from all edges that two views share, weighed by their sigmas."""
    errors = []
    for pair, true_rad in measured.turns(found[size, "columns"], by, camera_of(size, TILT_2_DEG)):
        turn, sigma = _turn(pair, "line")
        if len(turn):
            errors.append(np.average(turn, weights=sigma**-2) - true_rad)
    return np.array(errors)


def rotations(found: Measured) -> Sheet:
    """Return how far off turns by about 10° and 20° are, at each size of the image."""
    rows = [_paper_row()]
    for size in SIZES:
        for by in (1, 2):
            label = f"{size[0]}×{size[1]}", _turn_range(by)
            for method in METHODS:
                error, sigma = turn_errors(found, size, method, by)
                spread = np.median(np.abs(error / sigma)) / _ROBUST if len(error) else np.nan
                rows.append((*label, method.name, str(len(error)), *_degrees(error), f"{spread:.2f}"))
            together = _together(found, size, by)
            rows.append((*label, "columns, line, all edges", str(len(together)), *_degrees(together), "–"))
    return Sheet(
        "rotations",
        f"Turns on the spot before rendered images, tilt {TILT_2_DEG}°: error of ψ",
        ("image", "turn °", "by", "edges", "median °", "95 % °", "error/σ"),
        tuple(rows),
        "median and 95 % of |ψ − true|. Each edge by itself, as the paper does, or all of a pair of views together. "
        "error/σ: robust spread of errors over their own sigmas; 1 is honest, below 1 cautious.",
    )


def _paper_row() -> tuple[str, ...]:
    apart = np.abs([psi - delta for _, delta, psi in TABLE_2])
    return (
        "176×144",
        _turn_range(1),
        "the paper's real robot, ψ against δ",
        "3",
        f"{np.median(apart):.2f}",
        f"{apart.max():.2f}",
        "–",
    )


def _turn_range(by: int) -> str:
    """Return the least and the largest turn, in degrees."""
    turn_deg = np.rad2deg([turn_rad(first, by) for first in range(VIEWS - by)])
    return f"{turn_deg.min():.1f}–{turn_deg.max():.1f}"


def _degrees(error_rad: Array) -> tuple[str, str]:
    return _quantile(np.rad2deg(error_rad), 0.5, ".3f"), _quantile(np.rad2deg(error_rad), 0.95, ".3f")


def _quantile(error: Array, share: float, spec: str) -> str:
    """Return a quantile of |error|, where nan is an error without bound."""
    if len(error) == 0:
        return "–"
    value = float(np.quantile(np.where(np.isnan(error), np.inf, np.abs(error)), share, method="nearest"))
    return format(value, spec) if value < 1e4 else "∞"


def three_turns(found: Measured) -> Sheet | None:
    """Return the paper's table 2 beside one edge that is measured in four rendered views; None if there is no such."""
    chosen = track(found)
    if chosen is None:
        return None
    place, landmark = chosen
    columns = {}
    for size in SIZES:
        for method in METHODS:
            columns[f"{size[0]}×{size[1]} {method.name.split(' (')[0]}"] = _each_turn(
                found, size, method, place, landmark
            )
    rows = [
        (str(image), f"{delta:.2f}", f"{psi:.2f}", f"{np.rad2deg(TURNS_RAD[index]):.2f}",
         *(f"{np.rad2deg(turns[index]):.2f}" for turns in columns.values()))
        for index, (image, delta, psi) in enumerate(TABLE_2)
    ]  # fmt: skip
    return Sheet(
        "table_2",
        f"Table 2: three turns, by the paper's real robot and by one edge of rendered images, tilt {TILT_2_DEG}°",
        ("image", "paper δ", "paper ψ", "true ψ", *columns),
        tuple(rows),
        "Degrees. δ: by the camera's extrinsic parameters; ψ: by eq. 13.",
    )


def track(found: Measured) -> tuple[int, int] | None:
    """Return the first place, and the landmark with the longest edge there, that all see in all four views."""
    for place in range(len(next(iter(found.values())))):
        everywhere = reduce(np.intersect1d, [measured.tracked(places[place]) for places in found.values()])
        if len(everywhere):
            first = found[SIZES[0], "hough"][place].turned[0]
            length = [first.edges.length_px[first.landmark == landmark].max() for landmark in everywhere]
            return place, int(everywhere[int(np.argmax(length))])
    return None


def _each_turn(found: Measured, size: tuple[int, int], method: Method, place: int, landmark: int) -> list[float]:
    at = found[size, method.detector][place]
    turns = []
    for first in range(VIEWS - 1):
        # Of one landmark whatever the polarity: a pillar may be lit differently, it stays the same edge.
        seen = [view.edges.take(view.landmark == landmark) for view in at.turned[first : first + 2]]
        if method.kind == "slope":
            slopes = [geometry.slope_from_lean(edges.lean[0]) for edges in seen]
            turns.append(-float(geometry.rotation_from_slopes(slopes[0], slopes[1], _TILT_RAD)))
        else:
            turns.append(float(seen[0].bearing[0] - seen[1].bearing[0]))
    return turns


# -- driving ----------------------------------------------------------------------------------------------------------


def drive_errors(found: Measured, size: tuple[int, int], method: Method) -> dict[str, Array]:
    """Return for edges (K,) seen before and after driving ahead: bearing, and errors by eq. 10 and 11.

    forward_m, backward_m: of d (eq. 11, z known), driving ahead and, with the views swapped, back. depth: of z (eq. 10,
    d known), relative. nan: where the slopes tell nothing.
    """
    pairs = measured.drives(found[size, method.detector], camera_of(size, TILT_2_DEG))
    slope = np.concatenate([measured.slopes_of(pair, method.kind, _TILT_RAD) for pair in pairs])
    z_first = np.concatenate([pair.points[:, 1] for pair in pairs])
    ahead = -DRIVE_M  # d = z1 − z2, and z < 0 ahead
    first, second = slope.T
    return {
        "bearing_deg": np.rad2deg(np.concatenate([pair.line[:, 0] for pair in pairs])),
        "forward_m": geometry.motion_from_slopes(first, second, z_first) - ahead,
        "backward_m": geometry.motion_from_slopes(second, first, z_first - ahead) + ahead,
        "depth": geometry.depth_from_slopes(first, second, ahead) / z_first - 1,
    }


def translations(found: Measured) -> Sheet:
    """Return how far off driving ahead and back is, and the depth of edges, by where the edges are."""
    return Sheet(
        "translations",
        f"Driving {100 * DRIVE_M:.0f} cm ahead and back (eq. 9–11): error of d with z known, of z with d known",
        (
            "image",
            "by",
            "bearing",
            "edges",
            "d ahead\nmedian cm",
            "d ahead\n95 % cm",
            "d back\nmedian cm",
            "d back\n95 % cm",
            "z\nmedian %",
            "z\n95 % %",
        ),
        tuple(_translation_rows(found)),
        "Near straight ahead an edge hardly moves: slopes differ by less than they are off, and d is anything. "
        "∞: both slopes infinite, which tells nothing.",
    )


def _translation_rows(found: Measured) -> Iterator[tuple[str, ...]]:
    for size in SIZES:
        for method in METHODS:
            errors = drive_errors(found, size, method)
            for name, low, high in GROUPS:
                of = (np.abs(errors["bearing_deg"]) >= low) & (np.abs(errors["bearing_deg"]) < high)
                cells = [
                    _quantile(100 * errors[key][of], share, ".1f")
                    for key in ("forward_m", "backward_m", "depth")
                    for share in (0.5, 0.95)
                ]
                yield f"{size[0]}×{size[1]}", method.name, name, str(int(of.sum())), *cells
