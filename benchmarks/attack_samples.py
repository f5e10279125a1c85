"""Good files of every kind, small and made in seconds, which are then changed."""

from __future__ import annotations

import contextlib
import io
import shutil
from pathlib import Path

import cv2
import numpy as np

from localiser.camera import Camera
from localiser.commands import app
from localiser.documents import dump
from localiser.documents import load as load_document
from localiser.edges import find_edges
from localiser.filter import Sighting, Start
from localiser.localiser import Localiser
from localiser.storage import ImageEvent, Log, open_log, read_world, simulate_log, thinned, write_log, write_poses
from localiser.storage.bags import write_bag

ROOT = Path(__file__).resolve().parent.parent
FEW = ["--set", "mcl.particles=200", "--set", "mcl.start_particles=200", "--set", "search.particles_most=1000"]
FRAMES = 4

PLAN = "image: plan.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def make(folder: Path) -> Path:
    """Write the samples into a new folder, which is returned."""
    folder.mkdir(parents=True)
    log = _short(open_log(ROOT / "logs" / "corridor"))
    _write(folder / "log", log, as_edges=False)
    _write(folder / "edges", log, as_edges=True)
    for kind, name in (("ros1", "bag.bag"), ("mcap", "mcap"), ("sqlite3", "sqlite3")):
        write_bag(folder / name, log, kind)
    shutil.copy(next((folder / "mcap").glob("*.mcap")), folder / "file.mcap")
    shutil.copy(next((folder / "sqlite3").glob("*.db3")), folder / "file.db3")
    write_poses(log.odometry, folder / "poses.csv")
    shutil.copy(folder / "log" / "map.yaml", folder / "map.yaml")
    shutil.copy(folder / "log" / "camera.yaml", folder / "camera.yaml")
    shutil.copy(ROOT / "configs" / "default.yaml", folder / "config.yaml")
    _write_pictures(folder, log)
    _write_worlds(folder)
    _write_video(folder / "video.avi", log)
    (folder / "saved.state").write_bytes(_state(log))
    plan = folder / "plan"
    plan.mkdir()
    plan.joinpath("plan.yaml").write_text(PLAN)
    plan.joinpath("plan.pgm").write_bytes(b"P5\n50 60\n255\n" + bytes([0] * 12 + [254] * 26 + [0] * 12) * 60)
    run("replay", folder / "edges", "--out", folder / "results", "--quiet", "--no-rrd", *FEW)
    found = next((folder / "results").rglob("trajectory.csv")).parent
    shutil.copytree(found, folder / "run", ignore=shutil.ignore_patterns("report.*"))
    shutil.rmtree(folder / "results")
    batch = ["--seeds", "0-2", "--jobs", 1, "--quiet", *FEW]
    run("batch", folder / "edges", "--out", folder / "batch", *batch)
    return folder


def run(*arguments: object) -> None:
    """Run a command of the program in this process."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        app([str(argument) for argument in arguments], standalone_mode=False)


def _short(log: Log) -> Log:
    """Return the first images of a log, half as large, with the odometry and the truth of that time."""
    from dataclasses import replace

    frames = list(thinned(log, 0.4).frames[:FRAMES])
    end_ns = frames[-1].t_ns
    odometry = log.odometry
    kept = slice(0, int(np.searchsorted(odometry.t_ns, end_ns)) + 2)
    assert log.groundtruth is not None
    truth = log.groundtruth
    true = slice(0, int(np.searchsorted(truth.t_ns, end_ns)) + 2)
    return replace(
        log,
        name="short",
        frames=frames,
        odometry=type(odometry)(odometry.t_ns[kept], odometry.poses[kept]),
        groundtruth=type(truth)(truth.t_ns[true], truth.poses[true]),
    )


def _write(folder: Path, log: Log, *, as_edges: bool) -> None:
    """Write the log, with its images or with edges in their place, which are replayed in a tenth of the time."""
    images = log.images
    write_log(
        folder,
        name="edges" if as_edges else log.name,
        camera=log.camera,
        odometry=log.odometry,
        images=None if as_edges else [(frame.t_ns, frame.encoded()) for frame in images],
        sightings=_found(images, log.camera) if as_edges else None,
        landmark_map=log.landmark_map,
        groundtruth=log.groundtruth,
        start=log.start,
    )


def _found(images: list[ImageEvent], camera: Camera) -> list[Sighting]:
    return [Sighting(image.t_ns, find_edges(image.load(), camera)) for image in images]


def _write_pictures(folder: Path, log: Log) -> None:
    frame = log.frames[0]
    assert isinstance(frame, ImageEvent)
    (folder / "image.jpg").write_bytes(frame.encoded())
    small = cv2.resize(frame.load(), (64, 48))
    (folder / "image.png").write_bytes(cv2.imencode(".png", small)[1].tobytes())
    (folder / "small.jpg").write_bytes(cv2.imencode(".jpg", small)[1].tobytes())


def _write_worlds(folder: Path) -> None:
    """Write the world that ships, and one with a short drive and small images, which is simulated in a second."""
    shutil.copy(ROOT / "configs" / "worlds" / "corridor.yaml", folder / "world.yaml")
    document = load_document(folder / "world.yaml").value
    document["drive"]["path"] = document["drive"]["path"][:2]
    document["camera"] |= {"width": 160, "height": 120, "focal_px": document["camera"]["focal_px"] / 4}
    (folder / "small_world.yaml").write_text(dump(document))
    read_world(folder / "small_world.yaml")
    simulate_log(folder / "small_world.yaml")


def _write_video(path: Path, log: Log) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5.0, (log.camera.width, log.camera.height))
    for frame in log.frames:
        assert isinstance(frame, ImageEvent)
        writer.write(cv2.cvtColor(frame.load(), cv2.COLOR_GRAY2BGR))
    writer.release()


def _state(log: Log) -> bytes:
    localiser = localiser_of(log)
    start = log.start
    assert isinstance(start, Start)
    localiser.start(start.mean, start.cov, start.t_ns)
    for frame in log.frames[:2]:
        assert isinstance(frame, ImageEvent)
        localiser.odometry(frame.t_ns, log.odometry.at(frame.t_ns))
        localiser.image(frame.t_ns, frame.encoded())
    return localiser.save()


def localiser_of(log: Log) -> Localiser:
    """Return a localiser with few particles for a log that has a map."""
    from localiser.config import read_config

    assert log.landmark_map is not None
    return Localiser(log.landmark_map, log.camera, read_config(None, FEW[1::2]))


def write_others(folder: Path) -> None:
    """Write what is made by other parts: messages of a robot, arguments of commands."""
    import json
    import sys

    from attack_targets import OPTIONS

    sys.path[:0] = [str(ROOT / "tests" / "support")]
    import live_feed

    (folder / "live").mkdir()
    pose = live_feed.MAKE.pose_in_map(live_feed.BEGIN_NS, np.zeros(3), np.eye(3))
    truth = live_feed.MAKE.odometry(live_feed.BEGIN_NS, "map", np.zeros(3))
    messages = [
        *live_feed.camera(),
        *live_feed.drive(2),
        live_feed.arrival("groundtruth", 0, live_feed.MAKE.encode(truth)),
        live_feed.arrival("initialpose", 0, live_feed.MAKE.encode(pose)),
        *live_feed.drive(1, first=2),
    ]
    for place, message in enumerate(messages):
        name = f"{place:04d}_{message.role}_{message.at_ns}.cdr"
        (folder / "live" / name).write_bytes(message.content)
    (folder / "options").mkdir()
    words = [line.split() for line in OPTIONS.strip().splitlines()]
    (folder / "options" / "arguments.json").write_text(json.dumps(words))
