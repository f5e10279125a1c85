"""Typed configuration: every parameter of the program, read from YAML and from the command line.

The parameters are defined next to the models that they belong to; this module combines them. Later values replace
earlier ones: the defaults, what a log asks for, the file given with --config, each --set.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter

from localiser import __version__, documents
from localiser.documents import Document, Place, Schema
from localiser.edges import BearingSensor, EdgeParameters
from localiser.errors import InputError
from localiser.filter import MclParameters
from localiser.mapping import MappingParameters
from localiser.motion import MotionParameters
from localiser.observation import ObservationParameters
from localiser.relocalisation import SearchParameters
from localiser.visual_odometry import VisualOdometryParameters

_LIBRARIES = ("numpy", "numba", "scipy", "opencv-python-headless", "pydantic", "rerun-sdk")
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


Endpoints = Annotated[tuple[str, ...], BeforeValidator(lambda given: [given] if isinstance(given, str) else given)]
MOST_DOMAIN = 232  # that ROS 2 allows


@dataclass(frozen=True, slots=True)
class LiveParameters:
    """How a live run takes part in a robot's network, and under which names. No pose depends on it."""

    connect: Annotated[
        Endpoints, Field(description="zenoh routers; the first that can be reached is used. None: tcp/127.0.0.1:7447")
    ] = ()
    listen: Annotated[
        Endpoints, Field(description="where others may connect; the program is then a zenoh router itself")
    ] = ()
    zenoh_config: Annotated[str, Field(description="file of zenoh's own configuration: TLS, passwords")] = ""
    domain: Annotated[
        int, Field(ge=-1, le=MOST_DOMAIN, description="domain of ROS 2; -1: the environment's ROS_DOMAIN_ID, or 0")
    ] = -1
    dds: Annotated[
        int, Field(ge=-1, le=MOST_DOMAIN, description="domain of DDS, which takes the place of zenoh; -1: zenoh")
    ] = -1
    interface: Annotated[
        str, Field(min_length=1, description="network interface for DDS; by lo nothing leaves this machine")
    ] = "lo"
    namespace: Annotated[
        str, Field(description="of topics and services that are named without a leading slash, such as robot1")
    ] = ""
    topics: Annotated[
        dict[str, str], Field(description="other names of what comes in, by kind, such as {image: /camera/image_raw}")
    ] = field(default_factory=dict)
    publish: Annotated[
        dict[str, str | None],
        Field(description="other names of what goes out, by kind, such as {pose: amcl_pose}; null for none"),
    ] = field(default_factory=dict)
    services: Annotated[dict[str, str | None], Field(description="other names of services, by kind; null for none")] = (
        field(default_factory=dict)
    )
    map_frame: Annotated[str, Field(min_length=1, description="name of the map's frame")] = "map"
    odom_frame: Annotated[str, Field(description="name of the odometry's frame; empty: as its messages have it")] = ""
    transform_tolerance_s: Annotated[
        float, Field(ge=0, le=10, description="how far transforms on /tf are post-dated, as by AMCL (s)")
    ] = 0.2
    use_sim_time: Annotated[bool, Field(description="take the time from /clock: of a simulator or a bag")] = False


class Config(BaseModel):
    """Everything that can be set. A section is the parameters of the module of that name."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, title="localiser configuration")

    seed: Annotated[int, Field(ge=0, lt=2**32, description="of the one random generator; same seed, same result")] = 0
    mcl: MclParameters = MclParameters()
    search: SearchParameters = SearchParameters()
    motion: MotionParameters = MotionParameters()
    increments: VisualOdometryParameters = VisualOdometryParameters()
    observation: ObservationParameters = ObservationParameters()
    edges: EdgeParameters = EdgeParameters()
    sensor: BearingSensor = BearingSensor()
    mapping: MappingParameters = MappingParameters()
    live: LiveParameters = LiveParameters()
    versions: Annotated[
        dict[str, str], Field(description="what wrote this file; read by people, not by the program")
    ] = {}

    def of_results(self) -> dict[str, Any]:
        """Return all settings that a pose may depend on."""
        return self.model_dump(exclude={"versions", "live"})


def read_config(
    path: Path | str | None = None, overrides: Iterable[str] = (), log_overrides: Mapping[str, Any] | None = None
) -> Config:
    """Return the configuration in force.

    path: a YAML file; what it leaves out is the default. overrides: texts `section.name=value`, later ones win.
    log_overrides: values that a log asks for, by their names `section.name`. Raises InputError, with file, line and
    column or with the option.
    """
    document = Document({}, {(): Place("")})
    for name, value in (log_overrides or {}).items():
        document = document.overlaid(_option("the log's own settings", name, Document(value, {(): Place("")})))
    if path is not None:
        document = document.overlaid(_file(Path(path)))
    for override in overrides:
        document = document.overlaid(_override(override))
    return documents.validate(document, Config)


def with_seed(config: Config, seed: int | None) -> Config:
    """Return the configuration with another seed, or as it is where that is None. Raises InputError."""
    if seed is None:
        return config
    return config.model_copy(update={"seed": documents.validate(Document({"seed": seed}, {}), Config).seed})


def _file(path: Path) -> Document:
    document = documents.load(path)
    if document.value is None:  # a file of comments changes nothing
        return Document({}, document.places)
    if not isinstance(document.value, dict):
        raise document.error((), f"expected sections and values, found {documents.shown(document.value)}")
    return document


def _override(text: str) -> Document:
    """Return the document that `section.name=value` stands for."""
    option = f"--set {text}"
    name, equals, value = text.partition("=")
    if not equals or not value.strip() or not all(part.strip() for part in name.split(".")):
        raise InputError("expected section.name=value", path=option)
    try:
        return _option(option, name, documents.parse(value, option))
    except InputError as error:
        raise InputError(error.problem, path=option) from None


def _option(source: str, name: str, document: Document) -> Document:
    """Return the document as the value at `name`; the place of all of it is the option as a whole."""
    if name.strip() not in Config.model_fields and "." not in name:
        sections = Config().model_dump()
        known = [
            f"{part}.{name.strip()}"
            for part, values in sections.items()
            if isinstance(values, dict) and name.strip() in values
        ]
        if known:
            raise InputError(f"unknown setting; did you mean {' or '.join(known)}?", path=source)
    whole = Document(document.value, {key: Place(source) for key in document.places})
    return whole.under(*(part.strip() for part in name.split(".")))


# -- writing ----------------------------------------------------------------------------------------------------------


def in_force(config: Config) -> Config:
    """Return the configuration with the versions of what runs it, to be kept with results."""
    found = {"localiser": __version__, "python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            continue
    return config.model_copy(update={"versions": found})


def to_yaml(config: Config, without: Iterable[str] = ()) -> str:
    """Return the configuration as YAML that `read_config` reads, each value with its meaning, unit and range.

    without: sections that are left out.
    """
    return "".join(_lines(config.model_dump(exclude=set(without)), (), Schema(TypeAdapter(Config)))).lstrip("\n")


def _lines(values: dict[str, Any], key: tuple[str, ...], schema: Schema) -> Iterable[str]:
    indent = "  " * len(key)
    for name, value in values.items():
        (found,) = schema.at((*key, name))
        section = isinstance(value, dict)
        if section and not value and not key:
            continue
        if section and not key:
            yield "\n"
        yield from (f"{indent}# {line}\n" for line in _meaning(found))
        if section and "properties" in found:
            yield f"{indent}{name}:\n"
            yield from _lines(value, (*key, name), schema)
        else:
            yield f"{indent}{documents.dump({name: value}).strip()}\n"


def _meaning(schema: dict[str, Any]) -> Iterable[str]:
    """Return what a comment says of a field or a section."""
    text = schema.get("description", "").strip().split("\n\n")[0].split("\n")
    bounds = [f"{sign} {schema[bound]}" for bound, sign in _BOUNDS.items() if bound in schema]
    if "enum" in schema:
        bounds = ["one of " + ", ".join(map(str, schema["enum"]))]
    text[-1] += f"; {', '.join(bounds)}" if bounds else ""
    return [line.strip() for line in text if line.strip()]
