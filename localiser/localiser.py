"""Localises one robot: the one object that replay, live, benchmarks and users of the library drive.

It finds the edges of images, runs the particle filter on them and on the poses of the wheels, and times both. All
checks of settings are here, so that replay and live refuse the same settings with the same words. The state, with the
random generator, can be saved and restored to the last bit.
"""

from __future__ import annotations

import math
import operator
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.camera import Camera, Mount
from localiser.config import Config, with_seed
from localiser.edges import Detector, Edges, find_edges
from localiser.errors import InputError
from localiser.filter import (
    Anywhere,
    Event,
    FilterState,
    Finding,
    Image,
    Level,
    Located,
    LocatedFrame,
    Markers,
    Mcl,
    Odometry,
    Sighting,
    Start,
    finish,
    step,
    track_of,
)
from localiser.filter import warm_up as warm_up_filter
from localiser.geometry import Array, Twist, finite_numbers
from localiser.landmarks import LandmarkMap
from localiser.markers import code_of
from localiser.motion import MotionModel
from localiser.observation import EdgeObservation, Observation
from localiser.relocalisation import GlobalLocalisation
from localiser.storage import check_start, check_whole, checkpoint_bytes, checkpoint_of, decoded, identity_of
from localiser.visual_odometry import Odometer

_LEAST_SIN = math.sin(math.radians(0.1))  # of a tilt with which slopes tell anything
_FARTHEST_ODOMETRY = 1e9  # as in files
_AT_NEXT = -(2**62)  # the time of a start that holds from the next measurement on


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredImage:
    """An image and its edges. image: pixels or file, as it was given. stage_ms: time of each step."""

    edges: Edges
    image: Image | None = None
    stage_ms: dict[str, float] = field(default_factory=lambda: {"load": 0.0, "edges": 0.0})


class Localiser:
    """Monte Carlo localisation of one robot in a known map, by the vertical edges of its images and by its wheels.

    `odometry`, `image`, `edges` and `measurement` take what was measured in the order of time, and `start` says where
    the robot is; without it the robot is looked for on the whole map. Each returns a list of the images that could be
    located now: an image is weighed once a pose of the wheels at its time or later is known, `finish` weighs the rest.
    Times are integer nanoseconds; poses are (x, z, heading) in metres and radians.

    camera: may be None with an observation of one's own that needs none. config.seed, or `seed` in its place, seeds the
    one random generator: same seed, same measurements, same results. observation, motion, detector: of one's own, in
    place of those that the configuration asks for; see docs/extending.md. An observation without global localisation
    needs a start.

    landmark_map: one, or several laid apart (`Site.beside`), which compete. Then poses are in the frame of the map that
    the robot is most likely on, `LocatedFrame.map_name`.

    rng: the generator. state: what changes during a run. markers: which are not where the map has them. Raises
    InputError for settings that do not fit the camera.
    """

    def __init__(
        self,
        landmark_map: LandmarkMap,
        camera: Camera | None = None,
        config: Config | None = None,
        seed: int | None = None,
        *,
        observation: Observation | None = None,
        motion: MotionModel | None = None,
        detector: Detector | None = None,
    ) -> None:
        self.landmark_map = landmark_map
        self.config = config = with_seed(config or Config(), seed)
        if not len(landmark_map):
            raise InputError("expected at least one landmark, found none", field="landmark_map")
        if observation is not None and not hasattr(observation, "log_likelihood"):
            found = type(observation).__name__
            raise InputError(f"expected a method `log_likelihood`, found {found} without one", field="observation")
        self._check = partial(check_settings, config, own_observation=observation is not None)
        self._check(camera)
        named = {code_of(one["identity"])[1] for one in landmark_map.extra if "identity" in one}
        if config.edges.markers and named - {config.edges.markers}:
            problem = f"expected {named.pop()!r}, of which the map has markers, found {config.edges.markers!r}"
            raise InputError(problem, field="edges.markers")
        self.rng, self.state = np.random.default_rng(self.config.seed), FilterState()
        self._camera, self._detector = camera, detector
        self._own = {"observation": observation, "motion": motion, "detector": detector}
        self.observation = observation or EdgeObservation(self.camera, config.observation)
        self._is_known, search = config.observation.association == "known" and observation is None, None
        if isinstance(self.observation, EdgeObservation) and not self._is_known:
            search = GlobalLocalisation.of(self.observation, landmark_map, config.search)
        motion = motion or config.motion
        self._mcl = Mcl(landmark_map, self.observation, config.mcl, motion, config.observation, search=search)
        if camera is not None:
            level = Level(camera, math.radians(config.edges.plumb_sigma_deg))
            self._mcl = replace(self._mcl, odometer=Odometer(camera, config.increments), level=level)
        self._measured: dict[int, MeasuredImage] = {}
        self._finding, self.markers = Finding.on(landmark_map), Markers()

    @property
    def camera(self) -> Camera:
        """The camera. Raises InputError where there is none."""
        if self._camera is None:
            raise InputError("expected a camera, found none: images need one", field="camera")
        return self._camera

    def warm_up(self, *, images: bool = True) -> None:
        """Compile all loops, or load them from the disk, so that no image has to wait; images: those for images too."""
        if isinstance(self.observation, EdgeObservation):
            self.observation.warm_up()
        warm_up_filter()
        if self._mcl.odometer is not None:
            self._mcl.odometer.warm_up()
        if images and self._camera is not None:
            blank = np.zeros((self.camera.height, self.camera.width), dtype=np.uint8)
            find_edges(blank, self.camera, self.config.edges)

    # -- measurements -------------------------------------------------------------------------------------------------

    def start(self, pose: ArrayLike, cov: ArrayLike, t_ns: int | None = None, map_name: str = "") -> list[LocatedFrame]:
        """Take where the robot is said to be: pose (3,) in the map, covariance (3, 3). Raises InputError.

        map_name: of several maps the one whose frame the pose is in; "" for the first.

        The position is within 100,000 km, sigmas are at most 1000 m and a whole turn, as in files and messages.

        t_ns: when; None for the time of the next measurement. What was believed before is forgotten. Images that wait
        for the wheels and were taken before the start are dropped; all that wait where t_ns is None.
        """
        at_ns = _AT_NEXT if t_ns is None else _nanoseconds(t_ns)
        mean = finite_numbers("pose", pose, (3,)) + self.landmark_map.origin(map_name)
        event = Start(at_ns, mean, _covariance(cov))
        try:
            check_start(event.mean, event.cov)
        except ValueError as error:
            raise InputError(str(error), field="start") from None
        self._drop_waiting(t_ns, found=True)
        return self._step(self._mcl, event)

    @property
    def can_look_everywhere(self) -> bool:
        """Whether a robot of which nothing is known can be looked for on the whole map."""
        return self._mcl.search is not None

    def look_everywhere(self, t_ns: int | None = None) -> list[LocatedFrame]:
        """Forget where the robot was believed to be, and look for it on the whole map. Raises InputError.

        t_ns: from when on, as for `start`.
        """
        if not self.can_look_everywhere:
            raise InputError("expected an observation that can look for the robot on the whole map; state a start")
        event = Anywhere(_AT_NEXT if t_ns is None else _nanoseconds(t_ns))
        self._drop_waiting(t_ns, found=False)
        return self._step(self._mcl, event)

    def _drop_waiting(self, t_ns: int | None, *, found: bool) -> None:
        """Begin anew: drop images that wait for the wheels and were taken before a time; all where it is None."""
        self._finding.begin(found=found)
        waiting = self.state.waiting
        while waiting and (t_ns is None or waiting[0].t_ns < t_ns):
            self._measured.pop(waiting.popleft().t_ns, None)

    def odometry(self, t_ns: int, pose: ArrayLike) -> list[LocatedFrame]:
        """Take a pose (3,) of the wheels in the odometry's own frame; only increments count. Raises InputError."""
        t_ns, pose = _nanoseconds(t_ns), finite_numbers("odometry", pose, (3,))
        if not (np.abs(pose) <= _FARTHEST_ODOMETRY).all():
            problem = f"expected a pose within ±{_FARTHEST_ODOMETRY:.0e} m and rad, found {pose.tolist()}"
            raise InputError(problem, field="odometry")
        wheels = self.state.odometry
        if wheels and t_ns <= wheels[-1].t_ns:
            raise InputError(f"expected a time after {wheels[-1].t_ns} ns, found {t_ns} ns", field="odometry")
        self._begin(t_ns)
        return self._step(self._mcl, Odometry(t_ns, pose))

    def image(
        self, t_ns: int, image: Image, mount: Mount | None = None, *, by_wheels: bool = True
    ) -> list[LocatedFrame]:
        """Take an image: find its edges, then do as `edges`. image: see `measure`.

        A camera whose shutter rolls should be given the wheels' poses up to the image's time before the image.
        """
        t_ns = _nanoseconds(t_ns)
        twist = self.camera.twist_at(track_of(self.state.odometry), t_ns) if self.camera.shutter else None
        return self.edges(t_ns, self.measure(image, mount, twist), mount, by_wheels=by_wheels)

    def measure(self, image: Image, mount: Mount | None = None, twist: Twist | None = None) -> MeasuredImage:
        """Return the edges of an image, for `edges` to take now or later. Changes nothing.

        image: (H, W) grey or (H, W, 3) BGR uint8, or a JPEG or PNG file's bytes. mount: of the camera when it took this
        image; None: as the camera says. twist: of the robot then, where the shutter rolls; see `Camera.twist_at`.
        Raises InputError when the image is damaged or of another size than the camera's, or cannot be mounted so.
        """
        self._check(self._camera and self._camera.at(valid_mount(mount)), images=True)
        begin = perf_counter()
        pixels = image
        if isinstance(pixels, bytes):
            size, name = (self.camera.width, self.camera.height), Path("image")
            check_whole(pixels, size, path=name)
            pixels = decoded(pixels, size, path=name)
        loaded = perf_counter()
        edges = find_edges(pixels, self.camera, self.config.edges, mount=mount, twist=twist, detector=self._detector)
        found = perf_counter()
        return MeasuredImage(edges, image, {"load": 1e3 * (loaded - begin), "edges": 1e3 * (found - loaded)})

    def edges(
        self, t_ns: int, edges: Edges | MeasuredImage, mount: Mount | None = None, *, by_wheels: bool = True
    ) -> list[LocatedFrame]:
        """Take the edges of an image. mount: see `measure`; None: as the edges say. Raises InputError.

        by_wheels: False where the wheels were silent until this image; then its edges alone tell how the robot moved,
        and it is located at once.
        """
        if not isinstance(edges, Edges | MeasuredImage):
            raise InputError(f"expected Edges, found {type(edges).__name__}", field="edges")
        t_ns = _nanoseconds(t_ns)
        measured = edges if isinstance(edges, MeasuredImage) else MeasuredImage(edges)
        if mount is not None:
            measured = replace(measured, edges=replace(measured.edges, mount=mount))
        found = measured.edges
        of_image = bool(found.profile.size and (found.landmark_id < 0).all())  # only images show grey values
        has_ends, started = bool(np.isfinite(found.ends_px).all()), self.state.is_begun
        camera = self._camera and self._camera.at(valid_mount(found.mount))
        self._check(camera, images=measured.image is not None or of_image, has_ends=has_ends, has_start=started)
        most, landmarks = int(found.landmark_id.max(initial=-1)), len(self.landmark_map)
        if self._is_known and most >= landmarks:
            problem = f"expected at most {landmarks - 1}, the map's last landmark, found {most}"
            raise InputError(problem, field="landmark_id")
        self._require_ready(t_ns, "image")
        self._measured[t_ns] = measured
        return self._step(self._mcl if by_wheels else self._mcl.by_edges(), Sighting(t_ns, measured.edges))

    def measurement(self, t_ns: int, measurement: ArrayLike) -> list[LocatedFrame]:
        """Take what an observation of one's own understands; it gets it as `Sighting.measurement`. Raises InputError.

        measurement: an array of numbers of any shape. Errors of consecutive measurements are taken to repeat over a
        distance of `observation.decorrelation_m`, as those of edges do; 0 where they are independent.
        """
        if self._own["observation"] is None:
            raise InputError("expected Localiser(…, observation=…), which understands it", field="measurement")
        t_ns = _nanoseconds(t_ns)
        try:
            numbers: NDArray[Any] = np.array(measurement)
        except ValueError:  # rows of different lengths
            numbers = np.array(None)
        if numbers.dtype.kind not in "fiub":
            raise InputError(f"expected an array of numbers, found {measurement!r}", field="measurement")
        self._check(images=False)
        self._require_ready(t_ns, "measurement")
        return self._step(self._mcl, Sighting(t_ns, measurement=numbers))

    def finish(self) -> list[LocatedFrame]:
        """Locate the images after the last pose of the wheels; the robot is taken to have stood still since then."""
        return self._located(finish(self._mcl, self.state, self.rng))

    # -- the state ----------------------------------------------------------------------------------------------------

    @property
    def identity(self) -> dict[str, str]:
        """What a saved state belongs to: every setting by its name, and fingerprints of map and camera.

        Observation, motion model and detector of one's own are told apart by the names of their classes.
        """
        camera = self._camera and replace(self._camera, name="")
        own = {f"own {part}": _name_of(one) for part, one in self._own.items() if one is not None}
        return identity_of(self.config.of_results(), map=self.landmark_map.without_remarks(), camera=camera) | own

    def save(self, shift_ns: int = 0) -> bytes:
        """Return the state and the generator, to go on with later. shift_ns: what is added to all times.

        Images and their timings are not part of it: of those that wait for the wheels the edges are. Neither is what an
        observation, a motion model or a detector of one's own keeps in itself.
        """
        state = self.state
        moved = replace(
            state,
            at_ns=state.at_ns if state.at_ns == _AT_NEXT else state.at_ns + shift_ns,
            odometry=deque(replace(pose, t_ns=pose.t_ns + shift_ns) for pose in state.odometry),
            waiting=deque(replace(sighting, t_ns=sighting.t_ns + shift_ns) for sighting in state.waiting),
        )
        return checkpoint_bytes(moved, self.rng, self.identity)

    def restore(self, content: bytes, path: Path | str = "state") -> None:
        """Go on from what `save` returned. path: what errors name.

        Raises InputError when the content is damaged, or was saved with other settings, another map or camera.
        """
        if not isinstance(content, bytes):
            raise InputError(f"expected the bytes of a saved state, found {type(content).__name__}", path=path)
        saved = checkpoint_of(content, Path(path), self.identity)
        belief, count = saved.state.belief, len(self.landmark_map)
        last = max(belief.landmarks.landmark, default=-1)
        if last >= count:
            raise InputError(f"expected {count} landmarks, found one with the index {last}", path=path)
        self.state, self.rng = saved.state, saved.rng
        self._finding.begin(found=saved.state.particles is not None)
        self._measured.clear()

    # -- steps --------------------------------------------------------------------------------------------------------

    def _step(self, mcl: Mcl, event: Event) -> list[LocatedFrame]:
        return self._located(step(mcl, self.state, event, self.rng))

    def _located(self, results: Iterator[Located]) -> list[LocatedFrame]:
        """Return what the filter locates, each with its matches, its image and the time that it took."""
        frames, begin = [], perf_counter()
        for result in results:
            located, wide_cov = self._finding.after(result)
            self.markers.after(located, self.landmark_map)
            measured = self._measured.pop(located.t_ns, None) or MeasuredImage(located.edges)
            stage_ms = measured.stage_ms | {"filter": 1e3 * (perf_counter() - begin)}
            frame = LocatedFrame(located, measured.image, None, stage_ms, wide_cov)
            frames.append(_in_frame_of_its_map(frame, self.landmark_map))
            begin = perf_counter()
        return frames

    def _require_ready(self, t_ns: int, name: str) -> None:
        """Raise InputError unless an image or a measurement, as `name` says, of this time can be taken."""
        if not self.state.is_begun and self._mcl.search is None:
            raise InputError("expected a start before the first measurement: it cannot be found on the whole map")
        self._begin(t_ns)
        state = self.state
        if (state.waiting and t_ns <= state.waiting[-1].t_ns) or (state.seen is not None and t_ns <= state.at_ns):
            raise InputError(f"expected a later time than that of the last {name}, found {t_ns} ns", field=name)
        if state.is_begun and t_ns < state.at_ns:
            raise InputError(f"expected a time after the start at {state.at_ns} ns, found {t_ns} ns", field=name)

    def _begin(self, t_ns: int) -> None:
        if self.state.at_ns == _AT_NEXT:
            self.state.at_ns = t_ns


# -- settings that cannot work ----------------------------------------------------------------------------------------


def check_settings(
    config: Config,
    camera: Camera | None = None,
    *,
    images: bool | None = None,
    has_ends: bool = False,
    has_start: bool = True,
    own_observation: bool = False,
) -> None:
    """Raise InputError when settings cannot work with what there is; None where that is not known yet.

    images: whether edges are found in images, or were measured elsewhere; has_ends: whether it is known then where
    they end in the image. has_start: whether it is known where the robot starts. own_observation: whether the
    observation is one's own, which observation.kind and observation.association do not concern.
    """
    known = config.observation.association == "known" and not own_observation
    slope = config.observation.kind == "slope" and not own_observation
    source = config.increments.source
    if known and images:
        raise InputError(
            "`known` believes edges that say which landmark they belong to, found images, whose edges do not; use "
            "--set observation.association=unknown",
            field="observation.association",
        )
    if known and not has_start:
        raise InputError(
            "`known` cannot look for a robot on the whole map; say where it starts", field="observation.association"
        )
    if source != "wheel" and images is False and not has_ends:
        raise InputError(
            f"`{source}` follows edges from image to image, found edges without images: bearings alone tell neither "
            "how far the robot went nor which edge is which; use --set increments.source=wheel",
            field="increments.source",
        )
    if slope and camera is not None and abs(math.sin(camera.mount.tilt_rad)) < _LEAST_SIN:
        raise InputError(
            f"the observation `slope` needs a tilted camera, found a tilt of {math.degrees(camera.mount.tilt_rad):g}°: "
            "without tilt every vertical edge is vertical in the image; use --set observation.kind=line",
            field="mount.tilt_deg",
        )


def valid_mount(mount: Mount | None) -> Mount | None:
    """Return the mount of an image, if a camera can be mounted so. Raises InputError."""
    if mount is None:
        return None
    if not isinstance(mount, Mount):
        raise InputError(f"expected a Mount, found {type(mount).__name__}", field="mount")
    values, sigmas = (asdict(part) if part else {} for part in (mount, mount.sigma))
    values.pop("sigma")
    for name, value in values.items():
        finite_numbers(f"mount.{name}", value, ())
    for name, sigma in sigmas.items():
        if sigma is not None and not finite_numbers(f"mount.sigma.{name}", sigma, ()) >= 0:
            raise InputError(f"expected a number of at least 0, found {sigma!r}", field=f"mount.sigma.{name}")
    if abs(mount.tilt_rad) >= math.pi / 2:
        raise InputError(f"expected a tilt within ±π/2, found {mount.tilt_rad!r}", field="mount.tilt_rad")
    if mount.height_m <= 0:
        raise InputError(f"expected a height above 0, found {mount.height_m!r}", field="mount.height_m")
    return mount


def _in_frame_of_its_map(frame: LocatedFrame, landmark_map: LandmarkMap) -> LocatedFrame:
    """Return a frame whose poses are in that of all maps with poses in that of the map which the estimate is on."""
    located, name = frame.located, landmark_map.map_at(frame.located.estimate.pose)
    if not name:
        return frame
    origin, clusters = landmark_map.origin(name), located.clusters
    mean, columns = located.estimate.mean.copy(), located.particles.columns.copy()
    mean[:3] -= origin
    columns[:3] -= origin[:, None]
    estimate, particles = replace(located.estimate, mean=mean), replace(located.particles, columns=columns)
    clusters = clusters and replace(clusters, mean=clusters.mean - origin)
    moved = replace(located, estimate=estimate, particles=particles, clusters=clusters)
    return replace(frame, located=moved, map_name=name)


def _name_of(own: object) -> str:
    kind = own if hasattr(own, "__qualname__") else type(own)
    return f"{kind.__module__}.{kind.__qualname__}"


def _nanoseconds(t_ns: int) -> int:
    """Return a time as an integer. Raises InputError."""
    try:
        found = operator.index(t_ns)
    except TypeError:
        found = _AT_NEXT
    if abs(found) >= -_AT_NEXT:
        raise InputError(f"expected an integer of nanoseconds, found {t_ns!r}", field="t_ns")
    return found


def _covariance(cov: ArrayLike) -> Array:
    """Return a covariance (3, 3), which may be singular. Raises InputError."""
    found = finite_numbers("cov", cov, (3, 3))
    variances = np.linalg.eigvalsh(found)
    asymmetry = np.abs(found - found.T).max()
    if asymmetry > 1e-9 * np.abs(found).max() or variances[0] < -1e-12 * abs(variances[-1]):
        raise InputError(f"expected a symmetric matrix without negative eigenvalues, found {cov!r}", field="cov")
    return found
