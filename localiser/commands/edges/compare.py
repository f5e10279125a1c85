"""What each detector found in all images together, and how far detectors agree."""

from __future__ import annotations

from dataclasses import dataclass, field
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


@dataclass(slots=True)
class Tally:
    """What one detector found. also: how many of its edges each other detector found as well, and bearings apart."""

    images: int = 0
    edges: int = 0
    rejected: int = 0
    feet: float = 0.0
    length_px: list[float] = field(default_factory=list)
    sigma_rad: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    also: dict[str, int] = field(default_factory=dict)
    apart_rad: dict[str, list[float]] = field(default_factory=dict)


class Comparison:
    """Tallies of detectors over images."""

    def __init__(self, detectors: list[str]) -> None:
        self.tallies = {name: Tally() for name in detectors}

    def add(self, found: dict[str, Edges], ms: dict[str, float], camera: Camera) -> None:
        """Count the edges that the detectors found in one image."""
        for name, edges in found.items():
            tally = self.tallies[name]
            tally.images += 1
            tally.edges += len(edges)
            tally.rejected += len(edges.rejected_px)
            tally.feet += float(np.nansum(edges.foot_probability))
            tally.length_px += edges.length_px.tolist()
            tally.sigma_rad += edges.bearing_sigma.tolist()
            tally.ms.append(ms[name])
            for other, others in found.items():
                if other != name:
                    match = matches(edges, others, camera)
                    again = match >= 0
                    apart = edges.bearing[again] - others.bearing[match[again]]
                    tally.also[other] = tally.also.get(other, 0) + int(again.sum())
                    tally.apart_rad.setdefault(other, []).extend(apart.tolist())

    def rows(self) -> list[dict[str, Any]]:
        """Return one row a detector: counts, median length and sigma, median time, and shares found by the others."""
        return [self._row(name, tally) for name, tally in self.tallies.items()]

    def _row(self, name: str, tally: Tally) -> dict[str, Any]:
        row: dict[str, Any] = {
            "detector": name,
            "images": tally.images,
            "edges": tally.edges,
            "edges_per_image": tally.edges / max(tally.images, 1),
            "rejected_per_image": tally.rejected / max(tally.images, 1),
            "feet_per_image": tally.feet / max(tally.images, 1),
            "length_median_px": _median(tally.length_px),
            "bearing_sigma_median_deg": np.rad2deg(_median(tally.sigma_rad)),
            "ms_median": _median(tally.ms),
        }
        for other in self.tallies:
            apart = np.rad2deg(np.abs(tally.apart_rad.get(other, [])))
            row[f"share_also_{other}"] = 1.0 if other == name else tally.also.get(other, 0) / max(tally.edges, 1)
            row[f"apart_median_{other}_deg"] = 0.0 if other == name else _median(apart.tolist())
        return row


def matches(edges: Edges, others: Edges, camera: Camera) -> NDArray[np.int64]:
    """Return for edges (E,) the index of the other detector's edge that lies nearest along them, or -1.

    An edge has a match when edges of the other detector lie within `NEAR_PX` of at least half of it, so that two pieces
    match one whole, and one of them is the nearest. Distances are across the line, where the lens bends nothing.
    """
    if len(edges) == 0 or len(others) == 0:
        return np.full(len(edges), -1, dtype=np.int64)
    near = _near(_straight(edges, camera), _straight(others, camera))
    covered = near.any(axis=2).mean(axis=1) >= _COVERED_SHARE
    return np.where(covered, near.mean(axis=1).argmax(axis=1), -1).astype(np.int64)


def _straight(edges: Edges, camera: Camera) -> Array:
    return camera.undistorted().pixels_from_image(camera.image_from_pixels(edges.ends_px))


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
