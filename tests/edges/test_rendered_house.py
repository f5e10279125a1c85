"""Edges of a rendered house with exact truth: no worse than what a general line detector finds there."""

from __future__ import annotations

import csv
from collections import defaultdict

import cv2
import numpy as np
import pytest

from localiser.camera import Camera, Mount
from localiser.edges import EdgeParameters, find_edges

pytestmark = pytest.mark.data
CAMERA = Camera(640, 480, 502.3, 502.3, 319.5, 239.5, Mount(np.deg2rad(18.0), 0.8))
IMAGES = range(0, 418, 30)


@pytest.fixture(scope="module")
def visible(data_dir) -> dict[int, np.ndarray]:
    """Return per image the landmarks (T, 5) in view: bottom u, v, top u, v, visible share."""
    rows = defaultdict(list)
    with (data_dir / "house" / "visible.csv").open() as file:
        for row in csv.DictReader(file):
            keys = ("u_bottom", "v_bottom", "u_top", "v_top", "visible_fraction")
            rows[int(row["image"])].append([float(row[key]) for key in keys])
    return {index: np.array(rows[index]).reshape(-1, 5) for index in IMAGES}


def step_across(image: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the size (T,) of the median grey difference across ±2.5 px of edges (T, 2, 2)."""
    along = np.linspace(0.02, 0.98, 60)[None, :, None]
    u, v = np.moveaxis((ends[:, :1] * (1 - along) + ends[:, 1:] * along).astype(np.float32), -1, 0)
    left, right = (
        cv2.remap(image.astype(np.float32), u + np.float32(by), v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for by in (-2.5, 2.5)
    )
    return np.abs(np.median(right - left, axis=1))


def recall(detector, data_dir, visible) -> float:
    """Return the share of landmarks with at least 60 px in view, and a step, that an edge passes within 2.5 px."""
    found = total = 0
    for index in IMAGES:
        image = cv2.imread(str(data_dir / "house" / "images" / f"{index:06d}.jpg"), cv2.IMREAD_GRAYSCALE)
        edges = find_edges(image, CAMERA, EdgeParameters(detector=detector))
        ends = visible[index][:, :4].reshape(-1, 2, 2)
        counted = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * visible[index][:, 4] >= 60
        counted &= step_across(image, ends) >= 8
        apart = np.abs(edges.bearing - CAMERA.bearing_of_segments(ends[counted])[:, None]) * CAMERA.focal_px
        found += int((apart.min(axis=1, initial=np.inf) < 2.5).sum())
        total += int(counted.sum())
    return found / total


def test_fewer_landmarks_are_missed_than_by_lsd(data_dir, visible):
    own, general = recall("columns", data_dir, visible), recall("lsd", data_dir, visible)
    assert 1 - own < (1 - general) / 1.3
