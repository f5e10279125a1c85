"""Values that a program may not expect: numbers at the edges of types, texts that mean something, damaged bytes."""

from __future__ import annotations

import random
import struct
from typing import Any

INTEGERS = (0, -1, 1, 255, 256, 65535, 2**31 - 1, -(2**31), 2**32, 2**53 + 1, 2**62, 2**63 - 1, -(2**63), 2**64, 10**30)
FLOATS = (0.0, -0.0, 0.1, -1.5, 1e-9, 5e-324, 1e6, 1e9, 1e19, 1e154, 1e300, -1e308, float("nan"), float("inf"))
NUMBERS = ("nan", "-inf", "1e400", "0x10", "1_0", "1,5", "٣", "9" * 30, "9" * 5000, "-0", "1e-400", ".", "true", "")
TEXTS = (
    "",
    " ",
    "a" * 300,
    "é١\u202e",
    "\0",
    "x\ny",
    "../../etc/passwd",
    "/dev/zero",
    "/dev/stdin",
    ".",
    "a/" * 3000,
    "null",
    "[/]",
    "[red",
    "[/bold] x",
    "$x_{",
    r"$\frac{$",
    "%s%n{}",
    "<b>&amp;",
    "=1+1",
    "-",
    "\x1b[2J",
    "2031-02-03",
    "yes",
)
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


def number(rng: random.Random) -> int | float:
    """Return an integer or a float, at the edge of something or of any size."""
    kind = rng.randrange(4)
    if kind == 0:
        return rng.choice(INTEGERS)
    if kind == 1:
        return rng.choice(FLOATS)
    return rng.choice((-1, 1)) * 10 ** rng.uniform(-12, 12) if kind == 2 else rng.randrange(-1000, 10**6)


def value(rng: random.Random) -> Any:
    """Return a value of any type that YAML and JSON have."""
    kind = rng.randrange(8)
    if kind < 3:
        return number(rng)
    if kind < 5:
        return rng.choice(TEXTS)
    nested: Any = number(rng)
    for _ in range(rng.choice((1, 2, 60))):
        nested = [nested] if rng.random() < 0.5 else {"a": nested}
    return (None, True, nested)[kind - 5]


def near(found: Any, rng: random.Random) -> Any:
    """Return a number near another one, with its type: another sign, ten times as much, a little more."""
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        return value(rng)
    changed = rng.choice((-found, found * 10, found * 1000, found + 1, found - 1, found / 10, found * 1.01))
    return int(changed) if isinstance(found, int) and abs(changed) < 1e300 else changed


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return bytes cut off, with bits flipped, with a piece put in, taken out, repeated or written over."""
    at = rng.randrange(len(data) + 1)
    end = min(at + rng.choice((1, 2, 8, 64, 4096)), len(data))
    match rng.randrange(7):
        case 0:
            data = data[:at]
        case 1:
            data = _flipped(data, rng)
        case 2:
            data = data[:at] + rng.choice(PIECES) + data[at:]
        case 3:
            data = data[:at] + data[end:]
        case 4:
            data = data[:end] + data[at:end] * rng.choice((1, 3, 50)) + data[end:]
        case 5:
            data = data[:at] + rng.randbytes(end - at) + data[end:]
        case _:
            data = with_number(data, rng)
    return data


def _flipped(data: bytes, rng: random.Random) -> bytes:
    found = bytearray(data)
    for _ in range(rng.choice((1, 2, 16)) if data else 0):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def with_number(data: bytes, rng: random.Random) -> bytes:
    """Return bytes of the same length in which a number of 1 to 8 bytes is another one: a size, a count, a time."""
    code = rng.choice("BHIQdf" if len(data) >= 8 else "B")
    width = struct.calcsize(code)
    if len(data) < width:
        return data
    at = rng.randrange((len(data) - width) // width + 1) * width
    if code in "df":
        found = rng.choice((*FLOATS, rng.uniform(-10, 10)))
        packed = struct.pack("<" + code, found if code == "d" or abs(found) < 1e38 else float("inf"))
    else:
        found = rng.choice((*INTEGERS, rng.randrange(64)))
        packed = struct.pack(rng.choice("<>") + code, found % 2 ** (8 * width))
    return data[:at] + packed + data[at + width :]
