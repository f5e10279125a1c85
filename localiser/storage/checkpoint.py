"""Save the state of a filter after an image, and restore it to the last bit.

A file is two lines, the format's name and the SHA-256 of all that follows, and then what `documents.encode` makes of
the state.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from localiser.documents import decode, encode, fingerprint
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


@cache
def form_of(hint: Any) -> str:
    """Return a name for the fields of a type and of everything in it: what it was encoded from, it is read as."""
    schema = msgspec.json.schema(hint, schema_hook=lambda custom: {"title": str(custom)})
    return sha256(repr(schema).encode()).hexdigest()[:16]


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
