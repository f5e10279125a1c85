"""What is packed comes back exactly; what does not fit its type is refused."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.storage.packing import fingerprint, pack, unpack


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Inner:
    values: Array
    flags: NDArray[np.bool_]
    name: str = "a"


@dataclass(slots=True)
class Outer:
    inner: Inner | None = None
    many: deque[Inner] = field(default_factory=deque)
    both: tuple[int, str] = (1, "b")
    more: tuple[float, ...] = (np.nan, np.inf, 0.1)
    names: frozenset[str] = frozenset({"x", "y"})
    table: Mapping[str, list[float]] = field(default_factory=lambda: {"a": [1.0, 2.0]})
    kind: Literal["line", "slope"] = "line"
    colour: Colour = Colour.RED
    image: NDArray[np.uint8] | bytes | None = None
    yes: bool = True


def inner(value: float = 0.5) -> Inner:
    return Inner(np.array([[value, 2.0], [np.nan, -0.0]]), np.array([True, False]))


def packed(value: Any) -> tuple[Any, list[NDArray[Any]]]:
    arrays: list[NDArray[Any]] = []
    return json.loads(json.dumps(pack(value, arrays))), arrays


def test_everything_comes_back_as_it_was() -> None:
    before = Outer(inner(), deque([inner(1.0), inner(2.0)]), image=np.zeros((2, 2), dtype=np.uint8))
    after = unpack(Outer, *packed(before), "outer")
    assert isinstance(after.many, deque) and isinstance(after.names, frozenset) and isinstance(after.colour, Colour)
    assert (after.both, after.kind, after.names, after.table, after.yes) == (
        before.both, before.kind, before.names, before.table, True,
    )  # fmt: skip
    np.testing.assert_array_equal(after.more, before.more)
    for one, two in zip([before.inner, *before.many], [after.inner, *after.many], strict=True):
        assert one is not None
        np.testing.assert_array_equal(one.values, two.values)
        np.testing.assert_array_equal(np.signbit(one.values), np.signbit(two.values))
        np.testing.assert_array_equal(one.flags, two.flags)
    assert isinstance(after.image, np.ndarray)
    for image in (None, b"", b"\xff\xd8"):
        assert unpack(Outer, *packed(Outer(image=image)), "outer").image == image


@settings(derandomize=True, max_examples=200)
@given(st.floats(allow_nan=False))
def test_numbers_come_back_to_the_last_bit(value: float) -> None:
    assert unpack(float, *packed(value), "value") == value
    assert unpack(float, *packed(np.float64(value)), "value") == value


@pytest.mark.parametrize(
    ("hint", "value", "problem"),
    [
        (int, 1.5, "at: expected a int, found 1.5"),
        (bool, 1, "at: expected a bool"),
        (float, "1", "at: expected a number"),
        (Array, [1.0], "at: expected an array"),
        (Array, {"array": 3}, "at: expected one of 0 arrays, found 3"),
        (Inner, {"values": 1}, "at: expected the fields values, flags, name"),
        (tuple[int, str], [1], "at: expected 2 values"),
        (dict[str, int], {"a": "b"}, r"at\.a: expected a int"),
        (list[int], [1, None], r"at\[1\]: expected a int"),
        (Literal["a"], "b", "at: expected one of"),
        (Colour, "blue", "at: expected a Colour"),
    ],
)
def test_what_does_not_fit_is_refused_and_named(hint: Any, value: Any, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        unpack(hint, value, [], "at")


def test_array_of_another_type_is_refused() -> None:
    with pytest.raises(ValueError, match="expected an array of float64, found int64"):
        unpack(Array, *packed(np.arange(3)), "at")


def test_types_that_are_not_known_are_refused() -> None:
    with pytest.raises(TypeError, match="a object cannot be packed"):
        pack(object(), [])
    with pytest.raises(TypeError, match="cannot be unpacked"):
        unpack(complex, 1, [], "at")


def test_fingerprints_tell_contents_apart() -> None:
    values = [inner(), inner(0.25), (inner(), 1), (inner(), 2), np.zeros(2), np.zeros((2, 1)), np.zeros(2, dtype=int)]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint(inner()) == fingerprint(inner())
    assert fingerprint(np.asfortranarray(np.arange(6.0).reshape(2, 3))) == fingerprint(np.arange(6.0).reshape(2, 3))
