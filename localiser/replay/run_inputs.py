"""What a run is made from: enough to say later what a result came from, and to tell whether a run may be resumed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from localiser.config import Config
from localiser.documents import dump
from localiser.errors import InputError
from localiser.filter import Sighting, Start
from localiser.landmarks import LandmarkMap
from localiser.storage import Log, fingerprint, identity_of, load_map

_SHORT = 6
"""As many digits of a fingerprint tell two maps, or two sets of settings, apart."""


@dataclass(frozen=True, slots=True, eq=False)
class RunInputs:
    """Log, map, configuration and start of a run.

    map_file: where the map was read, None where it is the log's own. start: None where nothing is said of it.
    """

    log: Log
    landmark_map: LandmarkMap
    map_file: Path | None
    config: Config
    start: Start | None

    @property
    def identity(self) -> dict[str, str]:
        """What must be the same for a run to go on from its checkpoint; images may not have been read yet."""
        log = self.log
        frames = [frame if isinstance(frame, Sighting) else frame.t_ns for frame in log.frames]
        return identity_of(
            self.config.model_dump(exclude={"versions"}),
            log=(log.name, log.odometry, log.groundtruth, frames),
            # What nobody reads but people may hold anything.
            map=replace(self.landmark_map, frame={}, extra=(), header={}),
            camera=log.camera,
            start=self.start,
        )

    @property
    def about(self) -> dict[str, Any]:
        """What makes runs comparable, in few words: see `localiser.evaluate.metrics.ABOUT`.

        The map's name is followed by the beginning of its fingerprint; `inputs` is that of all that has no word of its
        own: the log's times and poses, the camera, every other setting.
        """
        config, others = self.config, self.identity
        for setting in ("observation.kind", "observation.association", "increments.source", "mcl.particles", "seed"):
            del others[setting]
        del others["start"]  # a start that is drawn near the truth is another one for each seed
        return {
            "observation": config.observation.kind,
            "association": config.observation.association,
            "odometry": config.increments.source,
            "start": "anywhere" if self.start is None else "stated",
            "map": f"{self.landmark_map.name} {others.pop('map')[:_SHORT]}".strip(),
            "inputs": fingerprint(sorted(others.items()))[:_SHORT],
            "particles": config.mcl.particles,
            "seed": config.seed,
        }

    def described(self) -> str:
        """Return as YAML what the run was made from; see `config.yaml` for its settings."""
        identity = self.identity
        data: dict[str, Any] = {
            "log": {"name": self.log.name, "path": str(self.log.path), "fingerprint": identity["log"]},
            "map": {
                "name": self.landmark_map.name,
                "path": str(self.map_file or self.log.path),
                "landmarks": len(self.landmark_map),
                "fingerprint": identity["map"],
            },
            "camera": {"name": self.log.camera.name, "fingerprint": identity["camera"]},
            "odometry": self.config.increments.source,
            "start": "anywhere" if self.start is None else _described_start(self.start),
        }
        return dump(data)


def _described_start(start: Start) -> dict[str, Any]:
    sigma = np.sqrt(np.diag(start.cov))
    return {
        "t_ns": int(start.t_ns),
        "x": float(start.mean[0]),
        "z": float(start.mean[1]),
        "heading_deg": float(np.rad2deg(start.mean[2])),
        "sigma_x_m": float(sigma[0]),
        "sigma_z_m": float(sigma[1]),
        "sigma_heading_deg": float(np.rad2deg(sigma[2])),
    }


def map_of(log: Log, map_file: Path | None) -> LandmarkMap:
    """Return the map in a file, else the log's own. Raises InputError."""
    landmark_map = load_map(map_file) if map_file else log.landmark_map
    if landmark_map is None:
        raise InputError("the log has no map; expected --map MAP", path=log.path, field="map")
    return landmark_map
