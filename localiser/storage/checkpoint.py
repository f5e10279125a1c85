"""Checkpoints: the filter as it was after some image, exactly, to go on from later.

A file is two lines, the format's name and the SHA-256 of all that follows, and then what `packing` encodes. Nothing in
it is run, and how much memory is taken is bounded by the size of the file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from localiser.documents import read_bytes
from localiser.errors import InputError
from localiser.filter import FilterState
from localiser.storage.files import write_bytes
from localiser.storage.packing import decode, encode, fingerprint, form_of

FORMAT = "localiser-checkpoint/2"
MAX_BYTES = 2**30  # a state of ten million particles with five biases


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Where a run goes on from. kept: what else it kept, None where nothing was. identity: what it belongs to."""

    state: FilterState
    rng: np.random.Generator
    kept: Any
    identity: Mapping[str, str]


class _File(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """What is written, in its order. form: of the state's type. rng: the state of the generator, as JSON."""

    form: str
    identity: dict[str, str]
    rng: str
    state: msgspec.Raw
    kept: msgspec.Raw


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
    """Return the content of a checkpoint. kept: anything that `packing` can encode."""
    random = json.dumps(rng.bit_generator.state)  # its integers have more than 64 bits
    body = encode((form_of(FilterState), identity, random, state, kept))
    return f"{FORMAT}\n{sha256(body).hexdigest()}\n".encode() + body


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
        file: _File = decode(_File, body)
        if identity is not None:
            _require_same(path, file.identity, identity)
        if file.form != form_of(FilterState):
            raise ValueError("the filter keeps other things")
        state, rest_of_it = decode(FilterState, file.state), decode(kept or None, file.kept)
        rng = np.random.default_rng()
        rng.bit_generator.state = json.loads(file.rng)
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        problem = f"expected a checkpoint that this version of the program made; {error}"
        raise InputError(problem, path=path) from None
    return Checkpoint(state, rng, rest_of_it, file.identity)


def _require_same(path: Path, saved: Mapping[str, str], identity: Mapping[str, str]) -> None:
    for name in (*identity, *saved):
        if saved.get(name) != identity.get(name):
            found, expected = (side.get(name, "nothing") for side in (identity, saved))
            raise InputError(
                f"expected {expected}, as the checkpoint was made with, found {found}", path=path, field=name
            )
