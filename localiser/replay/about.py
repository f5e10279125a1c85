"""What a run was made from, so that results can be traced and only comparable runs are compared."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from localiser.documents import dump
from localiser.filter import Sighting, Start
from localiser.storage import fingerprint

if TYPE_CHECKING:
    from localiser.replay.run import Replay

_SHORT = 6
"""As many digits of a fingerprint tell two maps, or two sets of settings, apart."""

_WITH_A_WORD = ("observation.kind", "observation.association", "increments.source", "mcl.particles", "seed", "map")


def identity_of(run: Replay) -> dict[str, str]:
    """Return every setting by its name, and fingerprints of map, camera and log; images are not read for it."""
    log = run.log
    frames = [frame if isinstance(frame, Sighting) else frame.t_ns for frame in log.frames]
    return run.localiser.identity | {"log": fingerprint((log.name, log.odometry, log.groundtruth, frames))}


def about(run: Replay) -> dict[str, Any]:
    """Return what makes runs comparable, in few words: see `localiser.evaluate.metrics.ABOUT`.

    The map's name is followed by the beginning of its fingerprint; `inputs` is that of all that has no word of its
    own: the log's times and poses, the camera, every other setting.
    """
    config = run.localiser.config
    others = sorted(item for item in run.identity.items() if item[0] not in _WITH_A_WORD)
    return {
        "observation": config.observation.kind,
        "association": config.observation.association,
        "odometry": config.increments.source,
        "start": "anywhere" if run.start is None else "stated",
        "map": f"{run.localiser.landmark_map.name} {run.identity['map'][:_SHORT]}".strip(),
        "inputs": fingerprint(others)[:_SHORT],
        "particles": config.mcl.particles,
        "seed": config.seed,
    }


def described(run: Replay) -> str:
    """Return as YAML what a run was made from; see `config.yaml` for its settings."""
    log, landmark_map, identity = run.log, run.localiser.landmark_map, run.identity
    data: dict[str, Any] = {
        "log": {"name": log.name, "path": str(log.path), "fingerprint": identity["log"]},
        "map": {
            "name": landmark_map.name,
            "path": str(run.map_file or log.path),
            "landmarks": len(landmark_map),
            "fingerprint": identity["map"],
        },
        "camera": {"name": log.camera.name, "fingerprint": identity["camera"]},
        "odometry": run.localiser.config.increments.source,
        "start": "anywhere" if run.start is None else _described_start(run.start),
    }
    return dump(data)


def _described_start(start: Start) -> dict[str, Any]:
    to_degrees = np.array([1.0, 1.0, np.rad2deg(1.0)])
    values = np.concatenate([start.mean * to_degrees, np.sqrt(np.diag(start.cov)) * to_degrees])
    names = ("x", "z", "heading_deg", "sigma_x_m", "sigma_z_m", "sigma_heading_deg")
    return {"t_ns": int(start.t_ns), **dict(zip(names, values.tolist(), strict=True))}
