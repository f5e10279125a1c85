"""Parse YAML text into a document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from localiser.documents.document import FLOAT_TAG, Document, Key, Place, shown, with_exponents
from localiser.documents.files import read_text
from localiser.errors import InputError

_MAX_DEPTH = 40
MOST_VALUES = 1_500_000  # each takes some 600 bytes of memory while a document is read
_MAX_DIGITS = 100
_LARGEST = 2**63
_NUMBERS = {FLOAT_TAG, "tag:yaml.org,2002:int"}
_Loader = with_exponents(getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def load(path: Path) -> Document:
    """Return the one YAML document of a file. Raises InputError."""
    return parse(read_text(path), str(path))


def parse(text: str, source: str) -> Document:
    """Return the one YAML document in `text`. `source` names the file or option in errors. Raises InputError.

    Plain data only: no tags, no aliases (a few lines of them can stand for gigabytes), no key twice.
    """
    try:
        return _Parser(text, source).document()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (None, None)
        problem = f"not valid YAML: {error.problem or error.context}"
        raise InputError(problem, path=source, line=line, column=column) from None
    except (yaml.YAMLError, UnicodeError) as error:
        raise InputError(f"not valid YAML: {' '.join(str(error).split())}", path=source) from None


class _Parser:
    """Builds a document from parser events, without recursion in the C library and never deeper than allowed."""

    def __init__(self, text: str, source: str) -> None:
        self._loader = _Loader(text)
        self._source = source
        self._places: dict[Key, Place] = {}

    def document(self) -> Document:
        self._loader.get_event()  # start of the stream
        if isinstance(self._loader.peek_event(), yaml.StreamEndEvent):
            return Document(None, {(): Place(self._source)})
        self._loader.get_event()  # start of the document
        value = self._value((), self._loader.get_event())
        self._loader.get_event()  # its end
        after = self._loader.get_event()
        if not isinstance(after, yaml.StreamEndEvent):
            raise self._place(after).error((), "expected one YAML document, found a second one")
        return Document(value, self._places)

    def _value(self, key: Key, event: Any) -> Any:
        self._places.setdefault(key, self._place(event))
        if isinstance(event, yaml.AliasEvent):
            raise self._place(event).error(key, "expected a value, found an alias, which is not supported")
        if event.tag is not None:
            raise self._place(event).error(key, f"expected plain data, found the tag {event.tag}")
        if len(key) > _MAX_DEPTH:
            raise self._place(event).error((), f"nested more than {_MAX_DEPTH} deep")
        if len(self._places) > MOST_VALUES:
            raise self._place(event).error((), f"expected at most {MOST_VALUES} values, found more")
        if isinstance(event, yaml.MappingStartEvent):
            return self._mapping(key)
        if isinstance(event, yaml.SequenceStartEvent):
            return self._sequence(key)
        return self._scalar(key, event)

    def _mapping(self, key: Key) -> dict[Any, Any]:
        mapping: dict[Any, Any] = {}
        while not isinstance(event := self._loader.get_event(), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                raise self._place(event).error(key, "expected a name as key, found a list or a mapping")
            name = self._scalar(key, event)
            if isinstance(name, (int, float)) and not isinstance(
                name, bool
            ):  # which can be chosen so that they collide
                raise self._place(event).error(
                    key, f"expected a name as key, found {event.value!r}, which needs quotes"
                )
            if name in mapping:
                raise self._place(event).error((*key, name), "given twice")
            self._places[(*key, name)] = self._place(event)
            mapping[name] = self._value((*key, name), self._loader.get_event())
        return mapping

    def _sequence(self, key: Key) -> list[Any]:
        items: list[Any] = []
        while not isinstance(event := self._loader.get_event(), yaml.SequenceEndEvent):
            items.append(self._value((*key, len(items)), event))
        return items

    def _scalar(self, key: Key, event: Any) -> Any:
        tag = self._loader.resolve(yaml.ScalarNode, event.value, event.implicit)
        if tag in _NUMBERS and len(event.value) > _MAX_DIGITS:
            raise self._place(event).error(key, f"expected a number of at most {_MAX_DIGITS} characters")
        try:
            value = self._loader.construct_object(yaml.ScalarNode(tag, event.value))
            if isinstance(value, int) and abs(value) >= _LARGEST:
                raise self._place(event).error(key, f"expected a whole number of at most 64 bits, found {event.value}")
            return value
        except (ValueError, OverflowError, yaml.constructor.ConstructorError):
            raise self._place(event).error(key, f"cannot be read as a value: {shown(event.value)}") from None

    def _place(self, event: Any) -> Place:
        return Place(self._source, event.start_mark.line + 1, event.start_mark.column + 1)
