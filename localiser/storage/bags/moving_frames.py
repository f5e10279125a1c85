"""Transforms that change with time, as `/tf` says them: the mount of a camera that moves on its robot."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Mount
from localiser.geometry import Array
from localiser.storage.bags.frames import (
    FLOOR_FRAME,
    MOST_FRAMES,
    FrameTree,
    Link,
    chain,
    links_of,
    mount_of,
    rotation_from_quaternion,
)

MOST_APART_S = 0.5
"""How far from an image the transforms may be that its mount is from."""
_NS = 1e9


class MovingFrames:
    """Transforms between named frames at many times. They are checked when they are asked for.

    neighbours: the frames beside each frame.
    """

    def __init__(self, kept: int | None = None, most: int = MOST_FRAMES) -> None:
        """Start with no frame. kept: how many times of each transform, the newest; None keeps all.

        most: how many transforms there may be at a time.
        """
        self._kept, self._most = kept, most
        self.neighbours: dict[str, dict[str, None]] = {}
        self._times: dict[Link, array[int]] = {}
        self._values: dict[Link, array[float]] = {}
        self._sorted: dict[Link, tuple[NDArray[np.int64], Array]] = {}

    def add_all(self, transforms: Sequence[Any], offset_ns: int = 0) -> None:
        """Add the transforms of a tf2_msgs/TFMessage, all or none; offset_ns: what is added to their stamps.

        Raises ValueError where there are too many.
        """
        links = links_of(transforms)
        if len(self._times) + len({link for link in links if link not in self._times}) > self._most:
            raise ValueError(f"expected at most {self._most} transforms between frames, found more")
        for link, stamped in zip(links, transforms, strict=True):
            stamp, moved, turned = stamped.header.stamp, stamped.transform.translation, stamped.transform.rotation
            if link not in self._times:
                for frame, neighbour in (link, link[::-1]):
                    self.neighbours.setdefault(frame, {})[neighbour] = None
            times, values = self._times.setdefault(link, array("q")), self._values.setdefault(link, array("d"))
            times.append(int(stamp.sec) * 10**9 + int(stamp.nanosec) + offset_ns)
            values.extend((moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w))
            if self._kept is not None and len(times) > 1.25 * self._kept:
                del times[: -self._kept], values[: -7 * self._kept]
        self._sorted.clear()

    def forget_times(self) -> None:
        """Forget how frames stood to each other, and not which of them do."""
        self._times, self._values = {link: array("q") for link in self._times}, {}
        self._sorted.clear()

    @property
    def links(self) -> Collection[Link]:
        """Parent and child of each transform."""
        return self._times.keys()

    def reaches(self, link: Link, t_ns: int) -> bool:
        """Whether a transform is known at a time or later."""
        return bool((self._of(link)[0][-1:] >= t_ns).any())

    def at(self, link: Link, t_ns: int) -> Array:
        """Return the transform (4, 4) at a time, between those before and after. Raises ValueError."""
        times, values = self._of(link)
        if not len(times):
            raise ValueError(f"expected transforms from {link[0]!r} to {link[1]!r}, found none")
        after = int(np.searchsorted(times, t_ns))
        first, last = max(after - 1, 0), min(after, len(times) - 1)
        apart_s = max(t_ns - times[first], times[last] - t_ns, key=abs) / _NS
        if abs(apart_s) > MOST_APART_S and times[first] != t_ns and times[last] != t_ns:
            raise ValueError(
                f"expected transforms from {link[0]!r} to {link[1]!r} within {MOST_APART_S} s of the image at "
                f"{t_ns} ns, found none for {abs(apart_s):.3g} s"
            )
        span = float(times[last] - times[first])
        share = float(np.clip((t_ns - times[first]) / span, 0.0, 1.0)) if span > 0 else 0.0
        moved = (1.0 - share) * values[first, :3] + share * values[last, :3]
        transform: Array = np.eye(4)
        transform[:3, :3] = rotation_from_quaternion(*_between(values[first, 3:], values[last, 3:], share))
        transform[:3, 3] = moved
        return transform

    def _of(self, link: Link) -> tuple[NDArray[np.int64], Array]:
        if link not in self._sorted:
            times = np.array(self._times[link], dtype=np.int64)
            values = np.array(self._values.get(link, ())).reshape(-1, 7)
            order = np.argsort(times, kind="stable")
            self._sorted[link] = times[order], values[order]
        return self._sorted[link]


def _between(one: Array, other: Array, share: float) -> Array:
    """Return the quaternion on the great circle between two, by the share of the way."""
    cos = float(one @ other)
    other, cos = (other, cos) if cos >= 0 else (-other, -cos)
    angle = math.acos(min(cos, 1.0))
    if angle < 1e-6:
        return (1.0 - share) * one + share * other
    weights = math.sin((1.0 - share) * angle) / math.sin(angle), math.sin(share * angle) / math.sin(angle)
    return np.asarray(weights[0] * one + weights[1] * other)


def way(fixed: FrameTree, moving: MovingFrames, base: str, optical: str) -> tuple[FrameTree, list[Link]]:
    """Return the transforms that the mount is made of: those that are fixed, and which of those that move.

    It moves where the camera does on its robot, or the robot's frame on its footprint, as that of a robot that leans.
    fixed: transforms that do not change; they come first where both join the frames.
    """
    on_way: list[Link] = []
    used: list[Link] = []
    for start, end in ((base, optical), (FLOOR_FRAME, base)):
        steps = fixed.chain(start, end)
        if not steps:
            steps = chain([fixed.neighbours, moving.neighbours], start, end) or []
            used += [link for step in steps for link in (step, step[::-1]) if link in moving.links]
        on_way += steps
    return fixed.part(on_way), list(dict.fromkeys(used))


def mount_at(
    fixed: FrameTree, moving: MovingFrames, links: Sequence[Link], base: str, optical: str, t_ns: int
) -> Mount:
    """Return the mount at a time; fixed, links: see `way`. Raises ValueError.

    Where the robot's frame leans over its footprint, the mount is that on the footprint, which is level.
    """
    tree = at_time(fixed, moving, links, t_ns)
    leans = FLOOR_FRAME in tree and not (FLOOR_FRAME in fixed and fixed.chain(FLOOR_FRAME, base))
    return mount_of(tree, FLOOR_FRAME if leans and links else base, optical)


def at_time(fixed: FrameTree, moving: MovingFrames, links: Sequence[Link], t_ns: int) -> FrameTree:
    """Return the fixed transforms, and those that move as they were at a time. Raises ValueError."""
    tree = fixed.copy()
    for parent, child in links:
        tree.add(parent, child, moving.at((parent, child), t_ns))
    return tree
