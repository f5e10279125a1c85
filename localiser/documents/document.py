"""A document: plain data in which every value knows where it was written."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml
from pydantic import BeforeValidator

from localiser.errors import InputError, one_paragraph

Key = tuple[str | int, ...]
LONGEST_NAME = 200
_NO_MARKS = str.maketrans("<>|`", "____")

FLOAT_TAG = "tag:yaml.org,2002:float"
_EXPONENT = re.compile(r"^[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$")


def with_exponents(base: type[Any]) -> type[Any]:
    """Return a loader or dumper to which 1e-3 is a number; YAML 1.1 takes it for a text for want of a point."""
    made = type(base.__name__, (base,), {})
    made.add_implicit_resolver(FLOAT_TAG, _EXPONENT, list("-+.0123456789"))  # type: ignore[attr-defined]
    return made


_Dumper = with_exponents(getattr(yaml, "CSafeDumper", yaml.SafeDumper))


@dataclass(frozen=True, slots=True)
class Place:
    """Where a value was written: a file or an option, and line and column from 1 where there are any."""

    source: str
    line: int | None = None
    column: int | None = None

    def error(self, key: Key, problem: str) -> InputError:
        """Return the error that says what is wrong with the value here, which is the one at `key`."""
        field = field_name(key) or None
        return InputError(problem, path=self.source or None, line=self.line, column=self.column, field=field)


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """Plain data (mappings, lists, scalars) and the place of every part, by its keys from the root; () is the root."""

    value: Any
    places: dict[Key, Place]

    def place(self, key: Key) -> Place:
        """Return the place of the value at `key`, or of the nearest part around it that was written."""
        while key not in self.places and key:
            key = key[:-1]
        return self.places.get(key, Place(""))

    def error(self, key: Key, problem: str) -> InputError:
        """Return the error that says what is wrong with the value at `key`."""
        return self.place(key).error(key, problem)

    def under(self, *key: str) -> Document:
        """Return the document in which this one is the value at `key`."""
        value = self.value
        for name in reversed(key):
            value = {name: value}
        root = self.place(())
        around = {key[:depth]: root for depth in range(len(key))}
        return Document(value, around | {key + inner: place for inner, place in self.places.items()})

    def overlaid(self, upper: Document) -> Document:
        """Return this document with what `upper` says instead, mapping by mapping; lists are replaced whole."""
        replaced = {key for key, value in items(upper.value) if not isinstance(value, dict)}
        kept = {
            key: place
            for key, place in self.places.items()
            if not any(key[:depth] in replaced for depth in range(1, len(key) + 1))
        }
        return Document(_merged(self.value, upper.value), upper.places | kept)


def field_name(key: Key) -> str:
    """Return `key` as a person writes it: landmarks[3].x."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{_plain(part)}" for part in key).removeprefix(".")


def _plain(name: str | int) -> str:
    """Return a key as it is if that is short and plain, else in quotes."""
    text = str(name)
    return text if len(text) <= 60 and text.replace("-", "_").isidentifier() else shown(text)


def _merged(lower: Any, upper: Any) -> Any:
    if not (isinstance(lower, dict) and isinstance(upper, dict)):
        return upper
    both = {key: _merged(lower[key], value) if key in lower else value for key, value in upper.items()}
    return lower | both


def items(value: Any, key: Key = ()) -> Iterator[tuple[Key, Any]]:
    """Yield every part of plain data with its keys, the root excepted."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, child in children:
        yield (*key, name), child
        yield from items(child, (*key, name))


def shown(value: Any, longest: int = 60) -> str:
    """Return a value as an error message shows it: short, on one line."""
    if value is None:
        return "nothing"
    text = value if isinstance(value, str) else repr(value)
    if isinstance(value, (dict, list)) and len(text) > longest:
        return f"a {'mapping' if isinstance(value, dict) else 'list'} of {len(value)}"
    shown = text if len(text) <= longest else text[:longest] + "…"
    return repr(shown) if isinstance(value, str) else shown


def dump(value: Any) -> str:
    """Return plain data as YAML: keys in the order given, innermost lists and mappings each on one line.

    Of a text, what UTF-8 cannot tell is written as its escape.
    """
    return _dumped(_encodable(value))


def _dumped(value: Any) -> str:
    if isinstance(value, dict) and value:
        return "".join(_dump({key: part}, isinstance(part, (dict, list))) for key, part in value.items())
    return _dump(value, True)


def plain_name(name: str) -> str:
    """Return a name from a file or a network as text that is nothing else, wherever it is shown: cleaned, 200 long.

    What a terminal would act on is escaped; what HTML and Markdown would, and a formula's first sign, becomes _.
    """
    line = one_paragraph(name[: 2 * LONGEST_NAME]).translate(_NO_MARKS)
    line = f"_{line[1:]}" if line[:1] in ("=", "+", "-", "@") else line
    return line if len(line) <= LONGEST_NAME else line[: LONGEST_NAME - 1] + "…"


is_name = BeforeValidator(lambda name: plain_name(name) if isinstance(name, str) else name)
"""Said of a field of a file: `Annotated[str, is_name]`."""


def _encodable_text(text: str) -> str:
    return text if text.isascii() else text.encode(errors="backslashreplace").decode()


def _encodable(value: Any) -> Any:
    if isinstance(value, str):
        return _encodable_text(value)
    if isinstance(value, dict):
        return {_encodable(key): _encodable(part) for key, part in value.items()}
    return [_encodable(part) for part in value] if isinstance(value, (list, tuple)) else value


def _dump(value: Any, compact: bool) -> str:
    text: str = yaml.dump(
        value,
        Dumper=_Dumper,
        sort_keys=False,
        default_flow_style=None if compact else False,
        allow_unicode=True,
        width=2**31 - 1,
    )
    return text
