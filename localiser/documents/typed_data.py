"""Typed data as bytes (MessagePack), to the last bit, and names for their content.

Types alone decide what is made of the bytes: nothing in them can choose a class, as it could in a pickle. A length that
the bytes state is compared with what is there before memory is taken for it.
"""

from __future__ import annotations

import math
from collections import deque
from hashlib import sha256
from typing import Any, get_args, get_origin

import msgspec
import numpy as np
from numpy.typing import NDArray

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
