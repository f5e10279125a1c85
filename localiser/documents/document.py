"""A document: plain data in which every value knows where it was written; parsed from YAML, validated as a model."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BeforeValidator, TypeAdapter, ValidationError

from localiser.documents.files import read_text
from localiser.errors import InputError, one_paragraph

Key = tuple[str | int, ...]
Model = TypeVar("Model")
LONGEST_NAME = 200
_NO_MARKS = str.maketrans("<>|`", "____")

_MAX_DEPTH = 40
MOST_VALUES = 1_500_000  # each takes some 600 bytes of memory while a document is read
_MAX_DIGITS = 100
_LARGEST = 2**63
_FLOAT = "tag:yaml.org,2002:float"
_NUMBERS = _FLOAT, "tag:yaml.org,2002:int"
_EXPONENT = re.compile(r"^[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$")


def _with_exponents(base: type[Any]) -> type[Any]:
    """Return a loader or dumper to which 1e-3 is a number; YAML 1.1 takes it for a text for want of a point."""
    made = type(base.__name__, (base,), {})
    made.add_implicit_resolver(_FLOAT, _EXPONENT, list("-+.0123456789"))  # type: ignore[attr-defined]
    return made


_Dumper = _with_exponents(getattr(yaml, "CSafeDumper", yaml.SafeDumper))
_Loader = _with_exponents(getattr(yaml, "CSafeLoader", yaml.SafeLoader))


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
    value = _encodable(value)
    if isinstance(value, dict) and value:
        return "".join(_dumped({key: part}, isinstance(part, (dict, list))) for key, part in value.items())
    return _dumped(value, True)


def _dumped(value: Any, compact: bool) -> str:
    flow = None if compact else False
    text: str = yaml.dump(
        value, None, _Dumper, sort_keys=False, default_flow_style=flow, allow_unicode=True, width=2**31 - 1
    )
    return text


def plain_name(name: str) -> str:
    """Return a name from a file or a network as text that is nothing else, wherever it is shown: cleaned, 200 long.

    What a terminal would act on is escaped; what HTML and Markdown would, and a formula's first sign, becomes _.
    """
    line = one_paragraph(name[: 2 * LONGEST_NAME]).translate(_NO_MARKS)
    line = f"_{line[1:]}" if line[:1] in ("=", "+", "-", "@") else line
    return line if len(line) <= LONGEST_NAME else line[: LONGEST_NAME - 1] + "…"


is_name = BeforeValidator(lambda name: plain_name(name) if isinstance(name, str) else name)
"""Said of a field of a file: `Annotated[str, is_name]`."""


def _encodable(value: Any) -> Any:
    if isinstance(value, str):
        return value if value.isascii() else value.encode(errors="backslashreplace").decode()
    if isinstance(value, dict):
        return {_encodable(key): _encodable(part) for key, part in value.items()}
    return [_encodable(part) for part in value] if isinstance(value, (list, tuple)) else value


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
        if not isinstance(event, yaml.SequenceStartEvent):
            return self._scalar(key, event)
        parts: list[Any] = []
        while not isinstance(event := self._loader.get_event(), yaml.SequenceEndEvent):
            parts.append(self._value((*key, len(parts)), event))
        return parts

    def _mapping(self, key: Key) -> dict[Any, Any]:
        mapping: dict[Any, Any] = {}
        while not isinstance(event := self._loader.get_event(), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                raise self._place(event).error(key, "expected a name as key, found a list or a mapping")
            name = self._scalar(key, event)
            if type(name) in (int, float):  # which can be chosen so that they collide
                problem = f"expected a name as key, found {event.value!r}, which needs quotes"
                raise self._place(event).error(key, problem)
            if name in mapping:
                raise self._place(event).error((*key, name), "given twice")
            self._places[(*key, name)] = self._place(event)
            mapping[name] = self._value((*key, name), self._loader.get_event())
        return mapping

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


_UNKNOWN_KEY = {"extra_forbidden", "unexpected_keyword_argument"}
_NOT_A_MAPPING = {"model_type", "dataclass_type", "dict_type", "model_attributes_type"}


def validate(document: Document, model: type[Model], build: Callable[[Any], Model] | None = None) -> Model:
    """Return the model (pydantic, or a dataclass) that the document describes.

    build: makes the model from plain data where that takes more than its own validation. Raises InputError for the
    first thing that is wrong, with its place; an unknown key gets the nearest known one.
    """
    adapter = TypeAdapter(model)
    schema = Schema(adapter)
    for key, value in items(document.value):
        # pydantic would take yes for 1; in YAML a bare yes, no, on or off is true or false.
        kinds = {one.get("type") for one in schema.at(key)} if isinstance(value, bool) else set()
        if kinds - {"null"} in ({"number"}, {"integer"}):
            raise document.error(key, f"expected a number, found {str(value).lower()}")
    try:
        return build(document.value) if build else adapter.validate_python(document.value)
    except ValidationError as error:
        raise _first_problem(document, error, schema) from None


def _first_problem(document: Document, error: ValidationError, schema: Schema) -> InputError:
    problems = error.errors(include_url=False)
    # A key that is misspelt is also one that is missing: say the former.
    problem = next((found for found in problems if found["type"] in _UNKNOWN_KEY), problems[0])
    key = _written_key(document.value, problem["loc"])
    if problem["type"] in _UNKNOWN_KEY:
        known = {name for one in schema.at(key[:-1]) for name in one.get("properties", {})}
        text = f"unknown key; {nearest(str(key[-1]), [*known])}"
    elif problem["type"].startswith("missing"):
        key = (*key, problem["loc"][-1])
        text = "expected a value, found nothing"
    elif problem["type"] in _NOT_A_MAPPING:
        text = f"expected keys and values, found {shown(problem['input'])}"
    elif problem["type"] == "too_short":
        text = f"expected at least {problem['ctx']['min_length']}, found {len(problem['input'])}"
    elif problem["type"] == "too_long" and isinstance(problem["input"], list):
        text = f"expected at most {problem['ctx']['max_length']}, found {len(problem['input'])}"
    else:
        text = _expectation(problem["msg"])
        text += "" if ", found" in text else f", found {shown(problem['input'])}"
    if len(problems) > 1:
        text += f" (and {len(problems) - 1} more)"
    return document.error(key, text)


def _written_key(value: Any, location: tuple[str | int, ...]) -> Key:
    """Return the part of a pydantic location that the document has; the rest are names of union members."""
    key: Key = ()
    for part in location:
        known = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
        if part in known:
            value = value[part]
            key = (*key, part)
    return key


def _expectation(message: str) -> str:
    """Return pydantic's message in the words of this project: expected …"""
    for start, ours in (("Input should be ", "expected "), ("Value error, ", "")):
        if message.startswith(start):
            return ours + message.removeprefix(start)
    return message[:1].lower() + message[1:]


def nearest(name: str, known: list[str]) -> str:
    """Return advice on an unknown name: the nearest known one, or all of them."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"the nearest known is {close[0]!r}" if close else f"known are {', '.join(sorted(known)) or 'none'}"


class Schema:
    """Looks things up in the JSON schema of a model; the schema is made when it is first needed."""

    def __init__(self, adapter: TypeAdapter[Any]) -> None:
        self._adapter = adapter

    @cached_property
    def _root(self) -> dict[str, Any]:
        return self._adapter.json_schema()

    def at(self, key: Key) -> list[dict[str, Any]]:
        """Return what the model takes at `key`: one schema, more for a union, none for a key that it does not know."""
        schemas = self._alternatives(self._root)
        for part in key:
            inner = (s.get("items") if isinstance(part, int) else s.get("properties", {}).get(part) for s in schemas)
            schemas = [found for schema in inner if isinstance(schema, dict) for found in self._alternatives(schema)]
        return schemas

    def _alternatives(self, schema: dict[str, Any]) -> list[dict[str, Any]]:
        """Return the schemas that `schema` stands for, references and unions resolved."""
        if "$ref" in schema:
            return self._alternatives(self._root["$defs"][schema["$ref"].rsplit("/", 1)[-1]])
        options = schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf")
        return [found for option in options for found in self._alternatives(option)] if options else [schema]
