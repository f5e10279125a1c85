"""Store what ROS has no message for (name, start, settings of a log) as YAML in a std_msgs/String."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from localiser.documents import MAX_DOCUMENT_BYTES, Document, dump, parse
from localiser.storage.cameras import FileModel
from localiser.storage.folder import StartFile, start_data
from localiser.storage.log import Log

FORMAT: Literal["localiser-bag/1"] = "localiser-bag/1"


class Label(BaseModel):
    """Name and settings of a log in a bag; see `LogFile`."""

    model_config = FileModel

    format: Literal["localiser-bag/1"]
    name: Annotated[str, Field(min_length=1, max_length=200)]
    camera_name: Annotated[str, Field(max_length=200)] = ""
    start: StartFile | None = None
    motion: dict[str, Any] | None = None
    settings: dict[str, Any] | None = None  # everything that a live run was set to, by names such as `mcl.particles`
    topics: dict[str, str] | None = None  # what a live run listened to, by what it is for, such as `image`


def document_of(text: str, source: str) -> Document:
    """Return the YAML document that a message holds. Raises InputError; ValueError when it is too long."""
    if len(text) > MAX_DOCUMENT_BYTES:
        raise ValueError(f"expected at most {MAX_DOCUMENT_BYTES} characters, found {len(text)}")
    return parse(text, source)


def label_text(log: Log) -> str:
    """Return the label of a log as text."""
    data: dict[str, Any] = {"format": FORMAT, "name": log.name, "camera_name": log.camera.name}
    if log.start is not None:
        data["start"] = start_data(log.start)
    if motion := motion_settings(log):
        data["motion"] = motion
    return dump(data)


def live_label_text(name: str, settings: Mapping[str, Any], topics: Mapping[str, str]) -> str:
    """Return the label of a live run as text: it starts where its decisions say, with these settings.

    topics: what it listens to, by what that is for.
    """
    return dump({"format": FORMAT, "name": name, "settings": dict(settings), "topics": dict(topics)})


def motion_settings(log: Log) -> dict[str, Any]:
    """Return what a log says of its robot's odometry, as a log folder names it."""
    return {name.removeprefix("motion."): value for name, value in log.settings.items() if name.startswith("motion.")}
