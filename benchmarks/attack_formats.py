"""Change files by their structure: what is between the changes stays whole, so that readers get past the first check.

Each function takes the bytes of a file and returns others. `FORMS` says which is for which ending.
"""

from __future__ import annotations

import csv
import io
import json
import random
import re
import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import attack_bombs as bombs
import attack_values as values
from rosbags.rosbag2.storage_mcap import zstd

from localiser.documents import dump, parse
from localiser.errors import InputError
from localiser.image_files import measure
from localiser.storage.bags import Messages

Mutation = Callable[[bytes, random.Random], bytes]
COSTLY = 0.03
_IS_TRANSFORM = re.compile(rb"\x00\x01..\x01\x00{3}.{12}base_link\x00", re.DOTALL)  # the one of our bags


def mutated(data: bytes, suffix: str, rng: random.Random) -> bytes:
    """Return a file with one to three changes, most of them by its structure. suffix: the ending of its name."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        by_structure = FORMS.get(suffix, values.damaged)
        change = by_structure if rng.random() < 0.75 else values.damaged
        try:
            data = change(data, rng)
        except Exception:  # what was changed before is no longer of the form, as whatever library reads it says
            data = values.damaged(data, rng)
    return data


# -- trees: YAML, JSON ----------------------------------------------------------------------------------------------


def _yaml(data: bytes, rng: random.Random) -> bytes:
    try:
        tree = parse(data.decode(), "").value
    except InputError as error:
        raise ValueError(str(error)) from None
    text = dump(_changed(tree, rng))
    if rng.random() < 0.05:  # 2^30 values in 30 lines
        merged = (f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}\n" for k in range(1, 31))
        text += "a0: &a0 {x: 1}\n" + "".join(merged)
    return text.encode(errors="surrogatepass")


def _json(data: bytes, rng: random.Random) -> bytes:
    return json.dumps(_changed(json.loads(data), rng)).encode(errors="surrogatepass")


def _changed(tree: Any, rng: random.Random) -> Any:
    """Return plain data with one part changed."""
    places = list(_places(tree))
    if not places:
        return values.value(rng)
    part, key = rng.choice(places)
    kind = rng.randrange(7)
    if kind == 0:
        part[key] = values.value(rng)
    elif kind <= 2:
        part[key] = values.near(part[key], rng)
    elif kind == 3:
        del part[key]
    elif kind == 4 and isinstance(part, list):
        part[key:key] = [part[key]] * rng.choice((1, 2, 1000))
    elif kind == 4:
        part[rng.choice(values.TEXTS)] = part[key]
    elif kind == 5:
        other, name = rng.choice(places)
        with suppress(IndexError, KeyError):
            part[key] = json.loads(json.dumps(other[name], default=str))
    else:
        part[key] = [part[key]] if rng.random() < 0.5 else {str(key): part[key]}
    return tree


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, child in list(children):
        yield tree, key
        yield from _places(child)


# -- tables: CSV, columns between white space -----------------------------------------------------------------------


def _csv(data: bytes, rng: random.Random) -> bytes:
    rows = _table(list(csv.reader(io.StringIO(data.decode()))), rng)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode(errors="surrogatepass")


def _columns(data: bytes, rng: random.Random) -> bytes:
    rows = _table([line.split() for line in data.decode().splitlines()], rng)
    return "\n".join(" ".join(row) for row in rows).encode(errors="surrogatepass")


def _table(rows: list[list[str]], rng: random.Random) -> list[list[str]]:
    """Return a table with a cell, a row or a column changed."""
    row = rng.randrange(len(rows))
    column = rng.randrange(len(rows[row]))
    kind = rng.randrange(8)
    if kind <= 2:
        cell = rows[row][column]
        with suppress(ValueError):
            cell = str(values.near(float(cell) if "." in cell else int(cell), rng))
        rows[row][column] = rng.choice((cell, str(values.number(rng)), rng.choice(values.NUMBERS + values.TEXTS)))
    elif kind == 3:
        del rows[row]
    elif kind == 4:
        rows[row:row] = [list(rows[row]) for _ in range(rng.choice((1, 2, 3000)))]
    elif kind == 5:
        other = rng.randrange(len(rows))
        rows[row], rows[other] = rows[other], rows[row]
    elif kind == 6:
        filler = rng.choice(("0", "", "nan", rows[0][0]))
        rows = [cells + [filler] * rng.choice((1, 200)) for cells in rows]
    else:
        rows = [cells[:column] + cells[column + 1 :] for cells in rows]
    return rows


# -- images -----------------------------------------------------------------------------------------------------------


def _png(data: bytes, rng: random.Random) -> bytes:
    """Change a chunk, drop it, repeat it or move it; its checksum is right again, mostly. Or make it a costly one."""
    if rng.random() < COSTLY:
        return rng.choice((bombs.png_of_texts(data, 999), bombs.png_of_more((64, 48), 12_000)))
    chunks, place = [], 8
    while place + 8 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    chunks = _parts(chunks, rng, lambda chunk: (chunk[0], values.damaged(chunk[1], rng)))
    parts = [data[:8]]
    for name, body in chunks:
        checksum = zlib.crc32(name + body) if rng.random() < 0.98 else 0
        parts += [len(body).to_bytes(4, "big"), name, body, checksum.to_bytes(4, "big")]
    return b"".join(parts)


def _jpeg(data: bytes, rng: random.Random) -> bytes:
    """Change a segment before the first scan, drop it, repeat it or move it. Or make it a costly one."""
    if rng.random() < COSTLY:
        size, _ = measure(data)
        scans = bombs.jpeg_of_scans(size, 300_000)
        return rng.choice((scans, bombs.jpeg_of_scans(size, 2, first=(60_000, 10_000))))
    segments, place = [], 2
    while data[place] == 0xFF and data[place + 1] != 0xDA:
        length = int.from_bytes(data[place + 2 : place + 4], "big")
        segments.append((data[place + 1], data[place + 4 : place + 2 + length]))
        place += 2 + length
    scan = data[place:]
    if rng.random() < 0.2:
        return data[:place] + values.damaged(scan, rng)
    segments = _parts(segments, rng, lambda part: (part[0], values.with_number(part[1], rng)))
    made = [
        bytes([0xFF, kind]) + min(len(body) + 2, 65535).to_bytes(2, "big") + body[:65533] for kind, body in segments
    ]
    return data[:2] + b"".join(made) + scan


def _pgm(data: bytes, rng: random.Random) -> bytes:
    head, body = data[:32].split(b"\n255\n", 1)
    words = (head.decode() + " 255").split()
    words[rng.randrange(4)] = str(rng.choice((*values.INTEGERS, "P2", "P6", "P5", "-3", "1e3", "9" * 200)))
    return " ".join(words).encode() + b"\n" + body + data[32:]


def _parts(parts: list[Any], rng: random.Random, change: Callable[[Any], Any]) -> list[Any]:
    at, kind = rng.randrange(len(parts)), rng.randrange(6)
    if kind <= 2:
        parts[at] = change(parts[at])
    elif kind == 3:
        del parts[at]
    elif kind == 4:
        parts[at:at] = [parts[at]] * rng.choice((1, 3, 200))
    else:
        parts.append(parts.pop(at))
    return parts


# -- bags -------------------------------------------------------------------------------------------------------------


def _sqlite(data: bytes, rng: random.Random) -> bytes:
    """Change cells, messages by their fields, or the schema; sometimes a page, which is then part of two others."""
    if rng.random() < 0.1:
        size = int.from_bytes(data[16:18], "big")
        source, target = (size * rng.randrange(1, len(data) // size) for _ in range(2))
        return data[:target] + data[source : source + size] + data[target + size :]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"
        path.write_bytes(data)
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA writable_schema=ON")
            with suppress(sqlite3.Error, OverflowError):
                _change_database(database, rng)
            database.commit()
        return path.read_bytes()


def _change_database(database: sqlite3.Connection, rng: random.Random) -> None:
    tables = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type='table'")]
    table = rng.choice([name for name in tables if not name.startswith("sqlite")])
    columns = [row[1] for row in database.execute(f'PRAGMA table_info("{table}")')]
    column = rng.choice(columns)
    row = database.execute(f'SELECT rowid, * FROM "{table}" ORDER BY random() LIMIT 1').fetchone()
    kind = rng.randrange(10)
    if kind <= 3 and "messages" in tables:
        rows = database.execute("SELECT rowid, data FROM messages ORDER BY rowid").fetchall()
        rowid, content = rng.choice(rows)
        database.execute("UPDATE messages SET data=? WHERE rowid=?", (message(content, rng), rowid))
    elif kind <= 5:
        found = rng.choice((values.number(rng), rng.choice(values.TEXTS), None, b"\xff\0", rng.randbytes(9)))
        found = str(found) if isinstance(found, int) and abs(found) >= 2**63 else found
        everywhere = "" if rng.random() < 0.3 else f" WHERE rowid={row[0]}"
        database.execute(f'UPDATE "{table}" SET "{column}"=?{everywhere}', (found,))
    elif kind == 6:
        database.execute(f'DELETE FROM "{table}" WHERE rowid={row[0]}')
    elif kind == 7:
        database.execute(
            rng.choice(
                (
                    f'ALTER TABLE "{table}" ADD COLUMN more BLOB AS (zeroblob(200000000))',
                    f'ALTER TABLE "{table}" RENAME COLUMN "{column}" TO other',
                    f'ALTER TABLE "{table}" RENAME TO other',
                    f'DROP TABLE "{table}"',
                    f'CREATE VIEW seen AS SELECT * FROM "{table}"',
                    f'CREATE TRIGGER t AFTER INSERT ON "{table}" BEGIN SELECT 1; END',
                    "CREATE TABLE extra (a, b PRIMARY KEY) WITHOUT ROWID",
                )
            )
        )
    elif kind == 8:
        marks = ",".join("?" * len(row))
        names = ",".join(["rowid", *(f'"{name}"' for name in columns)])
        first = 10**9 + rng.randrange(10**6)
        for number in range(rng.choice((1, 3000))):
            copied = [first + number, *row[1:]]
            if columns[0] == "id":
                copied[1] = copied[0]
            database.execute(f'INSERT INTO "{table}" ({names}) VALUES ({marks})', copied)
    else:
        sql = rng.choice(("SELECT 1", "", f"CREATE TABLE {table} (x)", "CREATE TABLE \0"))
        database.execute("UPDATE sqlite_master SET sql=? WHERE name=?", (sql, table))


def message(data: bytes, rng: random.Random) -> bytes:
    """Change the numbers of a serialised message, which keep their places. Or make a transform many."""
    if _IS_TRANSFORM.match(data) and rng.random() < COSTLY:
        return many_frames(rng)
    for _ in range(rng.choice((1, 1, 4))):
        head, rest = data[:400], data[400:]
        data = values.with_number(head, rng) + rest if rng.random() < 0.85 else values.damaged(data, rng)
    return data


def many_frames(rng: random.Random) -> bytes:
    """Return transforms of as many frames as a search may have to go through."""
    return bombs.many_frames(Messages(), rng.choice((900, 9000, 15_000)))


def _mcap(data: bytes, rng: random.Random) -> bytes:
    """Change a record, inside a chunk or not, drop it, repeat it or move it."""
    magic = b"\x89MCAP0\r\n"
    records = _records(data[len(magic) : -len(magic)])
    return magic + _joined(_parts(records, rng, lambda record: _record(record, rng))) + magic


def _record(record: tuple[int, bytes], rng: random.Random) -> tuple[int, bytes]:
    kind, body = record
    if kind == 6:  # a chunk: 28 bytes, the name of the compression, and the records
        named = int.from_bytes(body[28:32], "little")
        begin = 32 + named + 8
        if rng.random() < 0.2:
            size = rng.choice((10**6, 10**7, 10**8))
            packed = zstd.compress(body[begin:] + bytes(size))
            head = body[:16] + struct.pack("<QII", len(body) - begin + size, 0, 4) + b"zstd"
            return kind, head + struct.pack("<Q", len(packed)) + packed
        inner = _records(body[begin:]) if named == 0 else []
        if inner and rng.random() < 0.8:
            inner = _parts(inner, rng, lambda part: _record(part, rng))
            content = _joined(inner)
            body = struct.pack("<8x8xQI", len(content), 0).join((b"", b"")) or body
            body = record[1][:16] + struct.pack("<QI", len(content), 0) + record[1][28 : 32 + named]
            return kind, body + struct.pack("<Q", len(content)) + content
    if kind == 5:  # a message: 22 bytes, and what was serialised
        return kind, body[:22] + message(body[22:], rng)
    return kind, values.damaged(body, rng) if rng.random() < 0.5 else values.with_number(body, rng)


def _records(data: bytes) -> list[tuple[int, bytes]]:
    found, place = [], 0
    while place + 9 <= len(data):
        length = int.from_bytes(data[place + 1 : place + 9], "little")
        found.append((data[place], data[place + 9 : place + 9 + length]))
        place += 9 + length
    return found


def _joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(bytes([kind]) + len(body).to_bytes(8, "little") + body for kind, body in records)


def _ros1(data: bytes, rng: random.Random) -> bytes:
    """Change a field in the head of a record, or what the record holds; both keep their length mostly."""
    places, place = [], data.index(b"\n") + 1
    while place + 4 <= len(data):
        head = int.from_bytes(data[place : place + 4], "little")
        body = place + 4 + head
        length = int.from_bytes(data[body : body + 4], "little")
        places += [(place, 4 + head), (body, 4), (body + 4, length)]
        place = body + 4 + length
    at, length = rng.choice(places)
    part = data[at : at + length]
    part = values.with_number(part, rng) if rng.random() < 0.8 else values.damaged(part, rng)
    return data[:at] + part + data[at + length :]


# -- our own files ----------------------------------------------------------------------------------------------------


def _checkpoint(data: bytes, rng: random.Random) -> bytes:
    """Change what is encoded, and state its checksum as whoever made the file would."""
    import msgspec

    from localiser.storage.checkpoint import FORMAT

    body = data.split(b"\n", 2)[2]
    if rng.random() < 0.7:
        tree = msgspec.msgpack.decode(body)
        body = msgspec.msgpack.encode(_changed(tree, rng))
    else:
        body = values.damaged(body, rng)
    return f"{FORMAT}\n{zlib_sha(body)}\n".encode() + body


def zlib_sha(body: bytes) -> str:
    """Return the checksum that a saved state carries."""
    from hashlib import sha256

    return sha256(body).hexdigest()


FORMS: dict[str, Mutation] = {
    ".yaml": _yaml,
    ".json": _json,
    ".csv": _csv,
    ".tum": _columns,
    ".dat": _columns,
    ".png": _png,
    ".jpg": _jpeg,
    ".pgm": _pgm,
    ".db3": _sqlite,
    ".mcap": _mcap,
    ".bag": _ros1,
    ".state": _checkpoint,
}
