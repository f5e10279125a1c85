"""Save the state of a filter after an image, and restore it to the last bit.

A file is two lines, the format's name and the SHA-256 of all that follows, and then what `encode` makes of the state.
Types alone decide what is made of the bytes: nothing in them can choose a class, as it could in a pickle. A length that
the bytes state is compared with what is there before memory is taken for it.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, get_args, get_origin

import msgspec
import numpy as np
from numpy.typing import NDArray

from localiser.edges import Edges
from localiser.errors import InputError
from localiser.filter import FilterState, Odometry
from localiser.geometry import Increment
from localiser.observation import PlaceLandmarks, Sighting
from localiser.particles import Particles
from localiser.relocalisation import History

FORMAT = "localiser-checkpoint/4"
_SHOWN = 80  # characters of a setting in an error


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Where a run goes on from. identity: what the state belongs to."""

    state: FilterState
    rng: np.random.Generator
    identity: Mapping[str, str]


class _File(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """What is written, in its order. form: of the state's type. rng: the state of the generator, as JSON."""

    form: str
    identity: dict[str, str]
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


def checkpoint_bytes(state: FilterState, rng: np.random.Generator, identity: Mapping[str, str]) -> bytes:
    """Return the content of a checkpoint. identity: what the state belongs to, see `identity_of`."""
    random = json.dumps(rng.bit_generator.state)  # its integers have more than 64 bits
    body = encode((form_of(FilterState), identity, random, state))
    return f"{FORMAT}\n{sha256(body).hexdigest()}\n".encode() + body


def checkpoint_of(content: bytes, path: Path, identity: Mapping[str, str] | None = None) -> Checkpoint:
    """Return what the content of a checkpoint holds. path: what errors name.

    Raises InputError where it is damaged, or was made with another `identity`: another map, another setting. Without
    `identity`, the state may belong to anything.
    """
    magic, _, rest = content.partition(b"\n")
    if magic != FORMAT.encode():
        is_another = magic.startswith(FORMAT.rpartition("/")[0].encode()) and len(magic) < 40
        found = magic.decode("ascii", "replace") if is_another else "something else"
        raise InputError(f"expected a checkpoint ({FORMAT}), found {found}", path=path)
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
        return Checkpoint(state, rng, file.identity)
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


# -- typed data as bytes (MessagePack), to the last bit ---------------------------------------------------------------


_NUMBERS = "fiub"  # kinds of arrays: floats, integers, unsigned integers, truth values


def encode(value: Any) -> bytes:
    """Return `value` as bytes. Raises TypeError for a type that is not known."""
    return msgspec.msgpack.encode(value, enc_hook=_plain)


def decode(hint: Any, content: bytes) -> Any:
    """Return the value of type `hint` that was encoded. Raises ValueError that names the part that does not fit."""
    try:
        return msgspec.msgpack.decode(content, type=hint, dec_hook=_typed)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ValueError(str(error)) from None


def fingerprint(value: Any) -> str:
    """Return a name for the content of `value`: another content has another name, another order in memory has not."""

    def plain_by_rows(part: Any) -> Any:
        return _plain(np.asarray(part, order="C") if isinstance(part, np.ndarray) else part)

    content = msgspec.msgpack.encode(value, enc_hook=plain_by_rows, order="deterministic")
    return sha256(content).hexdigest()[:16]


@cache
def form_of(hint: Any) -> str:
    """Return a name for the fields of a type and of everything in it: what it was encoded from, it is read as."""
    schema = msgspec.json.schema(hint, schema_hook=lambda custom: {"title": str(custom)})
    return sha256(repr(schema).encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    if isinstance(value, deque):
        return list(value)
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, np.ndarray) or value.dtype.kind not in _NUMBERS:
        raise TypeError(f"a {type(value).__name__} cannot be encoded")
    # In the order that it has in memory: how sums are rounded depends on it.
    order: Any = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
    little = value.astype(value.dtype.newbyteorder("<"), order="K", copy=False)
    return little.dtype.str, little.shape, order, little.tobytes(order)


def _typed(hint: Any, found: Any) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is deque:
        return deque(msgspec.convert(found, list[arguments[0]], dec_hook=_typed))  # type: ignore[valid-type]
    if origin is not np.ndarray:
        raise ValueError(f"a {hint} cannot be decoded")
    return _array(get_args(arguments[1])[0], *msgspec.convert(found, tuple[str, list[int], str, bytes]))


def _array(scalar: Any, name: str, shape: list[int], order: Any, content: bytes) -> NDArray[Any]:
    dtype = np.dtype(name)
    if dtype.kind not in _NUMBERS or (scalar is not Any and dtype != np.dtype(scalar)):
        raise ValueError(f"expected an array of {scalar if scalar is Any else np.dtype(scalar)}, found {name}")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(content):
        raise ValueError(f"expected an array of {shape} {name}, found {len(content)} bytes")
    return np.frombuffer(content, dtype).astype(dtype.newbyteorder("=")).reshape(shape, order=order)


# -- what a saved state may hold: numbers that can be true, arrays that belong together -------------------------------


_LARGEST = 1e12  # metres, radians, pixels, weights, and squares of what a file may state
_LATEST_NS = 2**62


def require_sound(value: Any) -> None:
    """Raise ValueError, with what was expected, where a part of a state cannot have been saved by a run.

    nan and infinity may be: they stand for what is not known, and for a weight of nothing.
    """
    if type(value) in _FITTING:
        _FITTING[type(value)](value)
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        if (np.abs(value[np.isfinite(value)]) > _LARGEST).any():
            raise ValueError(f"expected numbers within ±{_LARGEST:g}, found another")
    elif isinstance(value, float) and np.isfinite(value) and abs(value) > _LARGEST:
        raise ValueError(f"expected a number within ±{_LARGEST:g}, found {value}")
    elif isinstance(value, int) and abs(value) > _LATEST_NS:
        raise ValueError(f"expected an integer within ±{_LATEST_NS}, found {value}")
    parts: Iterable[Any] = ()
    if is_dataclass(value) and not isinstance(value, type):
        parts = (getattr(value, field.name) for field in fields(value))
    elif isinstance(value, (tuple, list, deque, dict)):
        parts = value.values() if isinstance(value, dict) else value
    for part in parts:
        require_sound(part)


def _particles(value: Particles) -> None:
    columns, errors = (len(value.names), len(value.log_weight)), len(value.names) - 3
    fits = value.columns.shape == columns and value.constant_error_cov.shape in ((errors, errors), (0, 0))
    if not fits or not columns[1] or not np.isfinite(value.columns).all():
        raise ValueError(f"expected particles of {columns} finite numbers, found {value.columns.shape} or others")
    if not np.isfinite(value.log_weight.max()):
        raise ValueError("expected particles of some weight, found none")


def _sighting(value: Sighting) -> None:
    for part in (value.persistent, value.scene, value.clutter):
        if part is not None and not (part.shape == value.edges.bearing.shape and (part >= 0).all()):
            raise ValueError(f"expected {len(value.edges)} numbers of clutter of at least 0, found others")


def _edges(value: Edges) -> None:
    count, common = len(value.bearing), value.common
    parts = [getattr(value, field.name) for field in fields(value) if field.name != "rejected_px"]
    fits = all(len(part) == count for part in parts if isinstance(part, np.ndarray))
    fits &= value.ends_px.shape == (count, 2, 2) and value.profile.ndim == 2
    terms = len(common.names)
    fits &= common.cov.shape == (terms, terms)
    fits &= common.bearing_from_lean.shape == common.bearing_from_line.shape == (count, terms)
    if not fits:
        raise ValueError(f"expected columns of {count} edges, found others")


def _increment(value: Increment) -> None:
    shapes = [part.shape for part in (value.mean, value.cov, value.by_delay, value.told)]
    if shapes != [(3,), (3, 3), (3,), (2,)]:
        raise ValueError("expected a motion of three numbers and its covariance, found another")


def _place_landmarks(value: PlaceLandmarks) -> None:
    is_whole = value.seen.shape == value.near.shape == (len(value.landmark), 2)
    if not is_whole or value.landmark.ndim != 1 or (np.diff(value.landmark, prepend=-1) <= 0).any():
        raise ValueError("expected ascending landmarks with two pairs of numbers for each, found others")


def _odometry(value: Odometry) -> None:
    if value.pose.shape != (3,) or not np.isfinite(value.pose).all():
        raise ValueError("expected a pose of three finite numbers, found another")


def _history(value: History) -> None:
    limits = [value.limits, *(image.limits for image in value.images)]
    if any(one.shape != (2,) for one in limits) or value.entered.shape != (len(value.images) + 1,):
        raise ValueError("expected limits and a probability for each image, found others")


_FITTING: dict[type, Callable[[Any], None]] = {
    Particles: _particles,
    Edges: _edges,
    Increment: _increment,
    PlaceLandmarks: _place_landmarks,
    Sighting: _sighting,
    Odometry: _odometry,
    History: _history,
}
"""What raises ValueError where the parts of a value of this type do not fit each other."""
