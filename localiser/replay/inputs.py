"""What a run is made from: enough to say later what a result came from, and which runs may be compared."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from localiser.documents import dump
from localiser.errors import InputError
from localiser.filter import Sighting, Start
from localiser.landmarks import LandmarkMap
from localiser.localiser import Localiser
from localiser.storage import Log, fingerprint, read_map

_SHORT = 6
"""As many digits of a fingerprint tell two maps, or two sets of settings, apart."""

_WITH_A_WORD = ("observation.kind", "observation.association", "increments.source", "mcl.particles", "seed", "map")


@dataclass(frozen=True, slots=True, eq=False)
class RunInputs:
    """Log, map, settings and start of a run.

    localiser: as it was made for the run; it has map and settings. map_file: where the map was read, None where it is
    the log's own. start: None where nothing is said of it.
    """

    log: Log
    localiser: Localiser
    map_file: Path | None
    start: Start | None
    identity: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        log = self.log
        times = [frame if isinstance(frame, Sighting) else frame.t_ns for frame in log.frames]  # images are on the disk
        measured = fingerprint((log.name, log.odometry, log.groundtruth, times))
        object.__setattr__(self, "identity", self.localiser.identity | {"log": measured})

    @property
    def start_kind(self) -> str:
        """Whether a start is stated."""
        return "anywhere" if self.start is None else "stated"

    @property
    def about(self) -> dict[str, Any]:
        """What makes runs comparable, in few words: see `localiser.evaluate.metrics.ABOUT`.

        The map's name is followed by the beginning of its fingerprint; `inputs` is that of all that has no word of its
        own: the log's times and poses, the camera, every other setting.
        """
        config, name = self.localiser.config, self.localiser.landmark_map.name
        others = sorted(item for item in self.identity.items() if item[0] not in _WITH_A_WORD)
        return {
            "observation": config.observation.kind,
            "association": config.observation.association,
            "odometry": config.increments.source,
            "start": self.start_kind,
            "map": f"{name} {self.identity['map'][:_SHORT]}".strip(),
            "inputs": fingerprint(others)[:_SHORT],
            "particles": config.mcl.particles,
            "seed": config.seed,
        }

    def described(self) -> str:
        """Return as YAML what the run was made from; see `config.yaml` for its settings."""
        log, landmark_map, identity = self.log, self.localiser.landmark_map, self.identity
        data: dict[str, Any] = {
            "log": {"name": log.name, "path": str(log.path), "fingerprint": identity["log"]},
            "map": {
                "name": landmark_map.name,
                "path": str(self.map_file or log.path),
                "landmarks": len(landmark_map),
                "fingerprint": identity["map"],
            },
            "camera": {"name": log.camera.name, "fingerprint": identity["camera"]},
            "odometry": self.localiser.config.increments.source,
            "start": "anywhere" if self.start is None else _described_start(self.start),
        }
        return dump(data)


def _described_start(start: Start) -> dict[str, Any]:
    to_degrees = np.array([1.0, 1.0, np.rad2deg(1.0)])
    values = np.concatenate([start.mean * to_degrees, np.sqrt(np.diag(start.cov)) * to_degrees])
    names = ("x", "z", "heading_deg", "sigma_x_m", "sigma_z_m", "sigma_heading_deg")
    return {"t_ns": int(start.t_ns), **dict(zip(names, values.tolist(), strict=True))}


def map_of(log: Log, map_file: Path | None) -> LandmarkMap:
    """Return the map in a file, else the log's own. Raises InputError."""
    landmark_map = read_map(map_file) if map_file else log.landmark_map
    if landmark_map is None:
        raise InputError("the log has no map; expected --map MAP", path=log.path, field="map")
    return landmark_map
