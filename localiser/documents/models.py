"""Validate a document as a typed model. An error names file, line, column and field."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from localiser.documents.document import Document, Key, items, load, shown
from localiser.errors import InputError

Model = TypeVar("Model")

_UNKNOWN_KEY = {"extra_forbidden", "unexpected_keyword_argument"}
_NOT_A_MAPPING = {"model_type", "dataclass_type", "dict_type", "model_attributes_type"}


def read_model(path: Path, model: type[Model], build: Callable[[Any], Model] | None = None) -> Model:
    """Return the model (pydantic, or a dataclass) that a YAML file describes; see `validate`. Raises InputError."""
    return validate(load(path), model, build)


def validate(document: Document, model: type[Model], build: Callable[[Any], Model] | None = None) -> Model:
    """Return the model that the document describes.

    build: makes the model from plain data where that takes more than its own validation; raises
    pydantic.ValidationError.

    Raises InputError for the first thing that is wrong, with its place; an unknown key gets the nearest known one.
    """
    adapter = TypeAdapter(model)
    schema = Schema(adapter)
    for key, value in items(document.value):
        # pydantic would take yes for 1; in YAML a bare yes, no, on or off is true or false.
        if isinstance(value, bool) and schema.kind(key) in ("number", "integer"):
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
        text = f"unknown key; {nearest(str(key[-1]), schema.names(key[:-1]))}"
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

    def names(self, key: Key) -> list[str]:
        """Return the keys that the model knows at `key`."""
        return sorted({name for schema in self.at(key) for name in schema.get("properties", {})})

    def kind(self, key: Key) -> str | None:
        """Return the JSON type that the model wants at `key`, None when there are several or none."""
        kinds = {schema.get("type") for schema in self.at(key)} - {"null"}
        return kinds.pop() if len(kinds) == 1 else None

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
