"""What follows from the paper's equations alone: its table 1, its steepest slope, one pixel at each end, drift.

[Taylor06] T. Taylor, S. Geva, W. W. Boles, "Using Camera Tilt to Assist with Localisation", ICARA 2006.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.geometry import Array
from paper.room import SIZES, camera_of
from paper.sheet import Sheet
from paper.slopes import bearing_of_image_point, rotation_from_slopes

TILT_1_DEG = 30.0
"""Of example 1, simulated."""
TILT_2_DEG = 18.97
"""Of example 2, the real robot."""
TABLE_1 = ((106.82, 95.16, 20.9), (97.54, 87.54, 19.7))
"""Slopes in two views and psi as printed; the camera turned by 20 degrees."""
TABLE_2 = ((2, 10.96, 10.72), (3, 10.33, 8.09), (4, 10.39, 14.92))
"""Image, delta by extrinsic parameters, psi by eq. 13."""
Moves = tuple[tuple[int, int], ...]
MOVES: dict[str, Moves] = {"one end": ((0, 1), (1, 0)), "both ends": ((-1, 1), (1, -1), (1, 1), (-1, -1))}
"""Pixels by which bottom and top end are moved."""
_JAMB_M = 2.0
"""How far the door jamb of example 2 is taken to stand; the paper does not say."""
_BEARINGS_2_RAD = np.deg2rad([10.0, 0.0, -10.0, -20.0])
"""Of the jamb in its four images: nearly straight ahead in the second, as the paper says."""


def table_1() -> Sheet:
    """Return the paper's table 1 with psi by our own eq. 13."""
    rows = []
    for first, second, printed in TABLE_1:
        slopes = np.tan(np.deg2rad([first, second]))
        psi = float(np.rad2deg(rotation_from_slopes(slopes[0], slopes[1], np.deg2rad(TILT_1_DEG))))
        rows.append((f"{first:.2f}", f"{second:.2f}", f"{printed:.1f}", f"{psi:.2f}", f"{psi - 20:+.2f}"))
    return Sheet(
        "table_1",
        "Table 1: a turn by 20° from the slopes of two edges, tilt 30° (eq. 13)",
        ("slope 1 °", "slope 2 °", "paper's ψ °", "ψ °", "error °"),
        tuple(rows),
        "The second edge crosses the image's centre, where m jumps from −∞ to +∞: ψ is unwrapped by π.",
    )


def steepest_slope() -> Sheet:
    """Return the slope that departs most from 90 degrees, at the bottom corners, for several views."""
    cases = (
        ("the paper's: 60° across, 4:3", 60.0, 4 / 3, 30.0),
        ("the real robot's tilt", 60.0, 176 / 144, TILT_2_DEG),
        ("less tilt", 60.0, 4 / 3, 10.0),
        ("a narrow view", 40.0, 4 / 3, 30.0),
        ("a wide view", 90.0, 4 / 3, 30.0),
    )
    rows = []
    for name, across_deg, aspect, tilt_deg in cases:
        slope_deg, share = _slopes_of_view(np.deg2rad(across_deg), aspect, np.deg2rad(tilt_deg))
        rows.append((name, f"{across_deg:.0f}", f"{tilt_deg:.2f}", f"{slope_deg:.1f}", f"{share:.0%}"))
    return Sheet(
        "steepest_slope",
        "Section 2.1: the slope furthest from vertical, and how much of the view has 70° to 90°",
        ("view", "across °", "tilt °", "furthest °", "70–90°"),
        tuple(rows),
        "The paper says “around 66°”, and that most edges have 70° to 90°.",
    )


def _slopes_of_view(across_rad: float, aspect: float, tilt_rad: float) -> tuple[float, float]:
    right = np.tan(across_rad / 2)
    a, e = np.meshgrid(np.linspace(-right, right, 201), np.linspace(-right / aspect, right / aspect, 151))
    lean = geometry.lean_from_bearing(bearing_of_image_point(a, e, tilt_rad), tilt_rad)
    slope_deg = 90 - np.rad2deg(np.abs(lean))
    return float(slope_deg.min()), float((slope_deg >= 70).mean())


def one_pixel() -> Sheet:
    """Return how far psi moves when the ends of an edge of table 1 move by one pixel, in one of its two views."""
    rows = []
    for size, (name, moves) in product(SIZES, MOVES.items()):
        camera = camera_of(size, TILT_1_DEG)
        leans = np.deg2rad([90 - slope_deg for line in TABLE_1 for slope_deg in line[:2]])
        bearings = geometry.bearing_from_lean(leans, camera.mount.tilt_rad)
        edges = [_whole_edge(camera, float(bearing)) for bearing in bearings]
        length = [float(np.linalg.norm(ends[1] - ends[0])) for ends in edges]
        by_slope, by_line = np.array([_moved_deg(camera, ends, moves) for ends in edges]).T
        ranges = (f"{min(by):.2f}–{max(by):.2f}" for by in (by_slope, by_line))
        rows.append((f"{size[0]}×{size[1]}", name, f"{min(length):.0f}–{max(length):.0f}", *ranges))
    return Sheet(
        "one_pixel",
        "Section 4.1: what one pixel does to ψ, for the slopes of table 1 and edges as long as the image allows",
        ("image", "moved by 1 px", "length px", "ψ by slope °", "ψ by line °"),
        tuple(rows),
        "The paper: ½ to 2 degrees. By line: the same ends, with the line held through the nadir point. "
        "An edge half as long moves ψ by slope twice as far, ψ by line hardly more. The range is over the four slopes.",
    )


def _whole_edge(camera: Camera, bearing_rad: float) -> Array:
    """Return the ends (2, 2) px, bottom first, of an edge at this bearing, cut off by the image's border."""
    e = (camera.cy - np.linspace(camera.height - 1.0, 0.0, camera.height)) / camera.focal_px
    a = np.tan(bearing_rad) * (np.cos(camera.mount.tilt_rad) + e * np.sin(camera.mount.tilt_rad))
    pixels = camera.pixels_from_upright(np.stack([a, e], axis=-1))
    inside = pixels[np.all((pixels >= 0) & (pixels <= [camera.width - 1, camera.height - 1]), axis=1)]
    return np.asarray(inside[[0, -1]])


def _moved_deg(camera: Camera, ends: Array, moves: Moves) -> tuple[float, float]:
    """Return by how many degrees the bearing by slope, and the one by line, move at most.

    moves: pixels to the right by which bottom and top (2, 2) px are moved.
    """
    moved = ends + np.array([[[bottom, 0.0], [top, 0.0]] for bottom, top in ((0, 0), *moves)])
    slope = geometry.bearing_from_lean(camera.lean_of_segments(moved), camera.mount.tilt_rad)
    by_slope, by_line = (
        float(np.rad2deg(np.abs(found - found[0]).max())) for found in (slope, camera.bearing_of_segments(moved))
    )
    return by_slope, by_line


def explanations() -> Sheet:
    """Return what psi of table 2 would have been, had something else than a turn on the spot happened."""
    cases = (
        ("nothing else", _psi_seen()),
        ("camera 10 cm ahead of the turning point", _psi_seen(ahead_m=0.10)),
        ("drift by 10 cm to the left, in the last turn", _psi_seen(last_drift_left_m=0.10)),
        ("tilt is 1° more than stated", _psi_seen(tilt_error_deg=1.0)),
        ("roll is 0.5° more than stated", _psi_seen(roll_error_deg=0.5)),
    )
    unknown = ("–",) * 3
    rows = [("paper, by eq. 13", *(f"{psi:.2f}" for _, _, psi in TABLE_2), *unknown)]
    rows += [("paper, by extrinsic parameters", *(f"{delta:.2f}" for _, delta, _ in TABLE_2), *unknown)]
    rows += [(name, *(f"{np.rad2deg(value):.2f}" for value in psi.ravel())) for name, psi in cases]
    pixel = (f"±{value:.2f}" for value in _pixel_in_both_views().ravel())
    rows.append(("one pixel at each end, in both views", *pixel))
    images = [f"image {image} °\n{kind}" for kind in ("slope", "line") for image, _, _ in TABLE_2]
    return Sheet(
        "explanations",
        f"Table 2: what else moves ψ; a jamb {_JAMB_M:.0f} m away that starts 10° to the right, tilt {TILT_2_DEG}°",
        ("cause", *images),
        tuple(rows),
        "Distance and start are assumed: the paper does not give them. Drift to the left makes the last ψ smaller, "
        "not larger; one pixel at each end of the edge, here as long as a 176×144 image allows, is enough for 14.92°.",
    )


def _psi_seen(
    ahead_m: float = 0.0, last_drift_left_m: float = 0.0, tilt_error_deg: float = 0.0, roll_error_deg: float = 0.0
) -> Array:
    """Return psi (2, 3), by slope and by line, of a jamb seen in four views.

    ahead_m: of the camera on the robot. last_drift_left_m: to the robot's left, in the turn before the last view.
    tilt_error_deg, roll_error_deg: true minus stated.
    """
    headings = -np.deg2rad(np.cumsum([0.0, *(delta for _, delta, _ in TABLE_2)]))
    jamb = _JAMB_M * np.array([np.sin(_BEARINGS_2_RAD[0]), -np.cos(_BEARINGS_2_RAD[0])])
    poses = np.stack([np.zeros(4), np.zeros(4), headings], axis=-1)
    # Drift is to the side of the robot as it stands before the turn.
    poses[-1, :2] = -last_drift_left_m * geometry.right(headings[-2])
    seen = geometry.robot_from_map(poses, jamb) - np.array([0.0, -ahead_m])
    stated = camera_of(SIZES[0], TILT_2_DEG)
    tilt_rad = stated.mount.tilt_rad
    true = stated.with_mount(tilt_rad=tilt_rad + np.deg2rad(tilt_error_deg), roll_rad=float(np.deg2rad(roll_error_deg)))
    ends = np.array([_whole_edge(true, float(bearing)) for bearing in np.arctan2(seen[:, 0], -seen[:, 1])])
    slope = geometry.slope_from_lean(stated.lean_of_segments(ends))
    by_slope = -rotation_from_slopes(slope[:-1], slope[1:], tilt_rad)
    return np.stack([by_slope, -np.diff(stated.bearing_of_segments(ends))])


def _pixel_in_both_views() -> Array:
    """Return by how many degrees psi (2, 3), by slope and by line, moves at most."""
    camera = camera_of(SIZES[0], TILT_2_DEG)
    ends = [_whole_edge(camera, float(bearing)) for bearing in _BEARINGS_2_RAD]
    each = np.array([_moved_deg(camera, edge, MOVES["both ends"]) for edge in ends]).T
    return np.asarray(each[:, :-1] + each[:, 1:])
