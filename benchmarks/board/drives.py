"""The drives of the scoreboard: logs with their edges, found once and kept, and maps that are made of logs.

Edges are kept by the content of image, camera and the code that finds them (`localiser.mapping.edges_of_log`), in
`results/scoreboard`. Rendered drives are kept there as log folders, by the content of the simulator and of their world.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import yaml
from edge_scenes import Light
from mrclam import MrclamReader
from program import fingerprint

from board import floors, marked, racks
from localiser import LandmarkMap, Trajectory, open_log, read_config, simulate_log
from localiser.mapping import build_map, edges_of_log
from localiser.simulate import odometry_of
from localiser.simulate.world import OdometrySpec
from localiser.storage import Log, write_log
from localiser.storage.log import ReadOptions

from board.run import Drive  # isort: skip

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("LOCALISER_DATA", ROOT.parent / "shared" / "data"))
KEPT = Path(os.environ.get("LOCALISER_SCOREBOARD", ROOT / "results" / "scoreboard"))
MRCLAM = ROOT / "configs" / "mrclam.yaml"
RENDERED = {
    "office": lambda: yaml.safe_load(floors.OFFICE.read_text(encoding="utf-8")),
    "racks": partial(racks.world_of, 0),
    "shop": marked.world_of,
}
RENDERED |= {f"floor{floor}": partial(floors.world_of, floor) for floor in range(floors.FLOORS)}
RENDERED |= {
    f"shop {change}": partial(marked.world_of, change)
    for change in ("mapping", "moved", "twice", "bare", "bare mapping")
}
MARKERS = {"edges.markers": "tag36h11"}  # of every shop, so that one without markers differs by them alone
EVERY_THIRD = slice(None, None, 3)
REAL_MAPS = {
    "vicon even": ("vicon_room/left_even", "vicon_room/right_even"),
    "vicon odd": ("vicon_room/left_odd", "vicon_room/right_odd"),
    "office even": ("office_real/even",),
    "office odd": ("office_real/odd",),
    "shop": ("shop mapping",),
    "shop bare": ("shop bare mapping",),
}


def is_there(name: str) -> bool:
    """Whether the data of a log is there."""
    return name in RENDERED or name == "corridor" or (DATA / name.partition(":")[0]).exists()


@cache
def log_of(name: str) -> Log:
    """Return a log by its name: one that ships, one of the data, or one that is rendered once."""
    if name == "corridor":
        return open_log(ROOT / "logs" / "corridor")
    if name not in RENDERED:
        if name.startswith("mrclam"):
            return MrclamReader().read(DATA / name, ReadOptions(read_config(MRCLAM).sensor))
        return open_log(DATA / name)
    world = RENDERED[name]()
    text = yaml.safe_dump(world)
    made_by = hashlib.sha256((fingerprint("localiser/simulate") + text).encode()).hexdigest()[:12]
    folder = KEPT / "rendered" / f"{name}-{made_by}"
    if not (folder / "log.yaml").exists():
        file = folder.with_suffix(".yaml")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        log = simulate_log(file, 0)
        write_log(
            folder,
            name=name,
            camera=log.camera,
            odometry=log.odometry,
            images=((image.t_ns, image.encoded()) for image in log.images),
            landmark_map=log.landmark_map,
            groundtruth=log.groundtruth,
        )
    log = open_log(folder)
    return replace(log, settings=log.settings | MARKERS) if name.startswith("shop") else log


@cache
def drive_of(name: str, light: Light | None = None, tilt_off_deg: float = 0.0, height_off_m: float = 0.0) -> Drive:
    """Return a log as a drive. light: its images are changed so. The others: what is stated of the camera is off."""
    log = log_of(name)
    if light is not None:
        log = replace(log, frames=[_lit(frame, light, k) for k, frame in enumerate(log.frames)])
    if tilt_off_deg or height_off_m:
        mount = log.camera.mount
        tilt_rad, height_m = mount.tilt_rad + float(np.deg2rad(tilt_off_deg)), mount.height_m + height_off_m
        log = replace(log, camera=log.camera.with_mount(tilt_rad=tilt_rad, height_m=height_m))
    config = MRCLAM if name.startswith("mrclam") else None
    edges = _kept_edges(log, config)
    t_ns = np.array([frame.t_ns for frame in log.frames], dtype=np.int64)
    truth = log.groundtruth.sampled(t_ns).poses
    own = log.landmark_map or LandmarkMap.from_points(np.zeros((1, 2)))
    return Drive(name, own, log.camera, log.odometry, t_ns, edges, truth, log.settings, config)


def _kept_edges(log: Log, config=None):
    """Return the edges of a log, which are found once."""
    (KEPT / "edges").mkdir(parents=True, exist_ok=True)
    return edges_of_log(log, read_config(config, [], log.settings).edges, cache=KEPT / "edges")


def _lit(frame, light: Light, seed: int):
    """Return an image event whose picture is changed; its bytes tell it from others in the cache of edges."""
    return replace(
        frame,
        load=lambda: light.taken(frame.load(), np.random.default_rng(seed)),
        encoded=lambda: frame.encoded() + repr((light, seed)).encode(),
    )


@cache
def map_of(name: str) -> LandmarkMap:
    """Return a map that is made of one or two logs with their true poses."""
    logs = [log_of(part) for part in REAL_MAPS[name]]
    return build_map(logs, config=read_config(None, [], logs[0].settings), edges_of=_kept_edges).landmark_map


def third_of(landmark_map: LandmarkMap) -> LandmarkMap:
    """Return every third landmark of a map."""
    return landmark_map.take(np.arange(len(landmark_map))[EVERY_THIRD])


def real_drive(name: str, seed: int) -> Drive:
    """Return a real log whose simulated odometry is drawn anew from the truth; same seed, same odometry."""
    log, drive = log_of(name), drive_of(name)
    rng = np.random.default_rng([seed, 50])
    spec = OdometrySpec(
        distance_scale=rng.normal(0.0, 0.015),
        rotation_scale=rng.normal(0.0, 0.01),
        distance_noise_m_per_sqrt_m=0.01,
        heading_walk_deg_per_sqrt_m=0.8,
    )
    t_ns = log.odometry.t_ns
    truth = Trajectory(t_ns, log.groundtruth.sampled(t_ns).poses)
    return replace(drive, odometry=odometry_of(truth, spec, rng))


def on_map(name: str, map_name: str, change: Callable[[LandmarkMap], LandmarkMap] = lambda one: one) -> Callable:
    """Return a function from a seed to a real drive on the map of other logs, changed."""
    return lambda seed: replace(real_drive(name, seed), landmark_map=change(map_of(map_name)))
