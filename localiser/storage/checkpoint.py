"""Checkpoints: the filter as it was after some image, exactly, to go on from later.

A file is two lines, the format's name and the SHA-256 of all that follows; then a line of JSON; then the bytes of the
arrays that it lists. Nothing in it is run, and how much memory is taken is bounded by the size of the file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.documents import read_bytes
from localiser.errors import InputError
from localiser.filter import FilterState
from localiser.storage.files import write_bytes
from localiser.storage.packing import fingerprint, pack, unpack

FORMAT = "localiser-checkpoint/1"
MAX_BYTES = 2**30  # a state of ten million particles with five biases
_MOST_DIMENSIONS = 8
_KINDS = "fiub"


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Where a run goes on from. kept: what else it kept, None where nothing was. identity: what it belongs to."""

    state: FilterState
    rng: np.random.Generator
    kept: Any
    identity: Mapping[str, str]


def identity_of(settings: Mapping[str, Any], **parts: Any) -> dict[str, str]:
    """Return what a state belongs to: every setting by its dotted name, and the fingerprint of each part.

    settings: of the configuration, in sections. parts: the map, the camera and whatever else must stay the same.
    """
    return dict(_flat(settings, "")) | {name: fingerprint(part) for name, part in parts.items()}


def _flat(settings: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str]]:
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", str(value)


def save_checkpoint(
    path: Path, state: FilterState, rng: np.random.Generator, identity: Mapping[str, str], kept: Any = None
) -> None:
    """Write a checkpoint, whole or not at all, also when the power fails. Raises OutputError."""
    write_bytes(path, checkpoint_bytes(state, rng, identity, kept), durably=True)


def checkpoint_bytes(
    state: FilterState, rng: np.random.Generator, identity: Mapping[str, str], kept: Any = None
) -> bytes:
    """Return the content of a checkpoint. kept: anything that can be packed."""
    arrays: list[NDArray[Any]] = []
    header = {
        "identity": dict(identity),
        "rng": rng.bit_generator.state,
        "state": pack(state, arrays),
        "kept": pack(kept, arrays),
    }
    # In the order that they have in memory: how sums are rounded depends on it.
    orders = ["F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C" for array in arrays]
    little = [array.astype(array.dtype.newbyteorder("<"), order="K", copy=False) for array in arrays]
    header["arrays"] = [
        [array.dtype.str, list(array.shape), order] for array, order in zip(little, orders, strict=True)
    ]
    parts = [json.dumps(header).encode() + b"\n"]
    parts += [array.tobytes(order) for array, order in zip(little, orders, strict=True)]  # type: ignore[arg-type]
    digest = sha256()
    for part in parts:
        digest.update(part)
    return b"".join([f"{FORMAT}\n{digest.hexdigest()}\n".encode(), *parts])


def load_checkpoint(path: Path, identity: Mapping[str, str], kept: Any = None) -> Checkpoint:
    """Return what was saved. kept: the type of what else was.

    Raises InputError where the file is damaged, or was made with another `identity`: another map, another setting.
    """
    return checkpoint_of(read_bytes(path, MAX_BYTES), path, identity, kept)


def checkpoint_of(
    content: bytes, path: Path, identity: Mapping[str, str] | None = None, kept: Any = None
) -> Checkpoint:
    """Return what the content of a checkpoint holds, as `load_checkpoint` does; without `identity`, any run's."""
    magic, _, rest = content.partition(b"\n")
    if magic != FORMAT.encode():
        raise InputError(f"expected a checkpoint ({FORMAT}), found something else", path=path)
    digest, _, body = rest.partition(b"\n")
    if digest != sha256(body).hexdigest().encode():
        raise InputError("expected a whole checkpoint, found one that is damaged or cut off", path=path)
    try:
        line, _, data = body.partition(b"\n")
        header = json.loads(line)
        saved = unpack(dict[str, str], header["identity"], [], "identity")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise _other_version(path, error) from None
    if identity is not None:
        _require_same(path, saved, identity)
    try:
        arrays = _arrays(header["arrays"], data)
        state = unpack(FilterState, header["state"], arrays, "state")
        rest_of_it = unpack(kept or type(None), header["kept"], arrays, "kept")
        rng = np.random.default_rng()
        rng.bit_generator.state = header["rng"]
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise _other_version(path, error) from None
    return Checkpoint(state, rng, rest_of_it, saved)


def _require_same(path: Path, saved: Mapping[str, str], identity: Mapping[str, str]) -> None:
    for name in (*identity, *saved):
        if saved.get(name) != identity.get(name):
            found, expected = (side.get(name, "nothing") for side in (identity, saved))
            raise InputError(
                f"expected {expected}, as the checkpoint was made with, found {found}", path=path, field=name
            )


def _other_version(path: Path, error: Exception) -> InputError:
    return InputError(f"expected a checkpoint that this version of the program made; {error}", path=path)


def _arrays(described: Any, data: bytes) -> list[NDArray[Any]]:
    """Return the arrays whose type, shape and order are listed, out of the bytes that hold them, one after another."""
    arrays, start = [], 0
    for name, shape, order in described:
        dtype = np.dtype(name)
        if dtype.kind not in _KINDS or len(shape) > _MOST_DIMENSIONS or any(size < 0 for size in shape):
            raise ValueError(f"expected an array of numbers, found {name} {shape}")
        stop = start + math.prod(shape) * dtype.itemsize
        if stop > len(data):
            raise ValueError(f"expected {stop} bytes of arrays, found {len(data)}")
        flat = np.frombuffer(data[start:stop], dtype).astype(dtype.newbyteorder("="))
        arrays.append(flat.reshape(shape, order=order))
        start = stop
    return arrays
