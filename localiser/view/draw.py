"""Draw the 3-D world in the map frame (y up) and the 2-D image view, as Rerun archetypes."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.filter import Image
from localiser.geometry import Array
from localiser.particles import Clusters, Estimate, Particles
from localiser.view import palette

MOST_PARTICLES = 2000
"""More than this cannot be told apart on a screen, and would make up most of the recording."""

MOST_POINTS = 5000
"""Of a map too large to draw every landmark of it."""

ARROW_M = 0.7
FRUSTUM_M = 0.9
CHI2_95_2D = 5.991
"""Squared Mahalanobis distance that holds 95 % of a Gaussian in the plane."""

# Heights above the floor at which flat things are drawn, so that none hides in another.
_TRAIL_Y, _PARTICLE_Y, _ESTIMATE_Y = 0.01, 0.02, 0.04
_CIRCLE = np.linspace(0.0, 2 * np.pi, 49)


def at_height(points: Array, y_m: float) -> Array:
    """Return map points (..., 3) above floor points (x, z) (..., 2)."""
    return np.insert(np.asarray(points, dtype=np.float64), 1, y_m, axis=-1)


def landmarks(ends: Array, colour: palette.Colour, width: float) -> rr.LineStrips3D:
    """Return landmarks with the given ends (L, 2, 3) as vertical lines, `width` in points on the screen."""
    return rr.LineStrips3D(ends.astype(np.float32), colors=colour, radii=rr.Radius.ui_points(width / 2))


def coarse(points: Array) -> rr.Points3D:
    """Return landmarks (L, 2) as at most `MOST_POINTS` points on the floor: one for each square that has any."""
    square_m, squares = 1.0, points[:0]
    while not len(squares) or len(squares) > MOST_POINTS:
        squares = np.unique(np.floor(points / square_m), axis=0)
        square_m *= 2.0
    middles = (squares + 0.5) * (square_m / 2.0)
    return rr.Points3D(
        at_height(middles, 0.0).astype(np.float32), colors=palette.UNSEEN, radii=rr.Radius.ui_points(1.2)
    )


def sights(camera: Camera, pose: Array, points: Array) -> rr.LineStrips3D:
    """Return lines from the camera of a robot at `pose` (3,) to landmarks (M, 2), at the camera's height."""
    height = camera.mount.height_m
    origin = np.broadcast_to(at_height(camera.pose_in_map(pose)[:2], height), (len(points), 3))
    lines = np.stack([origin, at_height(points, height)], axis=1)
    return rr.LineStrips3D(lines.astype(np.float32), colors=palette.SIGHT, radii=rr.Radius.ui_points(0.6))


def particles(cloud: Particles) -> rr.Points3D:
    """Return the particles as points coloured by weight; every k-th one where there are more than can be shown."""
    shown = slice(None, None, -(-len(cloud) // MOST_PARTICLES))
    points = at_height(cloud.poses[shown, :2], _PARTICLE_Y)
    return rr.Points3D(points, colors=palette.of_weights(cloud.weight[shown]), radii=rr.Radius.ui_points(2.2))


def arrow(pose: Array, colour: palette.Colour, width: float) -> rr.Arrows3D:
    """Return an arrow on the floor from where the robot is to where it looks."""
    return rr.Arrows3D(
        origins=[at_height(pose[:2], _ESTIMATE_Y)],
        vectors=[at_height(ARROW_M * geometry.forward(pose[2]), 0.0)],
        colors=colour,
        radii=rr.Radius.ui_points(width / 2),
    )


def ellipse_points(pose: Array, cov: Array) -> Array:
    """Return the closed line (49, 2) on the floor that holds 95 % of (x, z) of a pose (3,) with covariance (3, 3)."""
    variance, axes = np.linalg.eigh(cov[:2, :2])
    half_axes = axes * np.sqrt(CHI2_95_2D * np.maximum(variance, 0.0))
    return np.asarray(pose[:2] + np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=-1) @ half_axes.T)


def place_ellipses(places: Clusters) -> rr.LineStrips3D:
    """Return the 95 % ellipses of the places where the robot may be, each labelled with its weight."""
    lines = [at_height(ellipse_points(*place), _ESTIMATE_Y) for place in zip(places.mean, places.cov, strict=True)]
    labels = [f"{100 * weight:.0f} %" for weight in places.weight]
    return rr.LineStrips3D(lines, colors=palette.PLACE, radii=rr.Radius.ui_points(1.0), labels=labels)


def place_arrows(places: Clusters) -> rr.Arrows3D:
    """Return an arrow for each place where the robot may be, as long as its weight."""
    lengths = ARROW_M * places.weight[:, None] * np.stack([geometry.forward(heading) for heading in places.mean[:, 2]])
    origins, vectors = at_height(places.mean[:, :2], _ESTIMATE_Y), at_height(lengths, 0.0)
    return rr.Arrows3D(origins=origins, vectors=vectors, colors=palette.PLACE, radii=rr.Radius.ui_points(1.0))


def ellipse(estimate: Estimate) -> rr.LineStrips3D:
    """Return the 95 % ellipse of the estimate's position."""
    line = at_height(ellipse_points(estimate.pose, estimate.pose_cov), _ESTIMATE_Y)
    return rr.LineStrips3D([line], colors=palette.ESTIMATE, radii=rr.Radius.ui_points(1.0))


def trail(points: Array, colour: palette.Colour, width: float = 3.5) -> rr.LineStrips3D:
    """Return a path through floor points (T, 2)."""
    return rr.LineStrips3D([at_height(points, _TRAIL_Y)], colors=colour, radii=rr.Radius.ui_points(width / 2))


def pinhole(camera: Camera) -> rr.Pinhole:
    """Return the camera without its lens distortion: Rerun knows no other."""
    return rr.Pinhole(
        image_from_camera=camera.matrix,
        resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RUB,
        image_plane_distance=FRUSTUM_M,
        color=palette.FRUSTUM,
        line_width=-0.8,  # negative: points on the screen, not metres
    )


def camera_pose(camera: Camera, robot_pose: Array) -> tuple[Array, Array]:
    """Return position (3,) and rotation (3, 3) of the camera's axes (right, up, backward) in the map."""
    x, z, heading = camera.pose_in_map(robot_pose)
    s, c = np.sin(heading), np.cos(heading)
    map_from_level = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.array([x, camera.mount.height_m, z]), np.asarray(map_from_level @ camera.level_from_camera)


def camera_transform(camera: Camera, robot_pose: Array) -> rr.Transform3D:
    """Return where the camera is when the robot is at `robot_pose` (3,): offset, height, yaw, tilt and roll."""
    position, rotation = camera_pose(camera, robot_pose)
    return rr.Transform3D(translation=position, mat3x3=rotation)


JPEG_QUALITY = 80
_MEDIA_TYPES = {b"\xff\xd8": "image/jpeg", b"\x89P": "image/png"}


def picture(image: Image) -> rr.EncodedImage:
    """Return the image as a JPEG; bytes that are a file already are passed through."""
    if isinstance(image, bytes):
        return rr.EncodedImage(contents=image, media_type=_MEDIA_TYPES.get(image[:2]))
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")


def rejected(edges: Edges) -> rr.LineStrips2D:
    """Return the segments that were found and are not vertical edges."""
    return _lines(edges.rejected_px, palette.REJECTED, 0.8)


def vertical_edges(edges: Edges, matched: NDArray[np.bool_]) -> rr.LineStrips2D:
    """Return the vertical edges, coloured by whether they match (E,) a landmark; those without pixels are left out."""
    known = np.isfinite(edges.ends_px).all(axis=(1, 2))
    colours = np.where(matched[known, None], palette.MATCHED, palette.UNMATCHED).astype(np.uint8)
    return _lines(edges.ends_px[known], colours, 2.2)


def predicted(lines: Array) -> rr.LineStrips2D:
    """Return the lines (V, S, 2) at which the estimate expects landmarks."""
    return _lines(lines, palette.VISIBLE, 1.0)


def joins(edges: Edges, landmark: NDArray[np.int64], shown: NDArray[np.int64], lines: Array) -> rr.LineStrips2D:
    """Return a line from the middle of each matched edge to its landmark's prediction in the same pixel row.

    landmark: (E,) index or -1. shown: (V,) indices of the landmarks whose predicted lines (V, S, 2) are given.
    """
    line_of = {int(index): line for index, line in zip(shown, lines, strict=True)}
    pairs = [
        (middle, _point_in_row(line_of[int(index)], middle[1]))
        for middle, index in zip(edges.ends_px.mean(axis=1), landmark, strict=True)
        if int(index) in line_of and np.isfinite(middle).all()
    ]
    return _lines(np.array(pairs).reshape(-1, 2, 2), palette.JOIN, 2.2)


def _point_in_row(line: Array, v: float) -> Array:
    """Return the point (2,) of a line (S, 2), v falling along it, in pixel row v; its nearer end beyond the ends."""
    upside_down = line[::-1]
    return np.array([np.interp(v, upside_down[:, 1], upside_down[:, 0]), np.clip(v, line[-1, 1], line[0, 1])])


def _lines(strips: Array, colours: palette.Colour | NDArray[np.uint8], width: float) -> rr.LineStrips2D:
    return rr.LineStrips2D(strips.astype(np.float32), colors=colours, radii=rr.Radius.ui_points(width / 2))
