"""What each detector found in all images together, and how far detectors agree."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array

NEAR_PX = 2.5
"""Edges this close are the same: wider than any detector's error, narrower than a door frame in most images."""
_COVERED_SHARE = 0.5
"""An edge is found again when this share of it has the other detector's edges near it."""
_STEPS = 41


class Comparison:
    """Counts and figures of detectors over images, as lists by name: a value an image, an edge, or an edge found again.

    also, apart_rad: of each other detector, how many edges it found as well (an image each), and bearings apart.
    """

    def __init__(self, detectors: list[str]) -> None:
        self._lists: dict[str, dict[str, list[float]]] = {name: defaultdict(list) for name in detectors}

    def add(self, found: dict[str, Edges], ms: dict[str, float], camera: Camera) -> None:
        """Count the edges that the detectors found in one image."""
        for name, edges in found.items():
            of = self._lists[name]
            of["ms"].append(ms[name])
            of["rejected"].append(len(edges.rejected_px))
            of["feet"].append(float(np.nansum(edges.foot_probability)))
            of["length_px"] += edges.length_px.tolist()
            of["sigma_rad"] += edges.bearing_sigma.tolist()
            for other, others in found.items():
                match = matches(edges, others, camera) if other != name else np.arange(len(edges))
                again = match >= 0
                of[f"also {other}"].append(int(again.sum()))
                of[f"apart_rad {other}"] += (edges.bearing[again] - others.bearing[match[again]]).tolist()

    def rows(self) -> list[dict[str, Any]]:
        """Return one row a detector: counts, median length and sigma, median time, and shares found by the others."""
        return [self._row(name, lists) for name, lists in self._lists.items()]

    def _row(self, name: str, of: dict[str, list[float]]) -> dict[str, Any]:
        images, edges = len(of["ms"]), len(of["length_px"])
        row: dict[str, Any] = {
            "detector": name,
            "images": images,
            "edges": edges,
            "edges_per_image": edges / max(images, 1),
            "rejected_per_image": sum(of["rejected"]) / max(images, 1),
            "feet_per_image": sum(of["feet"], start=0.0) / max(images, 1),
            "length_median_px": _median(of["length_px"]),
            "bearing_sigma_median_deg": np.rad2deg(_median(of["sigma_rad"])),
            "ms_median": _median(of["ms"]),
        }
        for other in self._lists:
            apart = np.rad2deg(np.abs(of[f"apart_rad {other}"]))
            row[f"share_also_{other}"] = 1.0 if other == name else sum(of[f"also {other}"]) / max(edges, 1)
            row[f"apart_median_{other}_deg"] = 0.0 if other == name else _median(apart.tolist())
        return row


def matches(edges: Edges, others: Edges, camera: Camera) -> NDArray[np.int64]:
    """Return for edges (E,) the index of the other detector's edge that lies nearest along them, or -1.

    An edge has a match when edges of the other detector lie within `NEAR_PX` of at least half of it, so that two pieces
    match one whole, and one of them is the nearest. Distances are across the line, where the lens bends nothing.
    """
    if len(edges) == 0 or len(others) == 0:
        return np.full(len(edges), -1, dtype=np.int64)
    straight = camera.undistorted()
    near = _near(*(straight.pixels_from_image(camera.image_from_pixels(each.ends_px)) for each in (edges, others)))
    covered = near.any(axis=2).mean(axis=1) >= _COVERED_SHARE
    return np.where(covered, near.mean(axis=1).argmax(axis=1), -1).astype(np.int64)


def _near(ends: Array, others: Array) -> NDArray[np.bool_]:
    """Return which of the points along segments (E, 2, 2) lie near the segments (O, 2, 2): (E, points, O)."""
    along = np.linspace(0.0, 1.0, _STEPS)[:, None]
    points = (ends[:, None, 0] * (1 - along) + ends[:, None, 1] * along)[:, :, None]
    start, step = others[:, 0], others[:, 1] - others[:, 0]
    share = ((points - start) * step).sum(axis=-1) / np.maximum((step**2).sum(axis=-1), 1e-12)
    nearest = start + share.clip(0, 1)[..., None] * step
    return np.asarray(np.linalg.norm(points - nearest, axis=-1) <= NEAR_PX)


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")
