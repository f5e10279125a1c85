"""The measured motions as tables, beside what the paper has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise

import numpy as np

from localiser.geometry import Array
from paper.equations import TABLE_2, TILT_2_DEG
from paper.motions import DRIVE_M, TURNS_RAD, VIEWS, Measured, pair_of, slopes, turn_of_edges, turn_rad, turns
from paper.room import SIZES, Size
from paper.sheet import Sheet
from paper.slopes import depth_from_slopes, motion_from_slopes

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
GROUPS = (("< 5°", 0.0, 5.0), ("> 5°", 5.0, 90.0))
"""Bearings of edges, by how far they lie from straight ahead."""


def _of_size(size: Size) -> str:
    return f"{size[0]}×{size[1]}"


# -- turns ------------------------------------------------------------------------------------------------------------


def turn_errors(found: Measured, size: Size, method: Method, by: int) -> tuple[Array, Array]:
    """Return the errors (K,) rad of all turns from a view to the `by`-th after it, by one edge, and sigmas (K,)."""
    pairs = turns(found[size, method.detector], by)
    measured = [(turn_of_edges(pair.first, pair.second, method.kind), true_rad) for pair, true_rad in pairs]
    errors = [turn - true_rad for (turn, _), true_rad in measured]
    return np.concatenate(errors), np.concatenate([sigma for (_, sigma), _ in measured])


def _together(found: Measured, size: Size, by: int) -> Array:
    """Return the errors (P,) rad of turns from all edges that two views share, weighed by their sigmas."""
    errors = []
    for pair, true_rad in turns(found[size, "columns"], by):
        turn, sigma = turn_of_edges(pair.first, pair.second, "line")
        if len(turn):
            errors.append(np.average(turn, weights=sigma**-2) - true_rad)
    return np.array(errors)


def rotations(found: Measured) -> Sheet:
    """Return how far off turns by about 10° are, at each size of the image."""
    apart = np.abs([psi - delta for _, delta, psi in TABLE_2])
    paper = (str(len(apart)), f"{np.median(apart):.2f}", f"{apart.max():.2f}", "–")
    rows = [(_of_size(SIZES[0]), _turn_range(1), "the paper's real robot, ψ against δ", *paper)]
    for size in SIZES:
        label = _of_size(size), _turn_range(1)
        for method in METHODS:
            error, sigma = turn_errors(found, size, method, 1)
            spread = np.median(np.abs(error / sigma)) / _ROBUST if len(error) else np.nan
            rows.append((*label, method.name, str(len(error)), *_degrees(error), f"{spread:.2f}"))
        together = _together(found, size, 1)
        rows.append((*label, "columns, line, all edges", str(len(together)), *_degrees(together), "–"))
    return Sheet(
        "rotations",
        f"Turns on the spot before rendered images, tilt {TILT_2_DEG}°: error of ψ",
        ("image", "turn °", "by", "edges", "median °", "95 % °", "error/σ"),
        tuple(rows),
        "median and 95 % of |ψ − true|. Each edge by itself, as the paper does, or all of a pair of views together. "
        "error/σ: robust spread of errors over their own sigmas; 1 is honest, below 1 cautious.",
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
    columns = {
        f"{_of_size(size)} {method.name.split(' (')[0]}": _each_turn(found, size, method, *chosen)
        for size in SIZES
        for method in METHODS
    }
    turns_rad = zip(TABLE_2, TURNS_RAD, *columns.values(), strict=True)
    return Sheet(
        "table_2",
        f"Table 2: three turns, by the paper's real robot and by one edge of rendered images, tilt {TILT_2_DEG}°",
        ("image", "paper δ", "paper ψ", "true ψ", *columns),
        tuple(
            (str(image), f"{delta:.2f}", f"{psi:.2f}", *(f"{np.rad2deg(turn):.2f}" for turn in seen))
            for (image, delta, psi), *seen in turns_rad
        ),
        "Degrees. δ: by the camera's extrinsic parameters; ψ: by eq. 13.",
    )


def track(found: Measured) -> tuple[int, int] | None:
    """Return the first place, and the landmark with the longest edge there, that all see in all four views."""
    for index, at in enumerate(zip(*found.values(), strict=True)):
        everywhere = reduce(np.intersect1d, [view.landmark for place in at for view in place.turned])
        if len(everywhere):
            first = found[SIZES[0], "hough"][index].turned[0]
            length = [first.edges.length_px[first.landmark == landmark].max() for landmark in everywhere]
            return index, int(everywhere[int(np.argmax(length))])
    return None


def _each_turn(found: Measured, size: Size, method: Method, place: int, landmark: int) -> list[float]:
    # Of one landmark whatever the polarity: a pillar may be lit differently, it stays the same edge.
    turned = found[size, method.detector][place].turned
    seen = [view.edges.take(np.flatnonzero(view.landmark == landmark)[:1]) for view in turned]
    return [float(turn_of_edges(first, second, method.kind)[0][0]) for first, second in pairwise(seen)]


# -- driving ----------------------------------------------------------------------------------------------------------


def drive_errors(found: Measured, size: Size, method: Method) -> dict[str, Array]:
    """Return for edges (K,) seen before and after driving ahead: bearing, and errors by eq. 10 and 11.

    forward_m, backward_m: of d (eq. 11, z known), driving ahead and, with the views swapped, back. depth: of z (eq. 10,
    d known), relative. nan: where the slopes tell nothing.
    """
    places = found[size, method.detector]
    pairs = [pair_of(place.turned[0], place.ahead) for place in places]
    first, second = (
        np.concatenate([slopes(edges, method.kind) for edges in views])
        for views in zip(*((pair.first, pair.second) for pair in pairs), strict=True)
    )
    z_first = np.concatenate([place.points[pair.landmark, 1] for place, pair in zip(places, pairs, strict=True)])
    ahead = -DRIVE_M  # d = z1 − z2, and z < 0 ahead
    return {
        "bearing_deg": np.rad2deg(np.concatenate([pair.first.bearing for pair in pairs])),
        "forward_m": motion_from_slopes(first, second, z_first) - ahead,
        "backward_m": motion_from_slopes(second, first, z_first - ahead) + ahead,
        "depth": depth_from_slopes(first, second, ahead) / z_first - 1,
    }


def translations(found: Measured) -> Sheet:
    """Return how far off driving ahead and back is, and the depth of edges, by where the edges are."""
    judged = ("d ahead", "cm"), ("d back", "cm"), ("z", "%")
    errors = (f"{name}\n{quantile} {unit}" for name, unit in judged for quantile in ("median", "95 %"))
    return Sheet(
        "translations",
        f"Driving {100 * DRIVE_M:.0f} cm ahead and back (eq. 9–11): error of d with z known, of z with d known",
        ("image", "by", "bearing", "edges", *errors),
        tuple(_translation_rows(found)),
        "Near straight ahead an edge hardly moves: slopes differ by less than they are off, and d is anything. "
        "∞: both slopes infinite, which tells nothing.",
    )


def _translation_rows(found: Measured) -> Iterator[tuple[str, ...]]:
    for size in SIZES:
        for method in METHODS:
            bearing_deg, *errors = drive_errors(found, size, method).values()
            for name, low, high in GROUPS:
                of = (np.abs(bearing_deg) >= low) & (np.abs(bearing_deg) < high)
                cells = [_quantile(100 * error[of], share, ".1f") for error in errors for share in (0.5, 0.95)]
                yield _of_size(size), method.name, name, str(int(of.sum())), *cells
