"""What is attacked: every reader of files, every command, messages of a robot, and options of the command line."""

from __future__ import annotations

import json
import os
import random
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import attack_values as values
from attack_formats import COSTLY, many_frames, mutated
from attack_samples import FEW, ROOT, localiser_of

from localiser.documents import read_bytes
from localiser.errors import LocaliserError

if TYPE_CHECKING:
    from localiser.storage import Log

Run = Callable[[Path, Path], object]
Change = Callable[[Path, random.Random], None]
SHORT_S, LONG_S = 20.0, 60.0
_FILTERS = ("replay", "batch")  # commands that get few particles
_PLACES: dict[str, str] = {}


def use_samples(folder: Path) -> None:
    """Say where the good files are; SAMPLES and {samples} stand for it in the arguments of commands."""
    _PLACES["SAMPLES"] = str(folder)


@dataclass(frozen=True)
class Target:
    """Something that takes input. sample: the good file or folder. run: takes the changed one and a folder for results.

    files: endings of the files in a folder that are changed, all by default. limit_s: of a case's processor time.
    """

    sample: str
    run: Run
    limit_s: float = SHORT_S
    files: tuple[str, ...] = ()
    change: Change | None = None


def prepared(target: Target, samples: Path, folder: Path, rng: random.Random) -> Path:
    """Copy the sample into `folder`, change it there, and return its path."""
    source, path = samples / target.sample, folder / Path(target.sample).name
    folder.mkdir(parents=True)
    if source.is_dir():
        shutil.copytree(source, path, symlinks=True)
    else:
        shutil.copy(source, path)
    if target.change is not None:
        target.change(path, rng)
    else:
        for _ in range(rng.choice((1, 1, 1, 2))):
            change(path, target.files, rng)
    return path


def change(path: Path, endings: tuple[str, ...], rng: random.Random) -> None:
    """Change a file, or one of the files in a folder, each kind as often as another."""
    files = [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file())
    files = [part for part in files if not endings or part.suffix in endings]
    if not files:
        return
    suffix = rng.choice(sorted({part.suffix for part in files}))
    file = rng.choice([part for part in files if part.suffix == suffix])
    if file != path and rng.random() < 0.06:
        _displace(file, path, rng)
    elif file.stat().st_size < 2**24:  # not what an earlier change has repeated
        file.write_bytes(mutated(file.read_bytes(), suffix, rng))


def _displace(file: Path, folder: Path, rng: random.Random) -> None:
    """Put something else where a file is named, or nothing."""
    content = file.read_bytes()
    file.unlink()
    kind = rng.randrange(7)
    if kind == 1:
        file.mkdir()
    elif kind == 2:
        os.mkfifo(file)
    elif kind == 3:
        file.symlink_to("/dev/zero")
    elif kind == 4:
        file.symlink_to(file.name)
    elif kind == 5:
        Path(os.fsdecode(os.fsencode(file.parent) + b"/\xff\xfe" + os.fsencode(file.name))).write_bytes(content)
    elif kind == 6:
        others = sorted(part for part in folder.rglob("*") if part.is_file())
        file.write_bytes(rng.choice(others).read_bytes() if others else b"")


# -- readers ----------------------------------------------------------------------------------------------------------


def _reader(name: str) -> Run:
    def read(path: Path, out: Path) -> object:
        from localiser import storage

        return getattr(storage, name)(path)

    return read


def all_of_log(path: Path, out: Path) -> None:
    from localiser.storage import ImageEvent, open_log

    for event in open_log(path).events():
        if isinstance(event, ImageEvent):
            event.load()


def _lay_beside(path: Path, rng: random.Random) -> None:
    """Put beside a database what a killed writer could have left, made to have SQLite delete a file; then change it."""
    sys.path[:0] = [str(ROOT / "tests" / "support")]
    from hot_journal import lay_journal

    victim = path.with_name("victim")
    victim.write_text("mine")
    journal = lay_journal(path, victim)
    if rng.random() < 0.5:
        journal.write_bytes(mutated(journal.read_bytes(), ".journal", rng))
    if rng.random() < 0.3:
        journal.rename(path.with_name(f"{path.name}{rng.choice(('-wal', '-shm'))}"))


def _table_of_edges(path: Path, out: Path) -> None:
    from localiser.storage import read_camera
    from localiser.storage.edge_tables import read_edges

    read_edges(path, read_camera(ROOT / "logs" / "corridor" / "camera.yaml"))


def _image(path: Path, out: Path) -> None:
    from localiser.storage import read_image

    size = (64, 48) if path.suffix == ".png" or path.name == "small.jpg" else (640, 480)
    read_image(path, size)


def _video(path: Path, out: Path) -> None:
    from localiser.storage import ImageEvent, read_video

    log = read_video(path, None, ROOT / "logs" / "corridor" / "camera.yaml")
    for frame in log.frames:
        assert isinstance(frame, ImageEvent)
        frame.load()


def _config(path: Path, out: Path) -> None:
    from localiser.config import read_config

    read_config(path)


@cache
def _corridor() -> Log:
    from localiser.storage import open_log

    return open_log(ROOT / "logs" / "corridor")


def _state(path: Path, out: Path) -> None:
    """Restore a saved state and go on from it, as a restarted live run does."""
    from localiser.storage import ImageEvent

    log = _corridor()
    localiser = localiser_of(log)
    localiser.restore(read_bytes(path, 2**30), path)
    frame = next(frame for frame in log.frames if frame.t_ns > 2 * 10**9)
    assert isinstance(frame, ImageEvent)
    localiser.odometry(frame.t_ns, log.odometry.at(frame.t_ns))
    localiser.image(frame.t_ns, frame.encoded())


def _live(path: Path, out: Path) -> None:
    """Feed a live run with messages; each file is one, its name says of what and when."""
    import numpy as np

    from localiser.config import read_config

    sys.path[:0] = [str(ROOT / "tests" / "support")]
    import live_feed

    few = ["mcl.particles=50", "mcl.start_particles=50", "search.particles_most=500", "search.fresh=50"]
    feed = live_feed.Feed(read_config(None, few))
    messages = []
    for file in sorted(path.iterdir()):
        role, t_ns = file.stem.split("_", 1)[1].rsplit("_", 1)
        messages.append(live_feed.arrival(role, int(t_ns), file.read_bytes()))
    feed(messages)
    feed.close()
    assert all(np.isfinite(published.located.estimate.mean).all() for published in feed.published)


def _change_messages(path: Path, rng: random.Random) -> None:
    """Change messages by the numbers in them, drop one, repeat one, or change their order."""
    files = sorted(path.iterdir())
    for _ in range(rng.choice((1, 2, 8))):
        file = rng.choice([part for part in files if part.exists()])
        kind = rng.randrange(10)
        data = file.read_bytes()
        if "_transforms_" in file.name and rng.random() < 10 * COSTLY:
            file.write_bytes(many_frames(rng))
        elif kind < 7:
            file.write_bytes(values.with_number(data[:400], rng) + data[400:])
        elif kind == 7:
            file.write_bytes(values.damaged(data, rng))
        elif kind == 8:
            file.with_name(f"9999_{file.stem.split('_', 1)[1]}{rng.randrange(99)}.cdr").write_bytes(data)
        else:
            other = rng.choice([part for part in files if part.exists()])
            file.write_bytes(other.read_bytes())


# -- commands ---------------------------------------------------------------------------------------------------------


def command(arguments: list[str]) -> None:
    """Run the program in this process, as a shell would. Raises LocaliserError when it ends with an error."""
    from localiser.commands import main

    sys.argv = ["localiser", *arguments]
    try:
        main()
    except SystemExit as end:
        if end.code not in (0, None):
            raise LocaliserError(f"exit code {end.code}") from None


def _command(line: str) -> Run:
    """Return what runs a command; IN, OUT and SAMPLES in it stand for the input, results and the good files."""

    def run(path: Path, out: Path) -> None:
        places = _PLACES | {"IN": str(path), "OUT": str(out)}
        command([in_places(word, places) for word in line.split()] + (FEW if line.startswith(_FILTERS) else []))

    return run


def in_places(word: str, places: dict[str, str]) -> str:
    for name, place in places.items():
        if word == name or word.startswith(f"{name}/"):
            return place + word[len(name) :]
    return word


def _options(path: Path, out: Path) -> None:
    """Run a command whose arguments are in a file, as a JSON list."""
    words = json.loads(path.joinpath("arguments.json").read_text())
    os.chdir(out)
    command([word.replace("{samples}", _PLACES["SAMPLES"]) for word in words])


def _change_options(path: Path, rng: random.Random) -> None:
    """Put something else in the place of one argument, drop one, or repeat one."""
    file = path / "arguments.json"
    words: list[str] = rng.choice(json.loads(file.read_text()))
    at = rng.randrange(1, len(words))
    kind = rng.randrange(6)
    hostile = rng.choice((str(values.number(rng)), rng.choice(values.TEXTS), rng.choice(values.NUMBERS), "1,2,3,4"))
    hostile = hostile.replace("\0", "\udcff")  # a shell cannot pass the former; the latter is a byte that is no text
    if kind <= 2:
        words[at] = hostile
    elif kind == 3:
        name, _, _ = words[at].partition("=")
        words[at] = f"{name}={hostile}"
    elif kind == 4:
        del words[at]
    else:
        words += words[at : at + 2]
    file.write_text(json.dumps(words))


READERS: dict[str, Target] = {
    "map": Target("map.yaml", _reader("read_map")),
    "camera": Target("camera.yaml", _reader("read_camera")),
    "config": Target("config.yaml", _config),
    "world": Target("world.yaml", _reader("read_world")),
    "poses": Target("poses.csv", _reader("read_poses")),
    "tum": Target("run/trajectory.tum", _reader("read_poses")),
    "track": Target("run/trajectory.csv", _reader("read_track")),
    "edges": Target("edges/edges.csv", _table_of_edges),
    "json": Target("run/metrics.json", _reader("read_json")),
    "runs-csv": Target("batch/runs.csv", _reader("read_runs")),
    "jpeg": Target("small.jpg", _image),
    "png": Target("image.png", _image),
    "plan": Target("plan", lambda path, out: _reader("read_plan")(path / "plan.yaml", out)),
    "video": Target("video.avi", _video),
    "state": Target("saved.state", _state),
    "log": Target("log", all_of_log),
    "log-edges": Target("edges", all_of_log),
    "bag-ros1": Target("bag.bag", all_of_log),
    "bag-mcap": Target("file.mcap", all_of_log),
    "bag-sqlite": Target("file.db3", all_of_log),
    "bag-beside": Target("file.db3", all_of_log, change=_lay_beside),
    "bag-folder": Target("sqlite3", all_of_log),
    "live": Target("live", _live, change=_change_messages),
}

LINES = {
    "replay": ("edges", "replay IN --no-rrd --out OUT --quiet"),
    "replay-images": ("log", "replay IN --out OUT --quiet"),
    "replay-bag": ("file.mcap", "replay IN --no-rrd --out OUT --quiet"),
    "evaluate": ("run", "evaluate IN"),
    "batch-again": ("batch", "batch SAMPLES/edges --seeds 0-2 --jobs 1 --against IN/runs.csv --out IN --quiet"),
    "convert-folder": ("log", "convert IN OUT/made.mcap --quiet"),
    "convert-bag": ("file.db3", "convert IN OUT/made --quiet"),
    "simulate": ("small_world.yaml", "simulate IN --out OUT/made --quiet"),
    "edges-of-log": ("log", "edges IN --out OUT/made --no-pictures --quiet"),
    "map-show": ("map.yaml", "map show IN --out OUT/map.png"),
    "map-check": ("edges", "map check IN/map.yaml --log IN --out OUT/map.png"),
    "map-align": ("map.yaml", "map align IN SAMPLES/map.yaml --out OUT/new.yaml"),
    "map-merge": ("map.yaml", "map merge IN SAMPLES/map.yaml --align --out OUT/new.yaml"),
    "map-plan": ("plan", "map plan IN/plan.yaml --out OUT/new.yaml"),
    "map-build": ("edges", "map build IN --poses odometry --out OUT/new.yaml"),
    "map-update": ("edges", "map update SAMPLES/map.yaml IN --poses truth --out OUT/new.yaml"),
    "camera-tilt": ("log", "camera tilt IN --quiet"),
    "doctor": ("log", "doctor IN"),
}
"""Commands whose files are changed: the good file or folder, and the command."""

TARGETS = READERS | {"options": Target("options", _options, LONG_S, change=_change_options)}
for _name, (_sample, _line) in LINES.items():
    _run = _command(_line)
    _files = (".csv", ".tum", ".json", ".yaml") if _sample == "run" else ()  # not the pictures of a report
    TARGETS[_name] = Target(_sample, _run, LONG_S, _files)

OPTIONS = """
replay {samples}/edges --out out --no-rrd --start 1,2,3 --seed 1 --speed 100 --set mcl.particles=100 --observation line
batch {samples}/edges --out out --jobs 1 --seeds 0-1 --set mcl.particles=100,200 --start 1,2,3
evaluate {samples}/run --truth {samples}/run/groundtruth.tum --json
simulate {samples}/small_world.yaml --out out/made --seed 1
convert {samples}/video.avi out/made --camera {samples}/camera.yaml --every 0.2s --start-ns 5
convert {samples}/file.db3 out/made.mcap --topic odometry=/odom --camera {samples}/camera.yaml
edges {samples}/image.jpg --camera {samples}/camera.yaml --detector columns --out out --set edges.min_contrast=0.1
map show {samples}/map.yaml --out map.png
map align {samples}/map.yaml {samples}/map.yaml --within 0.3 --out new.yaml
map plan {samples}/plan/plan.yaml --out new.yaml
map check {samples}/map.yaml --camera {samples}/camera.yaml --out map.png
map build {samples}/edges --out new.yaml --poses {samples}/poses.csv --trajectory t.tum
camera calibrate --draw-board board.png --board charuco --squares 8x6 --square-m 0.03 --marker-m 0.02
camera calibrate {samples}/image.jpg --board chessboard --squares 8x6 --square-m 0.03 --out cam.yaml
camera tilt {samples}/log --out levelled --set edges.min_contrast=0.1
config show --config {samples}/config.yaml --set mcl.particles=100 --set motion.alpha1=0.1
doctor {samples}/log --camera {samples}/camera.yaml --seconds 0.5
pose set 1,2,3 --sigma 0.1,3 --set live.connect=tcp/127.0.0.1:1
"""
"""Commands whose options are changed, a line each."""
