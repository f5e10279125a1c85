"""Quality of landmarks: the probability that each exists, how high it reaches, how it looks, errors that are shared.

From one side, an edge is seen some millimetres beside where it is seen from another side. So images from nearly one
direction share an error across their line of sight. Seen from directions that are few degrees apart, it is the distance
that suffers: 3 mm more over 10° move it by 2 cm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap, Quality, SightParameters, sight
from localiser.mapping.landmarks import Built, inverse_information, normal_matrix
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point
from localiser.mapping.tracks import MappingParameters

# -- errors that images of one direction share ------------------------------------------------------------------------

_ANOTHER_SIDE_RAD = np.pi / 4  # the error is another one after half of a right angle: most things have four sides


def place_cov(sightings: Sightings, built: Built, cameras: Array, sigma: Array, place_sigma_m: float) -> Array:
    """Return the covariance (L, 2, 2) m² of the landmarks' places by errors that the images of one direction share.

    cameras: (T, 3). sigma: (S,) rad of each bearing. An edge is seen beside its place by an Ornstein-Uhlenbeck process
    of the direction of view, N(0, place_sigma_m²) across the line of sight. With the weights of `triangulate` that is
    I⁻¹ (Σ Σ u_k u_lᵀ exp(-|φ_k - φ_l| / 45°)) I⁻¹, u being the pull of one bearing whose error is place_sigma_m and I
    the information of the bearings at known poses, whatever else the landmark's covariance holds.
    """
    landmark, seen_from = built.of[built.used], cameras[sightings.frame[built.used]]
    at = built.fit.points[landmark]
    heading, range_m = direction_of(at, seen_from)
    jacobian, weight = per_point(at, seen_from), built.fit.weight / sigma[built.used] ** 2
    pull = (weight * place_sigma_m / np.maximum(range_m, 1e-6))[:, None] * jacobian
    shared = _shared(landmark, len(built), heading, pull)
    cov = inverse_information(normal_matrix(landmark, len(built), jacobian, weight))
    return cov @ shared @ cov


def _shared(landmark: Index, count: int, heading: Array, pull: Array) -> Array:
    """Return Σ Σ u_k u_lᵀ exp(-|φ_k - φ_l| / 45°) (L, 2, 2) over the pulls u (K, 2) of each landmark (K,).

    In the order of directions the exponential is a product, so that one running sum has all that came before.
    """
    x, y = (np.bincount(landmark, part, count) for part in (np.cos(heading), np.sin(heading)))
    turned = wrap_angle(heading - np.arctan2(y, x)[landmark]) / _ANOTHER_SIDE_RAD
    order = np.lexsort((turned, landmark))
    result = np.zeros((count, 2, 2))
    for own in np.split(order, np.flatnonzero(np.diff(landmark[order])) + 1):
        if len(own):
            grown = np.exp(turned[own, None]) * pull[own]
            earlier = np.exp(-turned[own, None]) * (np.cumsum(grown, axis=0) - grown)
            pairs = pull[own].T @ earlier
            result[landmark[own[0]]] = pull[own].T @ pull[own] + pairs + pairs.T
    return result


# -- quality ----------------------------------------------------------------------------------------------------------

_END_SHARE = 0.1  # share of sightings that may reach beyond a landmark's stated end
_MOST_EVIDENCE = 30.0  # log-odds beyond which nothing changes in what is printed
_BESIDE_RAD = np.deg2rad(3.0)  # from directions this near to those it was seen from, a landmark is expected to be seen
_BESIDE_SHARE = 0.15  # likewise nearer or farther


def existence(
    sightings: Sightings,
    built: Built,
    heights: tuple[Array, Array],
    cameras: Array,
    sigma: Array,
    camera: Camera,
    parameters: MappingParameters,
) -> Array:
    """Return the probability (L,) that each landmark exists, against its sightings being unrelated clutter.

    log-odds = Σ_seen ln(p N(r; σ²) / λ) + ln(2π √|C| / A) + Σ_missed ln(1 - p): the marginal likelihood of the
    sightings of a landmark that stands anywhere in view (area A), with chance p of being found, over that of clutter
    of density λ per radian [Blackman, Popoli 1999, ch. 6].
    """
    found = parameters.tracks.found
    landmark = built.of[built.used]
    span = span_rad(camera)
    area = span / 2 * parameters.range_max_m**2
    unexplained = max(int((built.of < 0).sum()), sightings.frames)
    clutter_per_rad = unexplained / (sightings.frames * span)
    spread = sigma[built.used]
    gain = np.log(found / (clutter_per_rad * np.sqrt(2 * np.pi) * spread)) - 0.5 * built.fit.chi2
    # A sighting that does not fit is no evidence, for or against.
    evidence = np.bincount(landmark, np.maximum(gain, 0.0) * (built.fit.weight > 0.5), len(built))
    volume = np.log(2 * np.pi * np.sqrt(np.linalg.det(built.cov)) / area)
    missed = images_expected(sightings, built, heights, cameras, camera, parameters) - built.count
    odds = evidence + np.minimum(volume, 0.0) + np.maximum(missed, 0) * np.log(1 - found)
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds, -_MOST_EVIDENCE, _MOST_EVIDENCE))))


def images_expected(
    sightings: Sightings,
    built: Built,
    heights: tuple[Array, Array],
    cameras: Array,
    camera: Camera,
    parameters: MappingParameters,
) -> Index:
    """Return how many frames (L,) should show each landmark: from directions and distances like those that did.

    From elsewhere it may be hidden, which is no evidence against it.
    """
    landmark = built.of[built.used]
    heading, range_m = direction_of(built.fit.points[landmark], cameras[sightings.frame[built.used]])
    seen_from = _views(landmark, heading, range_m)
    plain = LandmarkMap.from_points(built.fit.points, bottom_m=heights[0], top_m=heights[1])
    limits = SightParameters(range_max_m=parameters.range_max_m, length_min_px=30.0, margin_px=-10.0)
    count = np.zeros(len(built), dtype=np.int64)
    at_once = 1 if sightings.mounts else 256
    for start in range(0, sightings.frames, at_once):
        pairs = sight(sightings.camera_at(start, camera), cameras[start : start + at_once], plain, limits)
        heading, range_m = direction_of(built.fit.points[pairs.landmark], cameras[start + pairs.pose])
        known = np.isin(_views(pairs.landmark, heading, range_m), seen_from)
        count += np.bincount(pairs.landmark[known], minlength=len(built))
    return np.maximum(count, built.count)


def _views(landmark: Index, heading: Array, range_m: Array) -> Index:
    """Return one number (K,) for views of one landmark from nearly the same direction and distance."""
    direction = np.floor((heading % (2 * np.pi)) / (2 * _BESIDE_RAD)).astype(np.int64)
    distance = np.floor(np.log(np.maximum(range_m, 0.05)) / (2 * _BESIDE_SHARE)).astype(np.int64)
    return np.asarray((landmark * 1000 + direction) * 1000 + distance + 500)


def height_span(sightings: Sightings, built: Built, cameras: Array, camera: Camera) -> tuple[Array, Array]:
    """Return bottom and top (L,) m above the floor of each landmark; nan where it goes on beyond every image.

    Edges end where something hides them or their contrast fades, so the span is nearly the widest that was seen.
    """
    landmark = built.of[built.used]
    pose = cameras[sightings.frame[built.used]]
    _, range_m = direction_of(built.fit.points[landmark], pose)
    ahead = range_m * np.cos(sightings.bearing[built.used])
    camera_m = np.array([sightings.camera_at(t, camera).mount.height_m for t in range(sightings.frames)])
    height = camera_m[sightings.frame[built.used], None] + ahead[:, None] * sightings.slope_up[built.used]
    cut = sightings.cut[built.used]
    bottom = _outermost(landmark, len(built), -height[:, 0], cut[:, 0])
    top = _outermost(landmark, len(built), height[:, 1], cut[:, 1])
    bottom = np.maximum(-bottom, 0.0)
    return np.where(bottom > top, np.nan, bottom), np.where(bottom > top, np.nan, top)


def _outermost(landmark: Index, count: int, height: Array, cut: NDArray[np.bool_]) -> Array:
    """Return the height (L,) that all but a tenth of the sightings (K,) stay below; nan if only cut ones reach it."""
    result = np.full(count, np.nan)
    order = np.argsort(landmark, kind="stable")
    for index in np.split(order, np.flatnonzero(np.diff(landmark[order])) + 1):
        if len(index) == 0:
            continue
        known = index[np.isfinite(height[index])]
        if len(known) == 0:
            continue
        limit = np.quantile(height[known], 1 - _END_SHARE, method="closest_observation")
        beyond = known[height[known] >= limit]
        result[landmark[index[0]]] = np.nan if cut[beyond].all() else limit
    return result


def is_placed(sightings: Sightings, built: Built, cameras: Array, cov: Array) -> NDArray[np.bool_]:
    """Return which landmarks (L,) are known better than by having been seen: sigma below the farthest range of it.

    cameras: (T, 3). cov: (L, 2, 2) m².
    """
    landmark, farthest = built.of[built.used], np.zeros(len(built))
    _, range_m = direction_of(built.fit.points[landmark], cameras[sightings.frame[built.used]])
    np.maximum.at(farthest, landmark, range_m)
    return np.asarray(np.linalg.eigvalsh(cov)[:, -1] < farthest**2)


def landmark_map_of(
    sightings: Sightings,
    built: Built,
    cameras: Array,
    sigma: Array,
    camera: Camera,
    parameters: MappingParameters,
    name: str,
    source: str,
    *,
    probability: Array | None = None,
) -> LandmarkMap:
    """Return the map of the landmarks that are worth keeping, with all that is known of each; it may be empty.

    Their ids are their numbers in `built`. probability: (L,) that each exists; None: see `existence`.
    """
    heights = height_span(sightings, built, cameras, camera)
    if probability is None:
        probability = existence(sightings, built, heights, cameras, sigma, camera, parameters)
    whole = LandmarkMap.from_points(built.fit.points, name=name, bottom_m=heights[0], top_m=heights[1], source=source)
    quality = Quality(built.count.astype(np.float64), built.parallax, probability)
    cov = built.cov + place_cov(sightings, built, cameras, sigma, parameters.place_sigma_m)
    whole = replace(whole, cov=cov, polarity=built.polarity, quality=quality)
    # Worth keeping is what was seen often enough, from far enough apart, and is likely to be there.
    worth = (built.parallax >= np.deg2rad(parameters.parallax_min_deg)) & (built.count >= parameters.sightings_min)
    worth &= (probability >= parameters.existence_min) & is_placed(sightings, built, cameras, cov)
    return whole.take(np.flatnonzero(worth))


def span_rad(camera: Camera) -> float:
    """Return the angle that the image spans from side to side, by its middle: upright by its width, else its height."""
    across = camera.height if round(camera.mount.roll_rad / (np.pi / 2)) % 2 else camera.width
    return 2.0 * float(np.arctan(across / 2 / camera.focal_px))
