"""Checkpoints: the filter goes on exactly; damage and other runs' checkpoints are refused."""

import tracemalloc
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from small_log import CAMERA, MAP, START, sightings

from localiser.documents import decode, encode, fingerprint
from localiser.errors import InputError
from localiser.filter import FilterState, Mcl, MclParameters, Odometry, step
from localiser.filter.scene import Scene, SeenImage
from localiser.geometry import Array, Increment
from localiser.observation import EdgeObservation, ObservationParameters, PlaceLandmarks
from localiser.storage.checkpoint import (
    FORMAT,
    Checkpoint,
    checkpoint_bytes,
    checkpoint_of,
    identity_of,
)

IDENTITY = {"map": "house", "mcl.particles": "50"}


def save(path: Path, state: FilterState, rng: np.random.Generator) -> None:
    path.write_bytes(checkpoint_bytes(state, rng, IDENTITY))


def load(path: Path, identity: dict[str, str] = IDENTITY) -> Checkpoint:
    return checkpoint_of(path.read_bytes(), path, identity)


def filter_state() -> FilterState:
    """Return a state in which nothing is as it is by default: one image located, one waiting."""
    observation = EdgeObservation(CAMERA, ObservationParameters())
    mcl, state = Mcl(MAP, observation, MclParameters(particles=50, start_particles=70)), FilterState()
    frame, _, later = sightings()
    rng = np.random.default_rng(1)
    for event in (START, Odometry(0, np.zeros(3)), frame, Odometry(10**8, np.array([0.0, -0.1, 0.02])), later):
        list(step(mcl, state, event, rng))
    assert state.waiting and state.seen is not None
    return state


def equal(one: Any, two: Any) -> bool:
    """Whether two values are the same to the last bit, the order of arrays in memory included."""
    if type(one) is not type(two):
        return False
    if isinstance(one, np.ndarray):
        same = one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
        return same and one.flags.c_contiguous == two.flags.c_contiguous and bool(two.flags.writeable)
    if is_dataclass(one):
        return all(equal(getattr(one, field.name), getattr(two, field.name)) for field in fields(one))
    if isinstance(one, (list, tuple, deque)):
        return len(one) == len(two) and all(map(equal, one, two))
    return bool(one == two)


def test_state_and_generator_come_back_to_the_last_bit(tmp_path: Path) -> None:
    state, rng = filter_state(), np.random.default_rng(7)
    rng.standard_normal(3)
    rng.integers(10, dtype=np.int32)  # leaves half of a draw for the next one
    save(tmp_path / "run", state, rng)
    loaded = load(tmp_path / "run")
    assert equal(loaded.state, state)
    assert (
        loaded.rng.integers(1000, size=5, dtype=np.int32).tolist()
        == rng.integers(1000, size=5, dtype=np.int32).tolist()
    )
    assert loaded.rng.standard_normal(5).tolist() == rng.standard_normal(5).tolist()


def test_every_field_of_the_state_is_in_the_file(tmp_path: Path) -> None:
    """Each field is set in turn, so that none is left out or filled by default."""
    full = filter_state()
    for name in (None, *(one.name for one in fields(FilterState))):
        changed = FilterState()
        if name is not None:
            setattr(changed, name, getattr(full, name))
        save(tmp_path / "run", changed, np.random.default_rng(0))
        assert equal(load(tmp_path / "run").state, changed), name


def test_memory_order_of_arrays_is_kept(tmp_path: Path) -> None:
    """Sums are rounded in the order of memory, so the order belongs to the state."""
    state = filter_state()
    for order in ("C", "F"):
        state.particles = replace(state.particles, columns=np.array(state.particles.columns, order=order))
        save(tmp_path / "run", state, np.random.default_rng(0))
        loaded = load(tmp_path / "run").state.particles
        assert loaded is not None and loaded.columns.flags.c_contiguous == (order == "C")


# -- what is refused --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("checkpoint") / "run"
    save(path, filter_state(), np.random.default_rng(0))
    return path


def test_checkpoint_of_another_run_is_refused_and_the_difference_named(saved: Path) -> None:
    with pytest.raises(InputError, match=r"run: mcl\.particles: expected 50, as the checkpoint .* found 60"):
        load(saved, IDENTITY | {"mcl.particles": "60"})
    with pytest.raises(InputError, match=r"map: expected house, .* found nothing"):
        load(saved, {"mcl.particles": "50"})
    with pytest.raises(InputError, match=r"camera: expected nothing, .* found front"):
        load(saved, IDENTITY | {"camera": "front"})


def test_identity_names_settings_and_parts() -> None:
    identity = identity_of({"seed": 3, "mcl": {"particles": 50}}, map=MAP.points)
    assert (identity["seed"], identity["mcl.particles"]) == ("3", "50")
    moved = identity_of({"seed": 3, "mcl": {"particles": 50}}, map=MAP.points + 1e-9)
    assert {name for name in identity if identity[name] != moved[name]} == {"map"}


def test_what_is_no_checkpoint(tmp_path: Path) -> None:
    old, other = b"localiser-checkpoint/3", "something else"
    for content, found in {b"": other, b"PK\x03\x04": other, old + b"\n": old.decode(), b"\n" * 5: other}.items():
        (tmp_path / "file").write_bytes(content)
        with pytest.raises(InputError, match=rf"file: expected a checkpoint \(localiser-checkpoint/4\), found {found}"):
            load(tmp_path / "file")


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_is_found(saved: Path, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(saved.read_bytes())
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    else:
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] ^= data.draw(st.integers(1, 255))
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(InputError):
        load(tmp_path / "file")


def sealed(body: bytes) -> bytes:
    """Return a checkpoint whose sum is right whatever it holds."""
    return f"{FORMAT}\n{sha256(body).hexdigest()}\n".encode() + body


def body_of(path: Path) -> bytes:
    return path.read_bytes().split(b"\n", 2)[2]


ODD = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 2**63), st.floats(), st.text(max_size=5), st.just([]), st.just({}),
    st.lists(st.integers(-1, 2**40), max_size=4), st.just(["<f8", [2**40, 2**40], "C", b"x"]),
    st.just(["|O", [1], "C", b"12345678"]), st.just(["<f8", [-1, 3], "F", b""]),
)  # fmt: skip


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_content_that_says_something_else_is_refused(saved: Path, tmp_path: Path, data: st.DataObject) -> None:
    """Also where the sum is right: any one value is replaced by another."""
    content = decode(Any, body_of(saved))
    node: Any = content
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = data.draw(st.sampled_from(keys))
        if not isinstance(node[key], (dict, list)) or not node[key] or data.draw(st.integers(0, 3)) == 0:
            break
        node = node[key]
    node[key] = data.draw(ODD)
    (tmp_path / "file").write_bytes(sealed(encode(content)))
    try:
        load(tmp_path / "file")
    except InputError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 1000


def test_state_with_other_fields_is_refused(saved: Path, tmp_path: Path) -> None:
    """A field that a later version adds would be filled by default, and one that it drops would be passed over."""
    content = decode(Any, body_of(saved))
    content[0] = "0" * 16
    (tmp_path / "file").write_bytes(sealed(encode(content)))
    with pytest.raises(InputError, match="expected a checkpoint that this version of the program made"):
        load(tmp_path / "file")


def test_sizes_are_checked_before_memory_is_taken(saved: Path, tmp_path: Path) -> None:
    content = decode(Any, body_of(saved))
    content[3]["particles"]["columns"][1] = [2**34]
    (tmp_path / "file").write_bytes(sealed(encode(content)))
    tracemalloc.start()
    with pytest.raises(InputError, match=r"expected an array of \[17179869184\] <f8, found"):
        load(tmp_path / "file")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20 * saved.stat().st_size + 2**20


def in_part(part: str, change: Callable[[Any], dict[str, Any]]) -> Callable[[FilterState], None]:
    """Return what replaces fields of one part of a state."""

    def apply(state: FilterState) -> None:
        setattr(state, part, replace(getattr(state, part), **change(getattr(state, part))))

    return apply


def short_pose(state: FilterState) -> None:
    state.odometry[0] = Odometry(0, np.zeros(2))


def last_image(state: FilterState, **changes: Any) -> None:
    """Keep the last image as a scene, with a motion since then of which something was changed."""
    assert state.seen is not None
    since = replace(Increment.from_mean([0.1, -0.2, 0.03], np.eye(3)), **changes)
    state.scene = Scene((SeenImage(state.seen, since),))


def test_a_motion_of_a_run_is_taken(tmp_path: Path) -> None:
    state = filter_state()
    last_image(state)
    save(tmp_path / "state", state, np.random.default_rng(1))
    assert equal(load(tmp_path / "state").state, state)


TWO, SCENES = np.array([1, 2]), np.full((2, 2), 0.5)
IMPOSSIBLE = {
    "a weight too few": in_part("particles", lambda cloud: {"log_weight": cloud.log_weight[1:]}),
    "far away": in_part("particles", lambda cloud: {"columns": np.where(cloud.columns == 0, 0.5, 1e300)}),
    "no weight": in_part("particles", lambda cloud: {"log_weight": np.full(len(cloud), -np.inf)}),
    "a pose of two numbers": short_pose,
    "a lean too few": in_part("seen", lambda seen: {"edges": replace(seen.edges, lean=seen.edges.lean[1:])}),
    "a motion of two numbers": lambda state: last_image(state, mean=np.zeros(2)),
    "a way of three numbers": lambda state: last_image(state, told=np.zeros(3)),
    "landmarks out of order": in_part("belief", lambda _: {"landmarks": PlaceLandmarks(TWO[::-1], SCENES, SCENES)}),
    "a scene too few": in_part("belief", lambda _: {"landmarks": PlaceLandmarks(TWO, SCENES[:1], SCENES)}),
    "a near scene too few": in_part("belief", lambda _: {"landmarks": PlaceLandmarks(TWO, SCENES, SCENES[:1])}),
}


@pytest.mark.parametrize("change", IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_a_state_that_no_run_can_have_saved_is_refused(tmp_path: Path, change: Callable[[FilterState], None]) -> None:
    """Its checksum is right: it was not damaged, but made."""
    state = filter_state()
    change(state)
    save(tmp_path / "state", state, np.random.default_rng(1))
    with pytest.raises(InputError, match="expected a checkpoint that this version of the program made; expected"):
        load(tmp_path / "state")


# -- typed data as bytes ----------------------------------------------------------------------------------------------


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
