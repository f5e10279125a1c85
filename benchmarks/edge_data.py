"""Images with known vertical edges that are not simulated here: worlds that ship, a rendered house, photographs."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml
from edge_scenes import COUNTED_LENGTH_PX, NEIGHBOUR_PX, Scene

from localiser.camera import Camera, Mount
from localiser.geometry import Array, robot_from_map
from localiser.simulate import simulated_log, world_of

COUNTED_STEP = 8.0


def rendered(world_file: Path, every: int = 1) -> Iterator[Scene]:
    """Yield scenes of a drive through a world that ships with the project.

    A landmark may stand for several edges up to 2 cm apart; bearings are judged where it stands for one.
    """
    log = simulated_log(world_of(yaml.safe_load(world_file.read_text())), seed=0)
    structure = log.scene.structure
    edges_of_landmark = np.bincount(structure.landmark[structure.landmark >= 0])
    poses = log.drive.truth.sampled(log.drive.image_t_ns).poses
    for index in range(0, len(log), every):
        visible = log.visible[index]
        tangent = _tangent(structure.edges.points, log.camera, poses[index])
        single = edges_of_landmark[visible.landmark] == 1
        ends, alone = visible.ends_px, _is_alone(visible.ends_px, log.camera, tangent) & single
        image = log.image(index)
        yield Scene(image, log.camera, ends, visible.fraction, _is_counted(image, ends, visible.fraction), alone)


def house(folder: Path, every: int = 1) -> Iterator[Scene]:
    """Yield scenes of a rendered log with the exact visibility of its landmarks.

    A landmark may stand for several edges up to 2 cm apart; bearings are judged where it stands for one.
    """
    camera = _camera_of(folder / "camera.yaml")
    exact, visible = defaultdict(list), defaultdict(list)
    for row in _rows(folder / "edges_exact.csv"):
        exact[row["landmark_id"]].append([float(row["x"]), float(row["z"])])
    for row in _rows(folder / "visible.csv"):
        visible[int(row["image"])].append(row)
    poses = {
        int(row["t_ns"]): np.array([float(row[key]) for key in ("x", "z", "heading")])
        for row in _rows(folder / "groundtruth.csv")
    }
    keys = ("u_bottom", "v_bottom", "u_top", "v_top")
    for index, row in list(enumerate(_rows(folder / "images.csv")))[::every]:
        known, pose = visible[index], poses[int(row["t_ns"])]
        ends = np.array([[float(edge[key]) for key in keys] for edge in known]).reshape(-1, 2, 2)
        share = np.array([float(edge["visible_fraction"]) for edge in known])
        image = cv2.imread(str(folder / row["file"]), cv2.IMREAD_GRAYSCALE)
        edges_of = [exact[edge["landmark_id"]] for edge in known]
        single = np.array([len(each) == 1 for each in edges_of], dtype=bool)
        # Landmarks stand in the middle of their edges, rounded; those of one edge are moved to where that is.
        first = np.array([each[0] if each else [np.nan, np.nan] for each in edges_of]).reshape(-1, 2)
        ends = np.where(single[:, None, None], _at_points(ends, first, camera, pose), ends)
        points = np.array([point for each in edges_of for point in each]).reshape(-1, 2)
        alone = _is_alone(ends, camera, _tangent(points, camera, pose)) & single
        yield Scene(image, camera, ends, share, _is_counted(image, ends, share), alone)


def york_urban(folder: Path) -> Iterator[Scene]:
    """Yield photographs with hand-labelled lines, each with its own tilt and roll."""
    labels = defaultdict(list)
    for row in _rows(folder / "labelled_lines.csv"):
        if row["is_vertical"] == "1":
            labels[row["image"]].append([float(row[key]) for key in ("x1", "y1", "x2", "y2")])
    for row in _rows(folder / "images.csv"):
        mount = Mount(np.deg2rad(float(row["pitch_down_deg"])), 1.5, np.deg2rad(float(row["roll_deg"])))
        intrinsics = (float(row[key]) for key in ("fx", "fy", "cx", "cy"))
        camera = Camera(int(row["width"]), int(row["height"]), *intrinsics, mount)
        image = cv2.imread(str(next((folder / "images").glob(f"{row['image']}.*"))), cv2.IMREAD_GRAYSCALE)
        ends = np.array(labels[row["image"]]).reshape(-1, 2, 2)
        upside_down = ends[:, 0, 1] < ends[:, 1, 1]
        ends = np.where(upside_down[:, None, None], ends[:, ::-1], ends)
        counted = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) >= COUNTED_LENGTH_PX
        alone = _is_alone(ends, camera, np.tan(camera.bearing_of_segments(ends)))
        yield Scene(image, camera, ends, np.ones(len(ends)), counted, alone)


def _is_counted(image: Array, ends_px: Array, share: Array) -> Array:
    """Return (T,) whether at least 60 px of an edge are in view, and the median step across it is 8 grey levels."""
    visible_px = np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=1) * share
    return (visible_px >= COUNTED_LENGTH_PX) & (_median_step(image, ends_px) >= COUNTED_STEP)


def _is_alone(ends_px: Array, camera: Camera, tangents: Array) -> Array:
    """Return (T,) whether only one of the edges in directions `tangents` (M,) passes within 6 px, at any height."""
    apart = np.abs(np.tan(camera.bearing_of_segments(ends_px))[:, None] - tangents) * camera.focal_px
    return np.asarray((apart < NEIGHBOUR_PX).sum(axis=1) == 1)


def _tangent(points: Array, camera: Camera, pose: Array) -> Array:
    """Return tan(bearing) (M,) of map points (M, 2), nan for what lies behind the camera."""
    right, backward = robot_from_map(camera.pose_in_map(pose), points).T
    return np.where(backward < 0, right / -np.where(backward < 0, backward, -1.0), np.nan)


def _at_points(ends_px: Array, points: Array, camera: Camera, pose: Array) -> Array:
    """Return segments (T, 2, 2) moved to the vertical edges at map points (T, 2), at the same image heights."""
    height, tilt_rad = camera.upright_from_pixels(ends_px)[..., 1], camera.mount.tilt_rad
    across = _tangent(points, camera, pose)[:, None] * (np.cos(tilt_rad) + height * np.sin(tilt_rad))
    return camera.pixels_from_upright(np.stack([across, height], axis=-1))


def _median_step(image: Array, ends_px: Array) -> Array:
    """Return (T,) the size of the median grey difference across ±2.5 px of edges (T, 2, 2)."""
    if len(ends_px) == 0:
        return np.zeros(0)
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    along = np.linspace(0.02, 0.98, 60)[None, :, None]
    points = (ends_px[:, :1] * (1 - along) + ends_px[:, 1:] * along).astype(np.float32)
    left, right = (
        cv2.remap(
            grey.astype(np.float32),
            points + np.float32([by, 0]),
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for by in (-2.5, 2.5)
    )
    return np.abs(np.median(right - left, axis=1))


def _camera_of(path: Path) -> Camera:
    fields = yaml.safe_load(path.read_text())
    fx, _, cx, _, fy, cy = fields["camera_matrix"]["data"][:6]
    mount = fields["mount"]
    angles = {f"{name}_rad": np.deg2rad(mount[f"{name}_deg"]) for name in ("tilt", "roll", "yaw")}
    return replace(
        Camera(
            fields["image_width"], fields["image_height"], fx, fy, cx, cy, Mount(height_m=mount["height_m"], **angles)
        ),
        distortion_model=fields["distortion_model"],
        distortion=tuple(fields["distortion_coefficients"]["data"]),
    )


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))
