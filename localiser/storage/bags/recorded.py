"""What a log or a live run says of itself in a bag, as texts: ROS has no message for it.

A label (name, start, settings) is YAML. A decision is a line of JSON, recorded after the message that it is about, so
that a replay of the recording uses the same messages as the run. Messages are named by their number: how many of their
topic were recorded before them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field

from localiser.camera import Camera, Mount, MountSigma
from localiser.documents import MAX_DOCUMENT_BYTES, Document, dump, is_name, parse
from localiser.errors import InputError
from localiser.filter import Anywhere, Start
from localiser.storage.bags.frames import check_start
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


_LAST_NS = 2**62
_MOST = 10**8  # messages of a topic; larger numbers could be chosen to fall into one place of a set


def image_decision(number: int, t_ns: int, unused: str = "", *, by_wheels: bool = True) -> str:
    """Return that an image was weighed, or why not. t_ns: its time, by which people find it.

    by_wheels: whether the wheels told how the robot came there, or its edges had to, because the wheels were silent.
    """
    data: dict[str, Any] = {"image": number, "t_ns": t_ns, "used": not unused}
    data |= {"why": unused} if unused else {}
    return json.dumps(data | ({} if by_wheels else {"by_wheels": False}))


def odometry_decision(number: int, t_ns: int, why: str) -> str:
    """Return why a pose of the wheels was not used; all others were."""
    return json.dumps({"odometry": number, "t_ns": t_ns, "used": False, "why": why})


def clock_decision(offset_ns: int) -> str:
    """Return what is added to all stamps from here on, because the robot's clock has jumped."""
    return json.dumps({"clock": offset_ns})


def start_decision(start: Start) -> str:
    """Return that the filter was started, exactly as it was."""
    return json.dumps({"start": start.t_ns, "mean": start.mean.tolist(), "cov": start.cov.tolist()})


def anywhere_decision(t_ns: int | None = None) -> str:
    """Return that the robot was looked for on the whole map: at the beginning, or from a later time on."""
    return json.dumps({"start": None} if t_ns is None else {"anywhere": t_ns})


@dataclass(slots=True, eq=False)
class Decisions:
    """The decisions of a recording, taken in their order.

    images, unused_odometry: by number. blind: images that were weighed without wheels. starts: the first is None where
    the robot was looked for. offset_ns: what to add to the stamps that are read now. any: whether
    there is any decision at all.
    """

    images: set[int] = field(default_factory=set)
    blind: set[int] = field(default_factory=set)
    unused_odometry: set[int] = field(default_factory=set)
    starts: list[Start | Anywhere | None] = field(default_factory=list)
    offset_ns: int = 0
    any: bool = False

    def take(self, text: str) -> None:
        """Take one decision. Raises ValueError."""
        self.any = True
        try:
            data = json.loads(text)
        except RecursionError as error:
            raise ValueError("expected a decision") from error
        match data:
            case {"image": int(number), "used": bool(used)} if 0 <= number < _MOST:
                if used:
                    self.images.add(number)
                if data.get("by_wheels") is False:
                    self.blind.add(number)
            case {"odometry": int(number), "used": False} if 0 <= number < _MOST:
                self.unused_odometry.add(number)
            case {"clock": int(offset_ns)} if abs(offset_ns) < _LAST_NS:
                self.offset_ns = offset_ns
            case {"start": int(t_ns)} if 0 <= t_ns < _LAST_NS:
                self.starts.append(_start(t_ns, data))
            case {"anywhere": int(t_ns)} if 0 <= t_ns < _LAST_NS and self.starts:
                self.starts.append(Anywhere(t_ns))
            case {"start": None} if not self.starts:
                self.starts.append(None)
            case _:
                raise ValueError("expected a decision on an image, odometry, the clock or a start")


def _start(t_ns: int, data: Mapping[str, Any]) -> Start:
    mean, cov = (np.array(data.get(name), dtype=np.float64) for name in ("mean", "cov"))
    if mean.shape != (3,) or cov.shape != (3, 3) or not (np.isfinite(mean).all() and np.isfinite(cov).all()):
        raise ValueError("expected a start of a pose and its covariance")
    check_start(mean, cov)
    return Start(t_ns, mean, cov)
