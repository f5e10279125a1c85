"""Quality of landmarks: it survives being saved; those that are too uncertain have no place on a map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import wrap_angle
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping.landmarks import fit_landmarks
from localiser.mapping.quality import is_placed
from localiser.mapping.sightings import Sightings, direction_of
from localiser.storage import read_map, write_map


def test_taking_landmarks_takes_their_quality_along() -> None:
    quality = replace(Quality.unknown(3), existence=np.array([0.1, 0.2, 0.3]))
    whole = replace(LandmarkMap.from_points(np.arange(6.0).reshape(3, 2), ids=("a", "b", "c")), quality=quality)
    part = whole.take(np.array([2, 0]))
    assert part.ids == ("c", "a")
    assert part.points.tolist() == [[4.0, 5.0], [0.0, 1.0]]
    assert part.quality is not None
    assert part.quality.existence.tolist() == [0.3, 0.1]


def test_a_landmark_whose_sigma_is_larger_than_any_distance_to_it_has_no_place() -> None:
    cameras = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]])
    points = np.array([[0.0, -2.0], [0.3, -4.0]])
    frames = []
    for camera in cameras:
        heading, _ = direction_of(points, np.tile(camera, (2, 1)))
        frames.append(Edges.from_bearings(wrap_angle(camera[2] - heading), 0.001))
    sightings = Sightings.from_edges(frames, Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(0.35, 0.9)))
    made = fit_landmarks(sightings, np.array([0, 1, 0, 1]), cameras, np.full(4, 0.001))
    assert is_placed(sightings, made, cameras, made.fit.cov).all()
    for sigma_m, expected in ((1.0, [True, True]), (3.0, [False, True]), (5.0, [False, False])):
        cov = np.tile(np.diag([1e-6, sigma_m**2]), (2, 1, 1))
        np.testing.assert_array_equal(is_placed(sightings, made, cameras, cov), expected)


def test_quality_of_landmarks_comes_back(tmp_path: Path) -> None:
    plain = LandmarkMap.from_points(np.array([[0.0, 1.0], [2.0, 3.0]]), name="built")
    quality = Quality(
        np.array([12.0, np.nan]),
        np.deg2rad([23.5, 7.25]),
        np.array([0.97, np.nan]),
        np.array([[10.0, 200.5, 90.0], [np.nan] * 3]),
    )
    write_map(replace(plain, quality=quality), tmp_path / "map.yaml")
    found = read_map(tmp_path / "map.yaml").quality
    assert found is not None
    for name in ("sightings", "parallax_rad", "existence", "profile"):
        np.testing.assert_allclose(getattr(found, name), getattr(quality, name), atol=1e-6)
    write_map(plain, tmp_path / "plain.yaml")
    assert read_map(tmp_path / "plain.yaml").quality is None
