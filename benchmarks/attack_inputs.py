"""What is attacked, the good files for it, and how they are changed: by their structure, so that most get past the
first check. Names that are formulas, markup or escapes, keys that collide, caches in folders of others, journals beside
bags, bags that swell, pictures and transforms that ask for much are among the changes.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import random
import re
import shutil
import sqlite3
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests" / "support")]

import attack_bombs as bombs  # noqa: E402
import cv2  # noqa: E402
import live_feed  # noqa: E402
from hot_journal import lay_journal  # noqa: E402
from swelling_bags import SWELLING  # noqa: E402

from localiser import storage  # noqa: E402
from localiser.commands import app  # noqa: E402
from localiser.config import read_config  # noqa: E402
from localiser.documents import dump, load, parse, read_bytes  # noqa: E402
from localiser.edges import find_edges  # noqa: E402
from localiser.errors import LocaliserError  # noqa: E402
from localiser.filter import Sighting, Start  # noqa: E402
from localiser.geometry import private_folder  # noqa: E402
from localiser.image_files import measure  # noqa: E402
from localiser.localiser import Localiser  # noqa: E402
from localiser.storage import ImageEvent, open_log  # noqa: E402
from localiser.storage.bags import Messages, write_bag  # noqa: E402
from localiser.storage.checkpoint import FORMAT  # noqa: E402
from localiser.storage.edge_tables import read_edges  # noqa: E402

Rng = random.Random
FEW = ["--set", "mcl.particles=200", "--set", "mcl.start_particles=200", "--set", "search.particles_most=1000"]
COSTLY = 0.03

# -- values -----------------------------------------------------------------------------------------------------------

INTEGERS = (0, -1, 1, 255, 256, 65535, 2**31 - 1, -(2**31), 2**32, 2**53 + 1, 2**62, 2**63 - 1, -(2**63), 2**64, 10**30)
FLOATS = (0.0, -0.0, 0.1, -1.5, 1e-9, 5e-324, 1e6, 1e9, 1e19, 1e154, 1e300, -1e308, float("nan"), float("inf"))
TEXTS = (
    "", " ", "a" * 300, "n" * 10**6, "é١\u202e", "\0", "x\ny", "../../etc/passwd", "/dev/zero", ".", "a/" * 3000,
    "null", "nan", "-inf", "1e400", "0x10", "1_0", "٣", "9" * 5000, "2031-02-03", "yes", "[/]", "[red", "[/bold] x",
    "$x_{", r"$\frac{$", "%s%n{}", "<script>x</script>", "| a |", "=1+1", "-", "\x1b[2J", "\x1b]0;owned\a",
)  # fmt: skip
PIECES = (
    b"\0",
    b"\xff\xfe",
    b"\r",
    b"\n",
    b",",
    b'"',
    b":",
    b"[" * 300,
    b"{",
    b"&a",
    b"*a",
    b"!!int x",
    b"- ",
    b"---\n",
)


def is_active(text: str) -> bool:
    """Return whether a text that was written has something in it that a terminal, a browser or a table acts on."""
    return any(mark in text for mark in ("\x1b", "<script>x", "\n=1+1", ",=1+1", "\u202e"))


def value(rng: Rng) -> Any:
    """Return a value of any type that YAML and JSON have."""
    found: Any = rng.choice(
        (*INTEGERS, *FLOATS, *TEXTS, None, True, rng.uniform(-1e6, 1e6), rng.randrange(-1000, 10**6))
    )
    for _ in range(rng.choice((0, 0, 0, 1, 60))):
        found = [found] if rng.random() < 0.5 else {"a": found}
    return found


def near(found: Any, rng: Rng) -> Any:
    """Return a number near another one, with its type: another sign, ten times as much, a little more."""
    if isinstance(found, bool) or not isinstance(found, (int, float)) or abs(found) > 1e300:
        return value(rng)
    return type(found)(rng.choice((-found, found * 10, found * 1000, found + 1, found - 1, found / 10, found * 1.01)))


def damaged(data: bytes, rng: Rng) -> bytes:
    """Return bytes cut off, with bits flipped, with a piece put in, taken out, repeated or written over."""
    at = rng.randrange(len(data) + 1)
    end = min(at + rng.choice((1, 2, 8, 64, 4096)), len(data))
    middle = rng.choice(
        (rng.choice(PIECES) + data[at:end], b"", data[at:end] * rng.choice((2, 50)), rng.randbytes(end - at))
    )
    return data[:at] if rng.random() < 0.2 else with_number(data[:at] + middle + data[end:], rng)


def with_number(data: bytes, rng: Rng) -> bytes:
    """Return bytes of the same length in which a number of 1 to 8 bytes is another one: a size, a count, a time."""
    code = rng.choice("BHIQd" if len(data) >= 8 else "B")
    width = struct.calcsize(code)
    if len(data) < width:
        return data
    at = rng.randrange((len(data) - width) // width + 1) * width
    found = rng.choice(FLOATS) if code == "d" else rng.choice((*INTEGERS, rng.randrange(64))) % 2 ** (8 * width)
    return data[:at] + struct.pack(rng.choice("<>") + code, found) + data[at + width :]


# -- files by their structure -----------------------------------------------------------------------------------------


def mutated(data: bytes, suffix: str, rng: Rng) -> bytes:
    """Return a file with one to three changes, most of them by its structure. suffix: the ending of its name."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        change = FORMS.get(suffix, damaged) if rng.random() < 0.75 else damaged
        try:
            data = change(data, rng)
        except Exception:  # what was changed before is no longer of the form, as whatever library reads it says
            data = damaged(data, rng)
    return data


def _yaml(data: bytes, rng: Rng) -> bytes:
    """Change a value or a name; or add keys of one hash (item 19), or 2^30 values in 30 lines."""
    tree = parse(data.decode(), "").value
    names = [key for key in ("name", "camera_name") if key in tree]
    text = dump(tree | {names[0]: rng.choice(TEXTS)} if names and rng.random() < 0.2 else _changed(tree, rng))
    if rng.random() < COSTLY:
        text += "".join(f"{k * (2**61 - 1)}: 0\n" for k in range(20_000))
    if rng.random() < COSTLY:
        text += "a0: &a0 {x: 1}\n" + "".join(f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}\n" for k in range(1, 31))
    return text.encode(errors="surrogatepass")


def _json(data: bytes, rng: Rng) -> bytes:
    return json.dumps(_changed(json.loads(data), rng)).encode(errors="surrogatepass")


def _changed(tree: Any, rng: Rng) -> Any:
    """Return plain data with one part changed."""
    part, key = rng.choice(list(_places(tree)))
    kind = rng.randrange(6)
    if kind <= 2:
        part[key] = near(part[key], rng) if kind else value(rng)
    elif kind == 3:
        del part[key]
    elif kind == 4 and isinstance(part, list):
        part[key:key] = [part[key]] * rng.choice((1, 2, 1000))
    else:
        part[key if isinstance(key, int) else rng.choice(TEXTS)] = [part[key]]
    return tree


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    for key, child in list(
        tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    ):
        yield tree, key
        yield from _places(child)


def _table(data: bytes, rng: Rng) -> bytes:
    """Change a cell, a row or a column of a table, whose cells stand between commas or spaces."""
    comma = b"," in data
    rows = list(csv.reader(io.StringIO(data.decode()), delimiter="," if comma else " "))
    row = rng.randrange(len(rows))
    column, kind = rng.randrange(len(rows[row])), rng.randrange(7)
    if kind <= 2:
        rows[row][column] = str(value(rng))
    elif kind == 3:
        del rows[row]
    elif kind == 4:
        rows[row:row] = [list(rows[row])] * rng.choice((1, 2, 3000))
    elif kind == 5:
        rows = [cells + [rng.choice(("0", "", "nan"))] * rng.choice((1, 200)) for cells in rows]
    else:
        rows = [cells[:column] + cells[column + 1 :] for cells in rows]
    csv.writer(text := io.StringIO(), lineterminator="\n", delimiter="," if comma else " ").writerows(rows)
    return text.getvalue().encode(errors="surrogatepass")


def _parts(parts: list[Any], rng: Rng, change: Callable[[Any], Any]) -> list[Any]:
    at = rng.randrange(len(parts))
    others = rng.choice(([change(parts[at])], [change(parts[at])], [parts[at]] * rng.choice((0, 2, 200))))
    return [*parts[:at], *others, *parts[at + 1 :]]


def _png(data: bytes, rng: Rng) -> bytes:
    """Change a chunk, drop it, repeat it or move it; its checksum is right again. Or make it a costly one."""
    if rng.random() < COSTLY:
        return rng.choice((bombs.png_of_texts(data, 999), bombs.png_of_more((64, 48), 12_000)))
    chunks, place = [], 8
    while place + 8 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    chunks = _parts(chunks, rng, lambda part: (part[0], damaged(part[1], rng)))
    return data[:8] + b"".join(bombs.chunk(*part) for part in chunks)


def _jpeg(data: bytes, rng: Rng) -> bytes:
    """Change a segment before the first scan, drop it, repeat it or move it. Or make it a costly one."""
    if rng.random() < COSTLY:
        size, _ = measure(data)
        return rng.choice((bombs.jpeg_of_scans(size, 300_000), bombs.jpeg_of_scans(size, 2, first=(60_000, 10_000))))
    segments, place = [], 2
    while data[place] == 0xFF and data[place + 1] != 0xDA:
        length = int.from_bytes(data[place + 2 : place + 4], "big")
        segments.append((data[place + 1], data[place + 4 : place + 2 + length]))
        place += 2 + length
    segments = _parts(segments, rng, lambda part: (part[0], with_number(part[1], rng)))
    made = [bytes([0xFF, kind]) + (len(body) + 2).to_bytes(2, "big") + body for kind, body in segments]
    return data[:2] + b"".join(made) + data[place:]


def _sqlite(data: bytes, rng: Rng) -> bytes:
    """Change a message, a cell or the schema."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"
        path.write_bytes(data)
        with closing(sqlite3.connect(path)) as database, suppress(sqlite3.Error, OverflowError):
            database.execute("PRAGMA writable_schema=ON")
            table = rng.choice(("messages", "topics"))
            column = rng.choice([row[1] for row in database.execute(f"PRAGMA table_info({table})")])
            rowid, content = rng.choice(database.execute("SELECT rowid, data FROM messages ORDER BY rowid").fetchall())
            kind = rng.randrange(4)
            if kind == 0:
                database.execute("UPDATE messages SET data=? WHERE rowid=?", (message(content, rng), rowid))
            elif kind == 1:
                database.execute(f"UPDATE {table} SET {column}=?", (rng.choice((*INTEGERS[:12], *TEXTS, b"\xff\0")),))
            elif kind == 2:
                database.execute("UPDATE sqlite_master SET sql=? WHERE name=?", (rng.choice(("SELECT 1", "")), table))
            else:
                more = f"ALTER TABLE {table} ADD COLUMN more BLOB AS (zeroblob(200000000))"
                database.execute(
                    rng.choice((more, f"DROP TABLE {table}", f"CREATE VIEW seen AS SELECT * FROM {table}"))
                )
            database.commit()
        return path.read_bytes()


_IS_TRANSFORM = re.compile(rb"\x00\x01..\x01\x00{3}.{12}base_link\x00", re.DOTALL)  # the one of our bags


def message(data: bytes, rng: Rng) -> bytes:
    """Change the numbers of a serialised message, which keep their places. Or make a transform many."""
    if _IS_TRANSFORM.match(data) and rng.random() < COSTLY:
        return bombs.many_frames(Messages(), rng.choice((900, 9000, 15_000)))
    return with_number(data[:400], rng) + data[400:] if rng.random() < 0.85 else damaged(data, rng)


def _mcap(data: bytes, rng: Rng) -> bytes:
    """Change a record, inside a chunk that is not compressed or not, drop it, repeat it or move it."""
    magic = b"\x89MCAP0\r\n"
    return magic + _joined(_parts(_records(data[8:-8]), rng, lambda record: _record(record, rng))) + magic


def _record(record: tuple[int, bytes], rng: Rng) -> tuple[int, bytes]:
    kind, body = record
    if kind == 6 and not any(body[28:32]):  # a chunk: 28 bytes, the name of the compression (none), and the records
        content = _joined(_parts(_records(body[40:]), rng, lambda part: _record(part, rng)))
        return kind, body[:16] + struct.pack("<QIIQ", len(content), 0, 0, len(content)) + content
    if kind == 5:  # a message: 22 bytes, and what was serialised
        return kind, body[:22] + message(body[22:], rng)
    return kind, damaged(body, rng)


def _records(data: bytes) -> list[tuple[int, bytes]]:
    found, place = [], 0
    while place + 9 <= len(data):
        length = int.from_bytes(data[place + 1 : place + 9], "little")
        found.append((data[place], data[place + 9 : place + 9 + length]))
        place += 9 + length
    return found


def _joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(bytes([kind]) + len(body).to_bytes(8, "little") + body for kind, body in records)


def _state(data: bytes, rng: Rng) -> bytes:
    """Forge a saved state: change what is encoded, and state its checksum as whoever made the file would."""
    body = msgspec.msgpack.encode(_changed(msgspec.msgpack.decode(data.split(b"\n", 2)[2]), rng))
    return f"{FORMAT}\n{sha256(body).hexdigest()}\n".encode() + body


FORMS: dict[str, Callable[[bytes, Rng], bytes]] = {
    ".yaml": _yaml, ".json": _json, ".csv": _table, ".tum": _table, ".png": _png, ".jpg": _jpeg, ".db3": _sqlite,
    ".mcap": _mcap, ".state": _state,
}  # fmt: skip

# -- good files -------------------------------------------------------------------------------------------------------


def make(folder: Path) -> Path:
    """Write the good files, small and made in seconds, into a new folder, which is returned."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "live").mkdir(parents=True)
    whole = open_log(ROOT / "logs" / "corridor")
    dense = storage.thinned(whole, 0.2).images[:16]  # as many as a map takes
    frames = dense[::5]
    assert whole.groundtruth is not None and isinstance(whole.start, Start)
    kept = [
        type(path)(path.t_ns[: (end := int(np.searchsorted(path.t_ns, dense[-1].t_ns)) + 2)], path.poses[:end])
        for path in (whole.odometry, whole.groundtruth)
    ]
    log = replace(whole, name="short", frames=frames, odometry=kept[0], groundtruth=kept[1])
    found = [Sighting(image.t_ns, find_edges(image.load(), log.camera)) for image in dense]
    parts = {name: getattr(log, name) for name in ("camera", "odometry", "landmark_map", "groundtruth", "start")}
    storage.write_log(folder / "log", name="short", images=[(each.t_ns, each.encoded()) for each in frames], **parts)
    storage.write_log(folder / "edges", name="edges", sightings=found, **parts)
    for name, kind in (("bag.bag", "ros1"), ("mcap", "mcap"), ("sqlite3", "sqlite3")):
        write_bag(folder / name, log, kind)
    shutil.copy(next((folder / "mcap").glob("*.mcap")), folder / "file.mcap")
    shutil.copy(next((folder / "sqlite3").glob("*.db3")), folder / "file.db3")
    storage.write_poses(log.odometry, folder / "poses.csv")
    for name in ("map.yaml", "camera.yaml"):
        shutil.copy(folder / "log" / name, folder / name)
    shutil.copy(ROOT / "configs" / "default.yaml", folder / "config.yaml")
    small = cv2.resize(frames[0].load(), (64, 48))
    for name in ("small.png", "small.jpg"):
        (folder / name).write_bytes(cv2.imencode(name[-4:], small)[1].tobytes())
    world = load(ROOT / "configs" / "worlds" / "corridor.yaml").value
    world["drive"]["path"] = world["drive"]["path"][:2]
    world["camera"] |= {"width": 160, "height": 120, "focal_px": world["camera"]["focal_px"] / 4}
    (folder / "small_world.yaml").write_text(dump(world))
    (folder / "plan").mkdir()
    plan = {"image": "plan.pgm", "resolution": 0.1, "origin": [0, 0, 0], "negate": 0}
    (folder / "plan" / "plan.yaml").write_text(dump(plan | {"occupied_thresh": 0.65, "free_thresh": 0.196}))
    (folder / "plan" / "plan.pgm").write_bytes(b"P5\n50 60\n255\n" + bytes([0] * 12 + [254] * 26 + [0] * 12) * 60)
    localiser = localiser_of(log)
    localiser.start(log.start.mean, log.start.cov, log.start.t_ns)
    localiser.odometry(frames[0].t_ns, log.odometry.at(frames[0].t_ns))
    localiser.image(frames[0].t_ns, frames[0].encoded())
    (folder / "saved.state").write_bytes(localiser.save())
    for place, each in enumerate([*live_feed.camera(), *live_feed.drive(3)]):
        (folder / "live" / f"{place:04d}_{each.role}_{each.at_ns}.cdr").write_bytes(each.content)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        for words in (
            ["replay", folder / "edges", "--out", folder / "results", "--no-rrd", *FEW],
            ["batch", folder / "edges", "--out", folder / "batch", "--seeds", "0-2", "--jobs", "1", *FEW],
        ):
            app([str(word) for word in words], standalone_mode=False)
    run = next((folder / "results").rglob("trajectory.csv")).parent
    shutil.copytree(run, folder / "run", ignore=shutil.ignore_patterns("report.*"))
    shutil.rmtree(folder / "results")
    return folder


def localiser_of(log: storage.Log) -> Localiser:
    """Return a localiser with few particles for a log that has a map."""
    assert log.landmark_map is not None
    return Localiser(log.landmark_map, log.camera, read_config(None, FEW[1::2]))


# -- what is attacked -------------------------------------------------------------------------------------------------

Run = Callable[[Path, Path], object]
_PLACES: dict[str, str] = {}


@dataclass(frozen=True)
class Target:
    """Something that takes input. sample: the good file or folder. run: takes the changed one and a folder for results.

    change: in place of that of one or two files by their structure. limit_s: of a case's processor time.
    """

    sample: str
    run: Run
    limit_s: float = 20.0
    change: Callable[[Path, Rng], object] | None = None


def use_samples(folder: Path) -> None:
    """Say where the good files are; SAMPLES stands for it in the arguments of commands."""
    _PLACES["SAMPLES"] = str(folder)


def prepared(target: Target, samples: Path, folder: Path, rng: Rng) -> Path:
    """Copy the sample into `folder`, change it there, and return its path."""
    source, path = samples / target.sample, folder / Path(target.sample).name
    folder.mkdir(parents=True)
    (shutil.copytree if source.is_dir() else shutil.copy)(source, path)
    for _ in range(1 if target.change else rng.choice((1, 1, 2))):
        (target.change or _change_files)(path, rng)
    return path


def _change_files(path: Path, rng: Rng) -> None:
    """Change a file, or one of the files in a folder, each kind as often as another; or put something in its place."""
    files = [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file())
    suffix = rng.choice(sorted({part.suffix for part in files}))
    file = rng.choice([part for part in files if part.suffix == suffix])
    if file.stat().st_size < 2**24 and (file == path or rng.random() > 0.06):  # not what an earlier change has repeated
        file.write_bytes(mutated(file.read_bytes(), suffix, rng))
        return
    file.unlink()
    rng.choice((file.mkdir, lambda: os.mkfifo(file), lambda: file.symlink_to("/dev/zero"), lambda: None))()


def all_of_log(path: Path, out: Path) -> None:
    for event in open_log(path).events():
        if isinstance(event, ImageEvent):
            event.load()


def _lay_beside(path: Path, rng: Rng) -> None:
    """Put beside a database what a killed writer could have left, made to have SQLite delete a file; then change it."""
    victim = path.with_name("victim")
    victim.write_text("mine")
    journal = lay_journal(path, victim)
    if rng.random() < 0.5:
        journal.write_bytes(damaged(journal.read_bytes(), rng))
    if rng.random() < 0.3:
        journal.rename(path.with_name(f"{path.name}{rng.choice(('-wal', '-shm'))}"))


def _swell(path: Path, rng: Rng) -> None:
    """Make a bag of some kB that asks for hours or gigabytes, beside which the sample does not count."""
    path.unlink()
    made = SWELLING[rng.choice(sorted(SWELLING))](path.with_name("swelling"))
    path.symlink_to(made)


def _open_caches(path: Path, rng: Rng) -> None:
    """Let another user change a folder on the way to a cache, the cache itself, or what a link on the way leads to."""
    for folder in ((path := path.with_name("cache")), path / "a", path / "a" / "edges"):
        folder.mkdir(mode=0o700)
    at = rng.choice((path, path / "a", path / "a" / "edges"))
    if rng.random() < 0.3 and at != path / "a" / "edges":
        at = at.rename(at.with_name("real"))
        path.joinpath("a" if path.exists() else "").symlink_to(at)
    at.chmod(rng.choice((0o777, 0o770, 0o702)))


def _cache(path: Path, out: Path) -> None:
    """Ask for the cache's folder; none in what another user can change may be given."""
    os.environ["LOCALISER_CACHE"] = str(path.with_name("cache") / "a")
    found = private_folder("edges")
    del os.environ["LOCALISER_CACHE"]
    assert found is None or not found.is_relative_to(path.parent.resolve()), f"{found} can be changed by others"


@cache
def _corridor() -> storage.Log:
    return open_log(ROOT / "logs" / "corridor")


def _restore(path: Path, out: Path) -> None:
    """Restore a saved state and go on from it, as a restarted live run does."""
    localiser = localiser_of(_corridor())
    localiser.restore(read_bytes(path, 2**30), path)
    frame = next(frame for frame in _corridor().images if frame.t_ns > 2 * 10**9)
    localiser.odometry(frame.t_ns, _corridor().odometry.at(frame.t_ns))
    localiser.image(frame.t_ns, frame.encoded())


def _live(path: Path, out: Path) -> None:
    """Feed a live run with messages; each file is one, its name says of what and when."""
    few = ["mcl.particles=50", "mcl.start_particles=50", "search.particles_most=500", "search.fresh=50"]
    feed = live_feed.Feed(read_config(None, few))
    named = [(file, *file.stem.split("_", 1)[1].rsplit("_", 1)) for file in sorted(path.iterdir())]
    feed([live_feed.arrival(role, int(t_ns), file.read_bytes()) for file, role, t_ns in named])
    feed.close()
    assert all(np.isfinite(published.located.estimate.mean).all() for published in feed.published)


def _change_messages(path: Path, rng: Rng) -> None:
    """Change messages by the numbers in them, repeat one later, or flood the frames of the robot."""
    for _ in range(rng.choice((1, 2, 8))):
        file = rng.choice(sorted(path.iterdir()))
        data = file.read_bytes()
        flood = "_transforms_" in file.name and rng.random() < 10 * COSTLY
        file.write_bytes(bombs.many_frames(Messages(), 15_000) if flood else message(data, rng))
        if rng.random() < 0.1:
            file.with_name(f"9999_{file.stem.split('_', 1)[1]}{rng.randrange(99)}.cdr").write_bytes(data)


def _command(line: str) -> Run:
    """Return what runs a command in this process; IN, OUT and SAMPLES stand for the input, results and good files."""

    def run(path: Path, out: Path) -> None:
        from localiser.commands import main

        places = _PLACES | {"IN": str(path), "OUT": str(out)}
        few = FEW if line.startswith(("replay", "batch")) else []
        sys.argv = ["localiser", *(in_places(word, places) for word in line.split()), *few]
        try:
            main()
        except SystemExit as end:
            if end.code not in (0, None):
                raise LocaliserError(f"exit code {end.code}") from None

    return run


def in_places(word: str, places: dict[str, str]) -> str:
    name, slash, rest = word.partition("/")
    return places.get(name, name) + slash + rest


def _reader(name: str) -> Run:
    return lambda path, out: getattr(storage, name)(path)


READERS: dict[str, Target] = {
    "map": Target("map.yaml", _reader("read_map")),
    "camera": Target("camera.yaml", _reader("read_camera")),
    "config": Target("config.yaml", lambda path, out: read_config(path)),
    "world": Target("small_world.yaml", _reader("read_world")),
    "poses": Target("poses.csv", _reader("read_poses")),
    "tum": Target("run/trajectory.tum", _reader("read_poses")),
    "track": Target("run/trajectory.csv", _reader("read_track")),
    "edges": Target("edges/edges.csv", lambda path, out: read_edges(path, _corridor().camera)),
    "json": Target("run/metrics.json", _reader("read_json")),
    "runs-csv": Target("batch/runs.csv", _reader("read_runs")),
    "jpeg": Target("small.jpg", lambda path, out: storage.read_image(path, (64, 48))),
    "png": Target("small.png", lambda path, out: storage.read_image(path, (64, 48))),
    "plan": Target("plan", lambda path, out: storage.read_plan(path / "plan.yaml")),
    "state": Target("saved.state", _restore),
    "cache": Target("map.yaml", _cache, change=_open_caches),
    "log": Target("log", all_of_log),
    "log-edges": Target("edges", all_of_log),
    "bag-ros1": Target("bag.bag", all_of_log),
    "bag-mcap": Target("file.mcap", all_of_log),
    "bag-sqlite": Target("file.db3", all_of_log),
    "bag-folder": Target("sqlite3", all_of_log),
    "bag-beside": Target("file.db3", all_of_log, change=_lay_beside),
    "bag-swelling": Target("file.mcap", lambda path, out: all_of_log(path.resolve(), out), change=_swell),
    "live": Target("live", _live, change=_change_messages),
}

LINES = {
    "replay": ("edges", "replay IN --no-rrd --out OUT"),
    "replay-images": ("log", "replay IN --out OUT"),
    "evaluate": ("run", "evaluate IN"),
    "batch": ("edges", "batch IN --seeds 0-1 --jobs 1 --out OUT"),
    "batch-again": ("batch", "batch SAMPLES/edges --seeds 0-2 --jobs 1 --against IN/runs.csv --out IN"),
    "convert-folder": ("log", "convert IN OUT/made.mcap"),
    "convert-bag": ("file.db3", "convert IN OUT/made"),
    "simulate": ("small_world.yaml", "simulate IN --out OUT/made"),
    "edges-of-log": ("log", "edges IN --out OUT/made --no-pictures"),
    "map-show": ("map.yaml", "map show IN --out OUT/map.png"),
    "map-check": ("edges", "map check IN/map.yaml --log IN --out OUT/map.png"),
    "map-align": ("map.yaml", "map align IN SAMPLES/map.yaml --out OUT/new.yaml"),
    "map-merge": ("map.yaml", "map merge IN SAMPLES/map.yaml --align --out OUT/new.yaml"),
    "map-plan": ("plan", "map plan IN/plan.yaml --out OUT/new.yaml"),
    "map-build": ("edges", "map build IN --poses odometry --out OUT/new.yaml"),
    "map-update": ("edges", "map update SAMPLES/map.yaml IN --poses truth --out OUT/new.yaml"),
    "camera-tilt": ("log", "camera tilt IN"),
    "doctor": ("log", "doctor IN"),
}
"""Commands whose files are changed: the good file or folder, and the command."""

TARGETS = READERS | {name: Target(sample, _command(line), 60.0) for name, (sample, line) in LINES.items()}
