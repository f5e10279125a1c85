"""The filter of a live run: edges of an image, the steps of Monte Carlo localisation, and who looks on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.config import Config
from localiser.edges import find_edges
from localiser.filter import FilterState, Located, LocatedFrame, Mcl, Odometry, Sighting, Start, matched, step
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.live.timeline import Frame
from localiser.localiser import filter_of
from localiser.observation import EdgeObservation
from localiser.replay import Sink
from localiser.storage import check_whole, decoded
from localiser.storage.bags import grey_image, image_file
from localiser.visual_odometry import Odometer

_SOURCE = Path("image")  # what errors name it


@dataclass(slots=True, eq=False)
class Filter:
    """Replay and live share `mcl`; what is special here is that wheels may be silent. sinks: who looks on."""

    camera: Camera
    landmark_map: LandmarkMap
    config: Config
    sinks: list[Sink]
    rng: np.random.Generator
    observation: EdgeObservation
    state: FilterState = field(default_factory=FilterState)
    _by_wheels: Mcl = field(init=False)
    _by_edges: Mcl = field(init=False)

    def __post_init__(self) -> None:
        self._by_wheels = filter_of(self.camera, self.landmark_map, self.observation, self.config)
        by_edges = Odometer(self.camera, replace(self.config.increments, source="vision"))
        self._by_edges = replace(self._by_wheels, odometer=by_edges)

    @property
    def needs_wheels(self) -> bool:
        """Whether an image waits for the wheels."""
        return self.config.increments.source != "vision"

    def warm_up(self) -> None:
        """Make what finding edges needs once for a camera."""
        find_edges(np.zeros((self.camera.height, self.camera.width), dtype=np.uint8), self.camera, self.config.edges)

    def start(self, start: Start) -> None:
        """Take where the robot is said to be."""
        list(step(self._by_wheels, self.state, start, self.rng))

    def find_edges(self, frame: Frame) -> None:
        """Decode an image and find its edges. Raises InputError or ValueError when it is damaged."""
        begin = perf_counter()
        size = (self.camera.width, self.camera.height)
        image: Any = grey_image(frame.message)
        if image is None:
            frame.file = image_file(frame.message)
            check_whole(frame.file, size, path=_SOURCE)
            image = decoded(frame.file, size, path=_SOURCE)
        loaded = perf_counter()
        frame.edges = find_edges(image, self.camera, self.config.edges)
        frame.stage_ms |= {"load": 1e3 * (loaded - begin), "edges": 1e3 * (perf_counter() - loaded)}
        if not frame.file:
            frame.pixels = image

    def weigh(self, frame: Frame, wheels: Iterable[Odometry]) -> Located:
        """Weigh an image whose edges are known, after the poses of the wheels until then."""
        assert frame.edges is not None
        begin = perf_counter()
        for pose in wheels:
            list(step(self._by_wheels, self.state, pose, self.rng))
        filter_ = self._by_wheels if frame.by_wheels else self._by_edges
        (located,) = step(filter_, self.state, Sighting(frame.t_ns, frame.edges), self.rng)
        frame.stage_ms["filter"] = 1e3 * (perf_counter() - begin)
        return located

    def show(self, frame: Frame, located: Located, truth: Array | None) -> None:
        """Hand a result to who looks on."""
        if self.sinks:
            matches = matched(self._by_wheels, located)
            shown = LocatedFrame(located, matches, frame.file or frame.pixels, truth, frame.stage_ms)
            for sink in self.sinks:
                sink.frame(shown)
