"""Save the state of a filter after an image, and restore it to the last bit.

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

from localiser.errors import InputError
from localiser.filter import FilterState
from localiser.storage.packing import decode, encode, fingerprint, form_of
from localiser.storage.sound import require_sound

FORMAT = "localiser-checkpoint/3"
_SHOWN = 80  # characters of a setting in an error


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Where a run goes on from. identity: what the state belongs to. notes: of whoever saved it; nothing is checked."""

    state: FilterState
    rng: np.random.Generator
    identity: Mapping[str, str]
    notes: Mapping[str, str]


class _File(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """What is written, in its order. form: of the state's type. rng: the state of the generator, as JSON."""

    form: str
    identity: dict[str, str]
    notes: dict[str, str]
    rng: str
    state: msgspec.Raw


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


def checkpoint_bytes(
    state: FilterState, rng: np.random.Generator, identity: Mapping[str, str], notes: Mapping[str, str] | None = None
) -> bytes:
    """Return the content of a checkpoint. identity: what the state belongs to, see `identity_of`. notes: see there."""
    random = json.dumps(rng.bit_generator.state)  # its integers have more than 64 bits
    body = encode((form_of(FilterState), identity, notes or {}, random, state))
    return f"{FORMAT}\n{sha256(body).hexdigest()}\n".encode() + body


def checkpoint_of(content: bytes, path: Path, identity: Mapping[str, str] | None = None) -> Checkpoint:
    """Return what the content of a checkpoint holds. path: what errors name.

    Raises InputError where it is damaged, or was made with another `identity`: another map, another setting. Without
    `identity`, the state may belong to anything.
    """
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
        rng = np.random.default_rng()
        rng.bit_generator.state = json.loads(file.rng)
        state = decode(FilterState, file.state)
        require_sound(state)
        return Checkpoint(state, rng, file.identity, file.notes)
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        problem = f"expected a checkpoint that this version of the program made; {error}"
        raise InputError(problem, path=path) from None


def _require_same(path: Path, saved: Mapping[str, str], identity: Mapping[str, str]) -> None:
    for name in (*identity, *saved):
        if saved.get(name) != identity.get(name):
            found, expected = (side.get(name, "nothing")[:_SHOWN] for side in (identity, saved))
            raise InputError(
                f"expected {expected}, as the checkpoint was made with, found {found}", path=path, field=name
            )
