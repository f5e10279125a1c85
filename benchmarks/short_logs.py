"""Logs for short runs: the beginnings of longer ones, and a drive among posts whose bearings name their posts."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import yaml
from program import ROOT

CORRIDOR = ROOT / "logs" / "corridor"


def first_images(source: Path, folder: Path, count: int) -> Path:
    """Copy a log folder with its first `count` images to `folder`, which is returned."""
    folder.mkdir()
    for file in source.iterdir():
        if file.is_file():
            shutil.copy(file, folder)
    rows = (source / "images.csv").read_text(encoding="utf-8").splitlines()[: count + 1]
    (folder / "images.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    for row in rows[1:]:
        name = row.split(",")[1]
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / name, folder / name)
    return folder


def first_seconds(source: Path, folder: Path, robot: int, seconds: float) -> Path:
    """Copy what one robot of MRCLAM measured in its first seconds to `folder`, which is returned."""
    folder.mkdir()
    for name in ("Barcodes.dat", "Landmark_Groundtruth.dat"):
        shutil.copy(source / name, folder)
    end_s = _first_time(source / f"Robot{robot}_Measurement.dat") + seconds
    for name in ("Measurement", "Odometry", "Groundtruth"):
        lines = (source / f"Robot{robot}_{name}.dat").read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if line.startswith("#") or float(line.split()[0]) < end_s]
        (folder / f"Robot{robot}_{name}.dat").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder


def _first_time(path: Path) -> float:
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(float(line.split()[0]) for line in lines if not line.startswith("#"))


def short_world() -> str:
    """Return the corridor's world file with the first second of its drive."""
    world = yaml.safe_load((ROOT / "configs" / "worlds" / "corridor.yaml").read_text(encoding="utf-8"))
    world["drive"]["path"] = [{"to": [0.1, 0.7], "pause_s": 0.4}, {"to": [0.05, 0.1]}]
    return str(yaml.safe_dump(world))


def posts(folder: Path, images: int = 80) -> Path:
    """Write a log of bearings to posts along an arc, each with the post that it belongs to; return its folder.

    The robot drives 0.1 m and turns 3° from image to image; a bearing errs by 0.3°, the wheels by 3 %.
    """
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (40, 2))
    sigma_rad, step_m, turn_rad = np.radians(0.3), 0.1, np.radians(3.0)
    folder.mkdir()
    shutil.copy(CORRIDOR / "camera.yaml", folder)
    wheels, truth = (_arc(images, step_m * scale, turn_rad * scale) for scale in (1.03, 1.0))
    rows = ["t_ns,bearing_rad,bearing_sigma_rad,lean_rad,lean_sigma_rad,length_px,polarity,landmark_id"]
    for t_ns, pose in zip(_times(images), truth, strict=True):
        bearing = _bearings(pose, points)
        seen = np.flatnonzero(np.abs(bearing) < np.radians(25))
        measured = bearing[seen] + rng.normal(0, sigma_rad, len(seen))
        rows += [f"{t_ns},{b:.9f},{sigma_rad:.9f},,,,,{i}" for b, i in zip(measured, seen, strict=True)]
        rows += [f"{t_ns},{b:.9f},{sigma_rad:.9f},,,,," for b in rng.uniform(-0.4, 0.4, 3)]
    landmarks = [f"- {{id: {i}, x: {x:.6f}, z: {z:.6f}}}" for i, (x, z) in enumerate(points)]
    frame = "frame: {axes: 'x right, y up, z backward', units: m}"
    _write(folder / "map.yaml", ["format: localiser-map/1", "name: posts", frame, "landmarks:", *landmarks])
    _write(folder / "edges.csv", rows)
    _write_poses(folder / "odometry.csv", wheels)
    _write_poses(folder / "groundtruth.csv", truth)
    files = [f"{name}: {name}.csv" for name in ("odometry", "groundtruth", "edges")]
    start = "start: {x: 0.0, z: 0.0, heading_deg: 0.0, sigma_m: 0.1, sigma_deg: 3.0}"
    head = ["format: localiser-log/1", "name: posts", "camera: camera.yaml", "map: map.yaml"]
    _write(folder / "log.yaml", [*head, *files, start])
    return folder


def _arc(count: int, step_m: float, turn_rad: float) -> np.ndarray:
    """Return poses (T, 3) of x, z and heading; forward is (−sin h, −cos h)."""
    heading = turn_rad * np.arange(count)
    steps = -step_m * np.stack([np.sin(heading), np.cos(heading)], axis=1)[:-1]
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([points, (heading + np.pi) % (2 * np.pi) - np.pi])


def _bearings(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the bearings (L,) of points (L, 2), positive to the right, from a camera 0.1 m ahead of the robot."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    offset = points - pose[:2]
    ahead, right = -offset @ [sine, cosine] - 0.1, offset @ [cosine, -sine]
    return np.arctan2(right, ahead)


def _times(count: int) -> list[int]:
    return [200_000_000 * index for index in range(count)]


def _write_poses(path: Path, poses: np.ndarray) -> None:
    rows = [f"{t},{x:.9f},{z:.9f},{h:.9f}" for t, (x, z, h) in zip(_times(len(poses)), poses, strict=True)]
    _write(path, ["t_ns,x,z,heading", *rows])


def _write(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
