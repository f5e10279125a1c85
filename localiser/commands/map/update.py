"""Bring a map up to date with a log: what is gone, what is new, what is known better."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from localiser import mapping
from localiser.camera import Camera
from localiser.commands.map.build import MapBuilt
from localiser.config import Config
from localiser.errors import InputError
from localiser.landmarks import LandmarkMap
from localiser.storage import write_bytes

_GONE = 0.1
"""Probability of existence below which a landmark leaves the map: one miss or two only make it less certain."""


@dataclass(frozen=True, slots=True, eq=False)
class Updated:
    """A map after an update; gone, new: ids of landmarks that went and came. again: how many were seen again."""

    landmark_map: LandmarkMap
    gone: tuple[int | str, ...]
    new: tuple[int | str, ...]
    again: int


def keep_old(path: Path) -> Path:
    """Copy a map file beside itself, under the first free name MAP.1.yaml, MAP.2.yaml, …; return that name."""
    number = 1
    while (kept := path.with_name(f"{path.stem}.{number}{path.suffix}")).exists():
        number += 1
    write_bytes(kept, path.read_bytes())
    return kept


def updated(old: LandmarkMap, built: MapBuilt, camera: Camera, config: Config, within_m: float) -> Updated:
    """Return the map with what a build of a log in its frame says: fused, lost, added.

    Raises InputError when hardly any landmark is found again: then the poses are not in the map's frame.
    """
    new = built.landmark_map
    pairs = mapping.matches(old.points, new.points, within_m)
    pairs = pairs[mapping.agreeing(old, new, pairs, within_m)]
    if len(pairs) < max(3, len(new) // 10):
        raise InputError(
            f"expected landmarks of the map in the log, found {len(pairs)} of the {len(new)} that it shows: "
            "are its poses in the map's frame?",
            field="--poses",
        )
    cameras = (built.slam.camera if built.slam else camera).pose_in_map(built.trajectory.poses)
    existence = mapping.existence_after(old, built.sightings, built.built, camera, cameras, config.mapping.tracks.found)
    existence[pairs[:, 0]] = np.nan  # what the log says of those it shows counts
    whole = mapping.fused(mapping.with_existence(old, existence), new, pairs)
    assert whole.quality is not None
    gone = np.flatnonzero(whole.quality.existence[: len(old)] < _GONE)
    kept = np.setdiff1d(np.arange(len(whole)), gone)
    return Updated(whole.take(kept), tuple(old.ids[k] for k in gone), whole.ids[len(old) :], len(pairs))
