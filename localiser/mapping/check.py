"""Check a finished map, from where too few landmarks are in view, and bring it up to date."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser.camera import Camera
from localiser.errors import InputError
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, Quality, SightParameters, sight
from localiser.mapping.build import MapBuilt
from localiser.mapping.landmarks import Built
from localiser.mapping.merge import common_landmarks, fuse_maps
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point

# -- check ------------------------------------------------------------------------------------------------------------

ENOUGH = 3
"""Landmarks in view that fix a pose: two leave an arc of places."""
_STEP_M, _MOST_STEPS = 0.25, 60  # between places; along the longer side of the building
_AT_ONCE = 4096  # poses whose views are worked out together


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Landmarks in view from places: x (C,), z (R,) m, every `step_m`.

    share: (R, C) of headings from which too few are in view. median: landmarks in view, over places and headings.
    """

    x: Array
    z: Array
    step_m: float
    share: Array
    median: float

    def text(self) -> str:
        """Return how many landmarks are in view, and how much of the building has too few."""
        return (
            f"Landmarks in view: {self.median:.0f} (median over all places and headings), fewer than {ENOUGH} from "
            f"{100 * self.share.mean():.0f} % of them; walls, which hide more, are not counted"
        )


def in_view(landmark_map: LandmarkMap, camera: Camera, places: Array, headings: int = 24) -> Index:
    """Return how many landmarks (N, H) a robot's camera has in view from places (N, 2), at H headings all round.

    Walls hide nothing here, so that fewer may be seen.
    """
    angles = 2 * np.pi * np.arange(headings) / headings
    robots = np.concatenate([np.repeat(places, headings, axis=0), np.tile(angles, len(places))[:, None]], axis=1)
    cameras = camera.pose_in_map(robots)
    count = np.zeros(len(robots), dtype=np.int64)
    for start in range(0, len(robots), _AT_ONCE):
        part = cameras[start : start + _AT_ONCE]
        count[start : start + len(part)] = np.bincount(sight(camera, part, landmark_map).pose, minlength=len(part))
    return count.reshape(len(places), headings)


def coverage(landmark_map: LandmarkMap, camera: Camera) -> Coverage:
    """Return from where, all over the building, fewer than three landmarks are in view."""
    low, high = landmark_map.points.min(axis=0), landmark_map.points.max(axis=0)
    step = max(_STEP_M, float((high - low).max()) / _MOST_STEPS)
    size = np.ceil((high - low) / step + 2).astype(int)
    middle = (low + high) / 2
    x, z = (middle[axis] + step * (np.arange(size[axis]) - (size[axis] - 1) / 2) for axis in (0, 1))
    places = np.stack([part.ravel() for part in np.meshgrid(x, z)], axis=-1)
    count = in_view(landmark_map, camera, places)
    share = (count < ENOUGH).mean(axis=1).reshape(len(z), len(x))
    return Coverage(x, z, step, share, float(np.median(count)))


# -- update -----------------------------------------------------------------------------------------------------------

_BESIDE_RAD = np.deg2rad(2.0)  # what was seen so near to a direction,
_BEHIND_M = 0.2  # and so much farther away, shows that nothing hides what stands before it
_POSE_RAD = np.deg2rad(0.2)  # error of the camera's direction
_GATE_SIGMA = 3.0
_UNKNOWN = 0.95  # existence of a landmark where the map does not state it
_MOST_ODDS = 12.0
_SEEN = ("landmark", "tangent", "range_m")  # columns of what is in view


_GONE = 0.1
"""Probability of existence below which a landmark leaves the map: one miss or two only make it less certain."""


@dataclass(frozen=True, slots=True, eq=False)
class Updated:
    """A map after an update; gone, new: ids of landmarks that went and came. again: how many were seen again."""

    landmark_map: LandmarkMap
    gone: tuple[int | str, ...]
    new: tuple[int | str, ...]
    again: int


def update_map(old: LandmarkMap, built: MapBuilt, camera: Camera, found: float, within_m: float) -> Updated:
    """Return the map with what a build of a log in its frame says: fused, lost, added.

    found: chance that an edge that is there is found in an image. Raises InputError when hardly
    any landmark is found again: then the poses are not in the map's frame.
    """
    new = built.landmark_map
    pairs = common_landmarks(old, new, within_m)
    if len(pairs) < max(3, len(new) // 10):
        raise InputError(
            f"expected landmarks of the map in the log, found {len(pairs)} of the {len(new)} that it shows: "
            "are its poses in the map's frame?",
            field="--poses",
        )
    cameras = built.slam.cameras if built.slam else built.sightings.camera_poses(camera, built.trajectory.poses)
    existence = existence_after(old, built.sightings, built.built, camera, cameras, found)
    existence[pairs[:, 0]] = np.nan  # what the log says of those it shows counts
    quality = old.quality or Quality.unknown(len(old))
    whole = fuse_maps(replace(old, quality=replace(quality, existence=existence)), new, pairs)
    assert whole.quality is not None
    gone = np.flatnonzero(whole.quality.existence[: len(old)] < _GONE)
    kept = np.setdiff1d(np.arange(len(whole)), gone)
    return Updated(whole.take(kept), tuple(old.ids[k] for k in gone), whole.ids[len(old) :], len(pairs))


def existence_after(
    landmark_map: LandmarkMap, sightings: Sightings, built: Built, camera: Camera, cameras: Array, found: float
) -> Array:
    """Return the probability (L,) that landmarks exist, after a log from cameras at (T, 3); nan where unknown before.

    For landmarks that the log's own build does not have. A frame counts only if a landmark farther away was seen next
    to it, because otherwise a wall may hide it, and if no edge was seen right at its place, which may be its own. In
    each, log-odds grow by ln(1 - p); p is the chance `found` that an edge that is there is found.
    """
    limits = SightParameters(length_min_px=30.0, margin_px=-10.0)
    if sightings.mounts:
        each = [sight(sightings.camera_at(t, camera), cameras[[t]], landmark_map, limits) for t in range(len(cameras))]
        pose = np.repeat(np.arange(len(each)), [len(one.pose) for one in each])
        views = replace(
            each[0], pose=pose, **{name: np.concatenate([getattr(v, name) for v in each]) for name in _SEEN}
        )
    else:
        views = sight(camera, cameras, landmark_map, limits)
    # How far from where it should be a landmark's edge may lie in each view.
    jacobian = per_point(landmark_map.points[views.landmark], cameras[views.pose])
    cov = np.nan_to_num(landmark_map.cov)[views.landmark]
    gate = _GATE_SIGMA * np.sqrt(np.einsum("pi,pij,pj->p", jacobian, cov, jacobian) + _POSE_RAD**2)
    first = np.searchsorted(views.pose, np.arange(sightings.frames + 1))
    missed = np.zeros(len(landmark_map))
    for frame in range(sightings.frames):
        row = np.arange(first[frame], first[frame + 1])
        seen = np.arange(sightings.first[frame], sightings.first[frame + 1])
        bearing = np.arctan(views.tangent[row])
        known = seen[built.of[seen] >= 0]
        _, beyond = direction_of(built.fit.points[built.of[known]], np.tile(cameras[frame], (len(known), 1)))
        beside = np.abs(bearing[:, None] - sightings.bearing[known][None]) < _BESIDE_RAD
        row_is_clear = (beside & (beyond[None] > views.range_m[row][:, None] + _BEHIND_M)).any(axis=1)
        at_place = np.abs(bearing[:, None] - sightings.bearing[seen][None]) < gate[row][:, None]
        missed[views.landmark[row]] += row_is_clear & ~at_place.any(axis=1)
    before = (landmark_map.quality or Quality.unknown(len(landmark_map))).existence
    stated = np.clip(np.where(np.isnan(before), _UNKNOWN, before), 1e-5, 1 - 1e-5)
    odds = np.clip(np.log(stated / (1 - stated)) + missed * np.log(1 - found), -_MOST_ODDS, _MOST_ODDS)
    return np.where(missed > 0, 1.0 / (1.0 + np.exp(-odds)), before)
