"""Draw one moment of a run as SVG: its image with measured and expected edges, and the map with the belief."""

from __future__ import annotations

from base64 import b64encode

import cv2
import numpy as np

from localiser.camera import Camera
from localiser.filter import Image, LocatedFrame
from localiser.geometry import Array, forward
from localiser.image_files import decode
from localiser.landmarks import LandmarkMap, landmark_ends, predicted_lines

JPEG_QUALITY = 80
PARTICLES = 400  # as many as show where the cloud is
AROUND_M = 4.0
LIKELY = 0.02  # the weight from which on a place is drawn


def image_svg(frame: LocatedFrame, camera: Camera, landmark_map: LandmarkMap) -> str:
    """Return the image; green: edges that match a landmark, red: edges without one, blue: where landmarks are expected.

    Without an image there are the lines alone.
    """
    edges, matches = frame.located.edges, frame.matches
    parts = [f'<rect width="{camera.width}" height="{camera.height}" class="empty"/>']
    if frame.image is not None:
        parts.append(f'<image width="{camera.width}" height="{camera.height}" href="{image_uri(frame.image)}"/>')
    ends = landmark_ends(landmark_map, camera)
    _, lines = predicted_lines(
        camera.at(frame.located.edges.mount), frame.located.estimate.pose_as_seen, ends, matches.visible
    )
    parts += [_line(line, "expected") for line in lines]
    known = np.isfinite(edges.ends_px).all(axis=(1, 2))
    for ends_px, landmark in zip(edges.ends_px[known], matches.landmark[known], strict=True):
        parts.append(_line(ends_px, "matched" if landmark >= 0 else "unmatched"))
    return f'<svg viewBox="0 0 {camera.width} {camera.height}" role="img">{"".join(parts)}</svg>'


def image_uri(image: Image) -> str:
    """Return a JPEG as an address that holds its content; other images are encoded as one."""
    content = image if isinstance(image, bytes) else b""
    if content[:2] != b"\xff\xd8":
        pixels = decode(content, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if content else image
        content = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()  # type: ignore[arg-type]
    return f"data:image/jpeg;base64,{b64encode(content).decode()}"


def map_svg(frame: LocatedFrame, landmark_map: LandmarkMap, path: Array, aspect: float = 4 / 3) -> str:
    """Return the map around the robot as seen from above, x to the right and map -z up, with all that is believed.

    path: (T, 3) estimates up to this image. aspect: width over height.
    """
    located, matches, points = frame.located, frame.matches, landmark_map.points
    low, high = _frame_of(frame, points, aspect)
    size = high - low
    dot = float(size[0]) / 160

    def dots(at: Array, kind: str, radius: float) -> list[str]:
        inside = at[((at >= low) & (at <= high)).all(axis=1)]
        return [f'<circle cx="{x:.3f}" cy="{z:.3f}" r="{radius:.3f}" class="{kind}"/>' for x, z in inside]

    matched = np.unique(matches.landmark[matches.landmark >= 0])
    expected = np.setdiff1d(np.flatnonzero(matches.visible), matched)
    unseen = np.setdiff1d(np.arange(len(points)), np.concatenate([matched, expected]))
    pose = located.estimate.pose
    parts = [f'<rect x="{low[0]:.3f}" y="{low[1]:.3f}" width="{size[0]:.3f}" height="{size[1]:.3f}" class="floor"/>']
    parts += [_line(np.stack([pose[:2], points[landmark]]), "sight") for landmark in matched]
    parts += dots(points[unseen], "unseen", dot) + dots(points[expected], "expected-point", dot)
    parts += dots(points[matched], "matched-point", 1.2 * dot)
    parts.append(_line(path[:, :2], "path"))
    places = located.clusters
    if places is not None:
        parts += [_ellipse(m, c) for w, m, c in zip(places.weight, places.mean, places.cov, strict=True) if w >= LIKELY]
    parts.append(_ellipse(pose, located.estimate.pose_cov))
    if frame.truth is not None:
        parts.append(_arrow(frame.truth, 5 * dot, "truth"))
    parts.append(_arrow(pose, 5 * dot, "estimate"))
    every = max(1, len(located.particles) // PARTICLES)
    parts += dots(located.particles.poses[::every, :2], "particle", 0.5 * dot)
    box = f"{low[0]:.3f} {low[1]:.3f} {size[0]:.3f} {size[1]:.3f}"
    return f'<svg viewBox="{box}" role="img">{"".join(parts)}{_scale_bar(low, high)}</svg>'


def _frame_of(frame: LocatedFrame, points: Array, aspect: float) -> tuple[Array, Array]:
    """Return the corners (2,) and (2,) of what is drawn.

    That is estimate, truth and likely places, some metres around them, and the landmarks in view that are not far.
    """
    located = frame.located
    poses = [located.estimate.pose[:2]] + ([] if frame.truth is None else [frame.truth[:2]])
    if located.clusters is not None:
        poses += list(located.clusters.mean[located.clusters.weight >= LIKELY, :2])
    low, high = np.min(poses, axis=0) - AROUND_M, np.max(poses, axis=0) + AROUND_M
    seen = points[frame.matches.visible]
    seen = seen[((seen > low - AROUND_M) & (seen < high + AROUND_M)).all(axis=1)]
    low, high = np.min([low, *(seen - 0.3)], axis=0), np.max([high, *(seen + 0.3)], axis=0)
    size = np.maximum(high - low, (high - low)[::-1] * [aspect, 1 / aspect])
    return (low + high - size) / 2, (low + high + size) / 2


def _line(points: Array, kind: str) -> str:
    known = points[np.isfinite(points).all(axis=1)]
    text = " ".join(f"{x:.3f},{y:.3f}" for x, y in known)
    return f'<polyline points="{text}" class="{kind}"/>'


def _arrow(pose: Array, length: float, kind: str) -> str:
    """Return a triangle that points where the robot faces."""
    ahead = forward(pose[2]) * length
    aside = np.array([-ahead[1], ahead[0]]) * 0.4
    corners = [pose[:2] + ahead, pose[:2] - 0.4 * ahead + aside, pose[:2] - 0.4 * ahead - aside]
    return f'<polygon points="{" ".join(f"{x:.3f},{z:.3f}" for x, z in corners)}" class="{kind}"/>'


def _ellipse(mean: Array, cov: Array) -> str:
    """Return the 3σ ellipse of a position."""
    variance, axes = np.linalg.eigh(cov[:2, :2])
    minor, major = 3 * np.sqrt(np.maximum(variance, 0))
    angle_deg = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
    place = f"translate({mean[0]:.3f} {mean[1]:.3f}) rotate({angle_deg:.1f})"
    return f'<ellipse rx="{major:.4f}" ry="{minor:.4f}" transform="{place}" class="spread"/>'


def _scale_bar(low: Array, high: Array) -> str:
    span = high - low
    left, level = low[0] + 0.04 * span[0], high[1] - 0.05 * span[1]
    bar = _line(np.array([[left, level], [left + 1, level]]), "scale")
    return f'{bar}<text x="{left:.3f}" y="{level - 0.015 * span[1]:.3f}" font-size="{0.04 * span[1]:.3f}">1 m</text>'
