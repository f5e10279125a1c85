"""Store what ROS has no message for (name, start, settings of a log) as YAML in a std_msgs/String."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from localiser.camera import Camera, Mount, MountSigma
from localiser.documents import MAX_DOCUMENT_BYTES, Document, dump, is_name, parse
from localiser.errors import InputError
from localiser.storage.cameras import FileModel, ShutterFile, shutter_data, shutter_of
from localiser.storage.folder import StartFile, start_data
from localiser.storage.log import Log

FORMAT: Literal["localiser-bag/1"] = "localiser-bag/1"


class Label(BaseModel):
    """Name and settings of a log in a bag; see `LogFile`."""

    model_config = FileModel

    format: Literal["localiser-bag/1"]
    name: Annotated[str, Field(min_length=1), is_name]
    camera_name: Annotated[str, is_name] = ""
    start: StartFile | None = None
    motion: dict[str, Any] | None = None
    rolling_shutter: ShutterFile | None = None
    mount_sigma: dict[Literal["yaw_rad", "height_m", "right_m", "back_m"], float] | None = None
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
    if log.camera.shutter is not None:
        data["rolling_shutter"] = shutter_data(log.camera.shutter)
    if sigma := _mount_sigma(log):
        data["mount_sigma"] = sigma
    return dump(data)


def _mount_sigma(log: Log) -> dict[str, float]:
    """Return the sigmas of the mount that no message of ROS can state. Raises InputError unless all images share them.

    Those of tilt and roll stand beside the orientation of an inertial sensor.
    """
    found = {}
    mounts = [image.mount for image in log.images]
    for name in ("yaw_rad", "height_m", "right_m", "back_m"):
        stated: set[float | None] = {getattr(mount.sigma, name) if mount and mount.sigma else None for mount in mounts}
        if len(stated) > 1:
            problem = f"expected one sigma of the mount's {name} for all images, which is what a bag can hold"
            raise InputError(f"{problem}, found {len(stated)}", path=log.path, field="images")
        if (sigma := stated.pop() if stated else None) is not None:
            found[name] = float(sigma)
    return found


def with_sigma(mounts: Sequence[Mount | None], label: Label) -> Sequence[Mount | None]:
    """Return the mounts with the sigmas that the label states."""
    sigmas: dict[str, Any] = {str(name): sigma for name, sigma in (label.mount_sigma or {}).items()}
    if not sigmas:
        return mounts
    return [mount and replace(mount, sigma=replace(mount.sigma or MountSigma(), **sigmas)) for mount in mounts]


def labelled(camera: Camera, label: Label) -> Camera:
    """Return the camera with what no message of ROS says of it: its name, and how its shutter rolls."""
    stated = label.rolling_shutter
    if stated is not None and stated.stamp_row > camera.height - 1:
        raise InputError(
            f"expected a row of the image, 0 to {camera.height - 1}, found {stated.stamp_row:g}",
            field="rolling_shutter.stamp_row",
        )
    shutter = shutter_of(stated.row_time_us, stated.stamp_row) if stated and stated.row_time_us else camera.shutter
    return replace(camera, name=camera.name or label.camera_name, shutter=shutter)


def live_label_text(name: str, settings: Mapping[str, Any], topics: Mapping[str, str]) -> str:
    """Return the label of a live run as text: it starts where its decisions say, with these settings.

    topics: what it listens to, by what that is for.
    """
    return dump({"format": FORMAT, "name": name, "settings": dict(settings), "topics": dict(topics)})


def motion_settings(log: Log) -> dict[str, Any]:
    """Return what a log says of its robot's odometry, as a log folder names it."""
    return {name.removeprefix("motion."): value for name, value in log.settings.items() if name.startswith("motion.")}
