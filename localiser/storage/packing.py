"""Typed data as plain values and arrays, and back again: dataclasses, containers and arrays, exactly as they were.

What can be read is decided by the types alone: nothing in a file chooses what is made of it, as pickle would let it.
"""

from __future__ import annotations

import types
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from hashlib import sha256
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

_ARRAY, _BYTES = "array", "bytes"  # the only key of what is packed apart; its value is the place among the arrays


def pack(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return `value` as JSON has it, its arrays appended to `arrays`. Raises TypeError for a type that is not known."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {_ARRAY: len(arrays) - 1}
    if isinstance(value, bytes):
        arrays.append(np.frombuffer(value, np.uint8))
        return {_BYTES: len(arrays) - 1}
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): pack(item, arrays) for key, item in value.items()}
    if isinstance(value, (list, tuple, deque, frozenset)):
        return [pack(item, arrays) for item in (sorted(value) if isinstance(value, frozenset) else value)]
    value = value.item() if isinstance(value, np.generic) else value.value if isinstance(value, Enum) else value
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"a {type(value).__name__} cannot be packed")


def unpack(hint: Any, packed: Any, arrays: Sequence[NDArray[Any]], at: str) -> Any:
    """Return the value of type `hint` that was packed. at: its name, for errors. Raises ValueError, with that name."""
    origin, arguments = get_origin(hint) or hint, get_args(hint)
    if origin in (Union, types.UnionType):
        return _unpack_any(arguments, packed, arrays, at)
    if origin in (np.ndarray, bytes):
        return _unpack_array(arguments, packed, arrays, at)
    if is_dataclass(origin):
        return _unpack_fields(origin, packed, arrays, at)
    if origin in (dict, Mapping):
        _checked(isinstance(packed, dict), packed, "names and values", at)
        return {name: unpack(arguments[1], item, arrays, f"{at}.{name}") for name, item in packed.items()}
    if origin in (list, tuple, deque, frozenset, Sequence):
        return _unpack_sequence(origin, arguments, packed, arrays, at)
    return _unpack_scalar(origin, arguments, packed, at)


def fingerprint(value: Any) -> str:
    """Return a name for the content of `value`, anything that can be packed: another content, another name."""
    arrays: list[NDArray[Any]] = []
    digest = sha256(repr(pack(value, arrays)).encode())
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()[:16]


def _unpack_any(hints: Sequence[Any], packed: Any, arrays: Sequence[NDArray[Any]], at: str) -> Any:
    """Return the value as the first of the types that it fits."""
    failures = []
    for hint in hints:
        try:
            return unpack(hint, packed, arrays, at)
        except ValueError as failure:
            failures.append(failure)
    raise failures[0]


def _unpack_array(
    arguments: Sequence[Any], packed: Any, arrays: Sequence[NDArray[Any]], at: str
) -> NDArray[Any] | bytes:
    """Return the array, or the bytes where an array has no type."""
    key, expected = (_ARRAY, "an array") if arguments else (_BYTES, "bytes")
    _checked(isinstance(packed, dict) and list(packed) == [key], packed, expected, at)
    index = packed[key]
    _checked(type(index) is int and 0 <= index < len(arrays), index, f"one of {len(arrays)} arrays", at)
    found: NDArray[Any] = arrays[index]
    scalar = get_args(arguments[1])[0] if arguments else np.uint8
    if scalar is not Any and found.dtype != np.dtype(scalar):
        raise ValueError(f"{at}: expected an array of {np.dtype(scalar)}, found {found.dtype}")
    return found if arguments else found.tobytes()


def _unpack_fields(cls: Any, packed: Any, arrays: Sequence[NDArray[Any]], at: str) -> Any:
    hints = field_types(cls)
    _checked(isinstance(packed, dict) and set(packed) == set(hints), packed, f"the fields {', '.join(hints)}", at)
    return cls(**{name: unpack(hint, packed[name], arrays, f"{at}.{name}") for name, hint in hints.items()})


def _unpack_sequence(
    origin: Any, arguments: Sequence[Any], packed: Any, arrays: Sequence[NDArray[Any]], at: str
) -> Any:
    _checked(isinstance(packed, list), packed, "several values", at)
    if origin is tuple and arguments[-1] is not Ellipsis:
        _checked(len(packed) == len(arguments), packed, f"{len(arguments)} values", at)
        hints = list(arguments)
    else:
        hints = [arguments[0]] * len(packed)
    items = [unpack(hint, item, arrays, f"{at}[{k}]") for k, (hint, item) in enumerate(zip(hints, packed, strict=True))]
    return items if origin is Sequence else origin(items)


@cache
def field_types(cls: Any) -> dict[str, Any]:
    """Return the type of every field of a dataclass, by name."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls)}


def _unpack_scalar(origin: Any, arguments: Sequence[Any], packed: Any, at: str) -> Any:
    if origin is Literal:
        return _checked(packed in arguments, packed, f"one of {arguments}", at)
    if isinstance(origin, type) and issubclass(origin, Enum):
        return origin(_checked(packed in {item.value for item in origin}, packed, f"a {origin.__name__}", at))
    if origin is float:
        return float(_checked(type(packed) in (int, float), packed, "a number", at))
    if origin in (bool, int, str, types.NoneType):
        return _checked(type(packed) is origin, packed, f"a {origin.__name__}", at)
    raise TypeError(f"{at}: a {origin} cannot be unpacked")


def _checked(is_right: bool, found: Any, expected: str, at: str) -> Any:
    if not is_right:
        text = repr(found)
        raise ValueError(f"{at}: expected {expected}, found {text if len(text) <= 60 else text[:57] + '…'}")
    return found
