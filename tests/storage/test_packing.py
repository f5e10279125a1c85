"""What is packed comes back exactly; what does not fit its type is refused."""

from __future__ import annotations

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
from localiser.storage.packing import decode, encode, fingerprint


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
    image: NDArray[np.uint8] | None = None
    file: bytes = b""
    yes: bool = True


def inner(value: float = 0.5) -> Inner:
    return Inner(np.array([[value, 2.0], [np.nan, -0.0]]), np.array([True, False]))


def test_everything_comes_back_as_it_was() -> None:
    before = Outer(inner(), deque([inner(1.0), inner(2.0)]), image=np.zeros((2, 2), dtype=np.uint8))
    after = decode(Outer, encode(before))
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
    assert after.image.flags.writeable
    assert decode(Outer, encode(Outer(file=b"\xff\xd8"))).file == b"\xff\xd8"


@settings(max_examples=200)
@given(st.floats(allow_nan=False))
def test_numbers_come_back_to_the_last_bit(value: float) -> None:
    assert decode(float, encode(value)) == value
    assert decode(float, encode(np.float64(value))) == value


@pytest.mark.parametrize(
    ("hint", "value", "problem"),
    [
        (int, 1.5, "Expected `int`, got `float`"),
        (bool, 1, "Expected `bool`"),
        (float, "1", "Expected `float`"),
        (Array, [1.0], "Expected `array` of length 4, got 1"),
        (Array, ["<f8", [-2], "C", b""], r"expected an array of \[-2\] <f8, found 0 bytes"),
        (Array, ["<f8", [2**60, 2**60], "C", b"12345678"], "found 8 bytes"),
        (Array, ["<f8", [1], "X", b"12345678"], "order"),
        (Array, ["|O", [1], "C", b"12345678"], r"expected an array of float64, found \|O"),
        (NDArray[Any], ["|O", [1], "C", b"12345678"], r"expected an array of typing.Any, found \|O"),
        (Array, ["?what", [1], "C", b"12345678"], "what"),
        (Array, np.arange(3), "expected an array of float64, found <i8"),
        (Inner, {"name": 1}, r"Expected `str`, got `int` - at `\$.name`"),
        (Inner, {"name": "b"}, "missing required field `values`"),
        (tuple[int, str], [1], "Expected `array` of length 2"),
        (dict[str, int], {"a": "b"}, "Expected `int`"),
        (deque[Inner], [1], "Expected `object`, got `int`"),
        (Literal["a"], "b", "Invalid enum value 'b'"),
        (Colour, "blue", "Invalid enum value 'blue'"),
        (complex, 1, "a <class 'complex'> cannot be decoded"),
    ],
)
def test_what_does_not_fit_is_refused_and_named(hint: Any, value: Any, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        decode(hint, encode(value))


@pytest.mark.parametrize("content", [b"", b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff\0"])
def test_bytes_that_end_early_are_refused_whatever_length_they_state(content: bytes) -> None:
    with pytest.raises(ValueError, match="truncated"):
        decode(Any, content)
    with pytest.raises(ValueError, match="recursion"):
        decode(Any, b"\x91" * 10**6)


@pytest.mark.parametrize("value", [object(), np.array([object()]), 1j])
def test_types_that_are_not_known_are_refused(value: Any) -> None:
    with pytest.raises(TypeError, match="cannot be encoded"):
        encode(value)


def test_fingerprints_tell_contents_apart() -> None:
    values = [inner(), inner(0.25), (inner(), 1), (inner(), 2), np.zeros(2), np.zeros((2, 1)), np.zeros(2, dtype=int)]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint(inner()) == fingerprint(inner())
    assert fingerprint(np.asfortranarray(np.arange(6.0).reshape(2, 3))) == fingerprint(np.arange(6.0).reshape(2, 3))
