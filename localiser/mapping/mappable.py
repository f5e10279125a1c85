"""Whether a log can be mapped. Errors say what is missing and how to get it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.mapping.coarse_bearings import COARSE_RAD
from localiser.mapping.factors import Wheels
from localiser.mapping.landmarks import Built
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.recorded import TRUTH, RecordedLog
from localiser.mapping.sightings import Sightings

_LEAST_EXPLAINED = 0.1
"""Share of a log's edges below which its landmarks may be chance: poses that are free bend to fit some clutter."""
_MOST_DRIFT_RAD = np.deg2rad(8.0)
"""Heading error of the wheels in a full turn that coarse bearings still tell from the next landmark; see the docs."""
_STANDING_M = 0.05


def require_motion(log: RecordedLog, trajectory: Trajectory) -> None:
    """Raise InputError when the robot stands still."""
    moved = trajectory.poses[:, :2] - trajectory.poses[0, :2]
    farthest = float(np.hypot(moved[:, 0], moved[:, 1]).max())
    if farthest < _STANDING_M:
        raise InputError(
            f"expected a robot that drives, found one that stays within {farthest:.3f} m: without motion an edge is "
            "seen from one side only, and its distance cannot be told",
            path=log.path,
        )


def require_association(path: Path, sightings: Sightings, wheels: Wheels) -> None:
    """Raise InputError when bearings are too coarse, and wheels too bad, to tell which landmark was seen.

    A robot meets its landmarks again when it has turned round. Coarse bearings (median over `COARSE_RAD`) are
    not followed from image to image reliably, so that wheels must say by then which landmark is which.
    """
    sigma = float(np.median(sightings.sigma))
    drift = turn_drift(wheels)
    if sigma > COARSE_RAD and drift > _MOST_DRIFT_RAD:
        raise InputError(
            f"expected bearings good to {np.rad2deg(COARSE_RAD):g}°, or wheels whose heading is good to "
            f"{np.rad2deg(_MOST_DRIFT_RAD):g}° after a full turn; found {np.rad2deg(sigma):.1f}° and "
            f"{np.rad2deg(drift):.0f}° (motion.alpha1, motion.alpha2): nothing tells which landmark was seen, and the "
            f"map would be wrong; --poses {TRUTH} or the trajectory of another program makes one",
            path=path,
            field="--poses",
        )


def turn_drift(wheels: Wheels) -> float:
    """Return how far (rad, one sigma) the wheels' heading is off after a full turn, or at the end if that is sooner."""
    turned = float(np.abs(wheels.motion[:, 2]).sum())
    return float(np.sqrt(wheels.cov[:, 2, 2].sum() * min(1.0, 2 * np.pi / max(turned, 1e-9))))


def require_landmarks(
    log: RecordedLog,
    landmark_map: LandmarkMap,
    sightings: Sightings,
    built: Built,
    parameters: MappingParameters,
) -> None:
    """Raise InputError unless there are landmarks, and they explain more of the edges than chance might."""
    if not len(landmark_map):
        raise _nothing_built(log, built, parameters)
    assert landmark_map.quality is not None
    explained = float(landmark_map.quality.sightings.sum()) / len(sightings)
    if explained >= _LEAST_EXPLAINED:
        return
    narrow = (built.count >= parameters.sightings_min) & (np.rad2deg(built.parallax) < parameters.parallax_min_deg)
    one_sided = float(built.count[narrow].sum()) / len(sightings)
    if one_sided > 0.5:
        raise _too_little_parallax(log, parameters, f"that {100 * one_sided:.0f} % of the edges are not")
    raise InputError(
        f"expected edges that belong to landmarks, found {len(landmark_map)} that explain {100 * explained:.0f} % "
        "of the edges: what the images show is clutter, or the poses do not fit them",
        path=log.path,
    )


def _nothing_built(log: RecordedLog, built: Built, parameters: MappingParameters) -> InputError:
    """Return the error that says why no landmark came out."""
    followed = built.count >= parameters.sightings_min
    if not followed.any():
        most = int(built.count.max(initial=0))
        return InputError(
            f"expected edges that stay from image to image, found none in {parameters.sightings_min} of them "
            f"(at most {most}): what the images show is clutter, or too few of them overlap",
            path=log.path,
        )
    widest = float(np.rad2deg(built.parallax[followed].max()))
    if widest < parameters.parallax_min_deg:
        return _too_little_parallax(log, parameters, f"at most {widest:.1f}°")
    return InputError(
        "expected edges that are found again where they should be, found none likely enough to exist: what the images "
        "show is clutter, or the poses do not fit them",
        path=log.path,
    )


def _too_little_parallax(log: RecordedLog, parameters: MappingParameters, found: str) -> InputError:
    return InputError(
        f"expected edges seen from directions {parameters.parallax_min_deg:g}° apart, found {found}: "
        "too little parallax to tell distances; drive past things, not only towards them",
        path=log.path,
    )
