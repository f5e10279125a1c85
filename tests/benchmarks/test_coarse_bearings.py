"""Landmarks from coarse bearings: neighbours closer than one bearing can tell, clutter, a real robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coarse_bearings import coarse_bearings, matched
from mrclam import MrclamReader

from localiser import mapping, storage
from localiser.config import read_config
from localiser.edges import BearingSensor, Edges, complete
from localiser.errors import InputError
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import MappingParameters, Sightings, build_map, direction_of
from localiser.storage import open_log

SENSOR = BearingSensor()
CAMERA = SENSOR.camera()
SIGMA = np.deg2rad(SENSOR.bearing_sigma_deg)
HALF_VIEW = np.deg2rad(SENSOR.half_view_deg)
PARAMETERS = MappingParameters()
PLACES = np.array([[3.0, 0.0], [3.0, 0.18], [0.0, 3.0], [-2.5, -1.0], [-2.4, -0.85], [1.0, -3.0], [-1.0, 2.5]])


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let logs of the data set be opened, and maps of them be built, in these tests alone."""
    monkeypatch.setattr("localiser.storage.open.FORMATS", [*storage.FORMATS, MrclamReader()])
    monkeypatch.setattr("localiser.mapping.build.BUILDERS", [coarse_bearings, *mapping.BUILDERS])


def wandering(rng: np.random.Generator, frames: int) -> Array:
    """Return camera poses (T, 3) all over the floor, facing anywhere."""
    return np.column_stack([rng.uniform(-2, 2, (frames, 2)), rng.uniform(-np.pi, np.pi, frames)])


def seen_from(cameras: Array, places: Array, rng: np.random.Generator, clutter: float, error_rad: float) -> Sightings:
    """Return what cameras (T, 3) see of places (L, 2): two of three in view, and false bearings between them."""
    frames = []
    for camera in cameras:
        heading, _ = direction_of(places, np.tile(camera, (len(places), 1)))
        bearing = wrap_angle(camera[2] - heading)
        shown = np.flatnonzero((np.abs(bearing) < HALF_VIEW) & (rng.random(len(places)) < 0.67))
        false = rng.uniform(-HALF_VIEW, HALF_VIEW, rng.poisson(clutter))
        bearings = np.concatenate([bearing[shown] + rng.normal(0, error_rad, len(shown)), false])
        unknown = np.full(len(bearings), np.nan)
        columns = complete(bearings, np.full(len(bearings), SIGMA), unknown, unknown, CAMERA.mount.tilt_rad)
        owner = np.concatenate([shown, np.full(len(false), -1)]).astype(np.int64)
        frames.append(Edges.from_columns(*columns, landmark_id=owner))
    return Sightings.from_edges(frames, CAMERA)


def map_of(sightings: Sightings, cameras: Array) -> LandmarkMap:
    sigma = sightings.sigma
    built, _ = coarse_bearings([cameras], sightings, sigma, PARAMETERS)
    return mapping.landmark_map_of(sightings, built, cameras, sigma, CAMERA, PARAMETERS, "test", "test")


@pytest.mark.parametrize("seed", [0, 1])
def test_neighbours_nearer_than_a_bearing_tells_are_found_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cameras = wandering(rng, 300)
    made = map_of(seen_from(cameras, PLACES, rng, 0.3, np.deg2rad(0.8)), cameras)
    assert matched(PLACES, made.points).max() < 0.08
    assert len(made) <= len(PLACES) + 2


def test_clutter_alone_makes_hardly_any_landmark() -> None:
    rng = np.random.default_rng(4)
    cameras = wandering(rng, 300)
    made = map_of(seen_from(cameras, np.zeros((0, 2)), rng, 2.0, SIGMA), cameras)  # of six hundred bearings
    assert len(made) <= 3


@pytest.mark.data
@pytest.mark.parametrize("robot", [1, 2, 3])
@pytest.mark.slow  # quick: the simulated drives of this file
def test_a_real_robot_finds_the_landmarks_by_bearings_alone(data_dir: Path, robot: int) -> None:
    log = open_log(data_dir / f"mrclam:{robot}")
    made = build_map(log, "truth", read_config(None, [], log.settings))
    error = matched(log.landmark_map.points, made.landmark_map.points)
    assert (error < 0.25).sum() >= 12
    assert np.median(error) <= 0.08


@pytest.mark.data
def test_coarse_bearings_alone_make_no_map(data_dir: Path) -> None:
    log = open_log(data_dir / "mrclam:1")
    with pytest.raises(InputError, match=r"expected bearings good to 0\.5°"):
        build_map(log, "slam", read_config(None, [], log.settings))
