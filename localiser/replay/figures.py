"""What a run comes to: its metrics, and what it was made from."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser import evaluate
from localiser.calibration import check_mount, clock_offset
from localiser.documents import dump, fingerprint
from localiser.edges import DARK_GREY, WASHED_OUT, Edges, Light
from localiser.evaluate import Track
from localiser.filter import LocatedFrame, Sighting, Start
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.localiser import Localiser
from localiser.particles import POSE
from localiser.replay.frames import KeptFrames
from localiser.storage import Log, jump_text

CLOCK_PAIRS = 60  # of images, for the offset of the clocks: about a second of computing
BADLY_LIT = 0.1  # fraction of the images from which on their light is told
SILENT_NS = 1_000_000_000  # without odometry, though images come
STAGES = ("load", "edges", "filter", "sinks")
_SHORT = 6
"""As many digits of a fingerprint tell two maps, or two sets of settings, apart."""

_WITH_A_WORD = ("observation.kind", "observation.association", "increments.source", "mcl.particles", "seed", "map")
WRONG_IMAGES = 3  # in which the wheels contradict the images, from which on that is told


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """What is wanted of all T images of a run at once.

    track: of poses in the frame of all maps. warnings, reasons, wheels_are_wrong, took_over, edges_known: (T,) as the
    filter had them, and whether an edge's landmark was known. landmark_use: (L, 2) in how many images each landmark of
    the map was in view, and in how many matched.
    """

    track: Track
    warnings: list[str]
    reasons: list[str]
    wheels_are_wrong: NDArray[np.bool_]
    took_over: NDArray[np.bool_]
    edges_known: NDArray[np.bool_]
    landmark_use: Array

    @classmethod
    def of(cls, frames: Sequence[LocatedFrame], landmark_map: LandmarkMap) -> Summary:
        """Return the summary of images, which are gone through once. landmark_map: of L landmarks."""
        count, use = len(frames), np.zeros((len(landmark_map), 2))
        t_ns, known, wrong, found, took_over = np.empty(count, np.int64), *np.empty((4, count), bool)
        poses, covs, odometry = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, 3))
        numbers, residuals = np.empty((count, 3)), np.empty((count, 3))
        warnings, reasons = [], []
        for i, frame in enumerate(frames):
            located, landmark = frame.located, frame.matches.landmark
            use[:, 0] += frame.matches.visible
            use[np.unique(landmark[landmark >= 0]), 1] += 1
            t_ns[i], covs[i] = located.t_ns, frame.pose_cov
            poses[i] = located.estimate.pose + landmark_map.origin(frame.map_name)
            found[i], took_over[i] = frame.is_found, located.took_over
            odometry[i], residuals[i] = located.odometry, evaluate.residual_sums(frame.matches)
            numbers[i] = len(located.edges), (landmark >= 0).sum(), located.p_correct
            known[i], wrong[i] = (located.edges.landmark_id >= 0).any(), located.wheels_are_wrong
            warnings.append(sys.intern(located.warning))
            reasons.append(sys.intern(located.reason))
        edges, matched, p_correct = numbers.T.copy()
        track = Track(t_ns, poses, covs, odometry, edges, matched, p_correct, residuals, found)
        return cls(track, warnings, reasons, wrong, took_over, known, use)

    @property
    def sighted(self) -> NDArray[np.bool_] | None:
        """Whether (T,) a landmark was seen, where the log tells which; None where it does not."""
        return self.edges_known if self.edges_known.any() else None


@dataclass(frozen=True, eq=False)
class Results:
    """A log that is replayed, and what was located until now.

    localiser: as it was made for this run; it has the map, which was read from `map_files` where there are any, and the
    settings. start: None where nothing is said of it. frames: without images and particles, in a temporary file
    where there are many. light: how every fifth image is exposed. timing: what each of them took (ms), by stage.
    """

    log: Log
    localiser: Localiser
    start: Start | None
    map_files: Sequence[Path] = ()
    frames: KeptFrames = field(default_factory=KeptFrames)
    light: list[Light] = field(default_factory=list)
    _summaries: dict[int, Summary] = field(default_factory=dict)
    timing: dict[str, list[float]] = field(default_factory=lambda: {stage: [] for stage in STAGES})

    @cached_property
    def identity(self) -> dict[str, str]:
        """Every setting by its name, and fingerprints of map, camera and log; images are not read for it."""
        log = self.log
        frames = [frame if isinstance(frame, Sighting) else frame.t_ns for frame in log.frames]
        return self.localiser.identity | {"log": fingerprint((log.name, log.odometry, log.groundtruth, frames))}

    def edges_of(self, index: int) -> Edges:
        """Return the edges of an image by its index."""
        frame: LocatedFrame = self.frames[index]
        return frame.located.edges

    @property
    def track(self) -> Track:
        """The run so far."""
        return self.summary.track

    @property
    def summary(self) -> Summary:
        """What is wanted of all images so far at once."""
        if len(self.frames) not in self._summaries:
            self._summaries.clear()
            self._summaries[len(self.frames)] = Summary.of(self.frames, self.localiser.landmark_map)
        return self._summaries[len(self.frames)]

    @property
    def metrics(self) -> dict[str, Any]:
        """The figures of the run so far, as `metrics.json` has them."""
        return run_metrics(self)


def run_metrics(run: Results) -> dict[str, Any]:
    """Return the metrics of a run and what it learnt of wheels and camera."""
    summary, last = run.summary, run.frames[-1].located.estimate
    figures = evaluate.metrics(
        summary.track,
        truth_of(run),
        log=run.log.name,
        about=about(run),
        sighted=summary.sighted,
        reasons=summary.reasons,
        distance_scale=float(last.mean[last.names.index("distance_scale")]) if "distance_scale" in last.names else 0.0,
    )
    mount, warnings = _mount(run)
    height, height_warnings = _height(run)
    if not warnings:  # a tilt that is wrong makes the height wrong, too
        warnings += height_warnings
    clock, clock_warnings = _clock(run)
    warnings += clock_warnings + _light_warnings(run) + _filter_warnings(run) + _silence_warnings(run)
    warnings += run.localiser.markers.warnings(run.localiser.landmark_map)
    if run.localiser.config.increments.source != "vision" and (jumped := jump_text(run.log)):
        warnings.append(jumped)
    in_view, matched = (summary.landmark_use > 0).T
    figures |= {"biases": _constants(run), "warnings": warnings} | mount | height
    figures |= {"map_sigma_factor": round(run.frames[-1].located.map_error.scale, 6)} | clock
    counts = {"known": len(in_view), "in_view": int(in_view.sum()), "matched": int(matched.sum())}
    return figures | {"landmarks": counts}


def truth_of(run: Results) -> Trajectory | None:
    """Return the truth, None where there is none or the run ended before it begins."""
    truth = run.log.groundtruth
    return truth if truth is not None and any(map(truth.covers, run.track.t_ns.tolist())) else None


def _constants(run: Results) -> dict[str, Any]:
    """Return value and sigma of what the run has learnt of its wheels."""
    estimate = run.frames[-1].located.estimate
    learnt = list(zip(estimate.names, estimate.mean.tolist(), np.sqrt(np.diag(estimate.cov)).tolist(), strict=True))
    return {
        name: {"value": round(value, 6), "sigma": round(sigma, 6)}
        for name, value, sigma in learnt[len(POSE) :]
        if sigma > 1e-9  # of what can be wrong
    }


def _filter_warnings(run: Results) -> list[str]:
    """Return what the filter said of the map, and when it went on without the wheels, as texts for people."""
    texts, warnings, seconds = [], run.summary.warnings, run.track.seconds
    if told := [index for index, warning in enumerate(warnings) if warning]:
        texts.append(
            f"{warnings[told[0]].capitalize()}: the images show other edges than it has, in {len(told)} of "
            f"{len(warnings)} images, for the first time after {seconds[told[0]]:.1f} s. Is it of this building?"
        )
    if (jumped := run.summary.took_over).any():
        texts.append(
            f"{jumped.sum()}× another place fitted better than the one that was believed, first after "
            f"{seconds[jumped][0]:.1f} s: the pose jumped there."
        )
    wrong = run.summary.wheels_are_wrong
    if wrong.sum() >= WRONG_IMAGES:
        first, last = seconds[np.flatnonzero(wrong)[[0, -1]]]
        texts.append(
            f"The wheels contradict the images in {wrong.sum()} of {len(wrong)} images, the first after {first:.1f} s "
            f"and the last after {last:.1f} s: do they slip, stand still or fall silent? There the edges alone were "
            "followed."
        )
    return texts


def _silence_warnings(run: Results) -> list[str]:
    """Return when the odometry fell silent while images came, as a text for people."""
    if run.localiser.config.increments.source == "vision":
        return []
    wheels, images = run.log.odometry.t_ns, run.track.t_ns
    begins, ends = wheels[:-1], wheels[1:]
    images_inside = np.searchsorted(images, ends) - np.searchsorted(images, begins, side="right")
    silent = (ends - begins > SILENT_NS) & (images_inside > 0)
    if not silent.any():
        return []
    lengths_s, since_s = (ends - begins)[silent] / 1e9, (begins[silent] - images[0]) / 1e9
    longest = int(lengths_s.argmax())
    return [
        f"The odometry was silent for more than {SILENT_NS / 1e9:g} s {len(lengths_s)}×, for {lengths_s.sum():.1f} s "
        f"in all, in which {images_inside[silent].sum()} images came; the longest time was {lengths_s[longest]:.1f} s, "
        f"after {since_s[longest]:.1f} s."
    ]


def _light_warnings(run: Results) -> list[str]:
    """Return that many images are too dark or washed out, as texts for people."""
    light = run.light
    dark = [one for one in light if one.bright_grey < DARK_GREY]
    washed_out = [one for one in light if one.saturated > WASHED_OUT]
    texts, fewest = [], max(BADLY_LIT * len(light), WRONG_IMAGES)
    if len(dark) >= fewest:
        grey = np.median([one.bright_grey for one in dark])
        texts.append(
            f"{len(dark)} of {len(light)} images looked at are dark: 95 % of their pixels are below grey "
            f"level {grey:.0f} of 255 (median; expected above {DARK_GREY:.0f}). "
            "Give the camera more light or a longer exposure."
        )
    if len(washed_out) >= fewest:
        share = np.median([one.saturated for one in washed_out])
        texts.append(
            f"{len(washed_out)} of {len(light)} images looked at are washed out: {share:.0%} of their pixels are white "
            f"(median; expected below {WASHED_OUT:.0%}). Give the camera less light or a shorter exposure."
        )
    return texts


def _height(run: Results) -> tuple[dict[str, float], list[str]]:
    """Return the height of the camera by where the edges of landmarks end, and that what is stated cannot be right."""
    last = run.frames[-1].located
    stated_m = run.log.camera.at(last.edges.mount).mount.height_m
    warning = last.height.warning(stated_m)
    warnings = [f"{warning[0].upper()}{warning[1:]}."] if warning else []
    if not any(len(frame.located.edges) and np.isfinite(frame.located.edges.ends_px).all() for frame in run.frames):
        return {}, warnings  # a log without ends
    return {
        "height_found_m": round(stated_m + last.height.mean_m, 6),
        "height_found_sigma_m": round(last.height.sigma_m, 6),
    }, warnings


def _clock(run: Results) -> tuple[dict[str, Any], list[str]]:
    """Return by how much images are stamped later than wheels, and a warning where that matters; see `ClockOffset`."""
    log, config = run.log, run.localiser.config
    if not log.has_images or config.increments.source == "vision":
        return {}, []
    found = clock_offset(run.track.t_ns, run.edges_of, log.odometry, log.camera, most=CLOCK_PAIRS)
    warning = found.warning(log.path, config.motion.bias.delay_sigma_s)
    figures = {"clock_offset_s": round(found.offset_s, 6), "clock_offset_sigma_s": round(found.sigma_s, 6)}
    return figures, [] if warning is None else [warning]


def _mount(run: Results) -> tuple[dict[str, Any], list[str]]:
    """Return what the edges of all images together say about tilt and roll, and when that contradicts what is stated.

    See `check_mount`.
    """
    log, parameters = run.log, run.localiser.config.edges
    if not log.has_images:
        return {}, []
    check = check_mount(run.edges_of, run.track.odometry, log.camera, parameters.mount_sigma_rad)
    warning, (found, sigma) = check.warning(log.path), np.rad2deg([check.mount, check.sigma])
    figures: dict[str, Any] = {}
    for name, value, one in zip(("tilt", "roll"), found, sigma, strict=True):
        figures |= {f"{name}_found_deg": round(float(value), 6), f"{name}_found_sigma_deg": round(float(one), 6)}
    return figures, [] if warning is None else [warning]


# -- what a run was made from ------------------------------------------------------------------------------------------


def about(run: Results) -> dict[str, Any]:
    """Return what makes runs comparable, in few words: see `localiser.evaluate.metrics.ABOUT`.

    The map's name is followed by the beginning of its fingerprint; `inputs` is that of all that has no word of its
    own: the log's times and poses, the camera, every other setting.
    """
    config = run.localiser.config
    others = sorted(item for item in run.identity.items() if item[0] not in _WITH_A_WORD)
    return {
        "observation": config.observation.kind,
        "association": config.observation.association,
        "odometry": config.increments.source,
        "start": "anywhere" if run.start is None else "stated",
        "map": f"{run.localiser.landmark_map.name} {run.identity['map'][:_SHORT]}".strip(),
        "inputs": fingerprint(others)[:_SHORT],
        "particles": config.mcl.particles,
        "seed": config.seed,
    }


def run_yaml(run: Results) -> str:
    """Return as YAML what a run was made from; see `config.yaml` for its settings."""
    log, landmark_map, identity = run.log, run.localiser.landmark_map, run.identity
    data: dict[str, Any] = {
        "log": {"name": log.name, "path": str(log.path), "fingerprint": identity["log"]},
        "map": {
            "name": landmark_map.name,
            "path": ", ".join(map(str, run.map_files)) or str(log.path),
            "landmarks": len(landmark_map),
            "fingerprint": identity["map"],
        },
        "camera": {"name": log.camera.name, "fingerprint": identity["camera"]},
        "odometry": run.localiser.config.increments.source,
        "start": "anywhere",
    }
    if (start := run.start) is not None:
        to_degrees = np.array([1.0, 1.0, np.rad2deg(1.0)])
        values = np.concatenate([start.mean * to_degrees, np.sqrt(np.diag(start.cov)) * to_degrees]).tolist()
        names = ("x", "z", "heading_deg", "sigma_x_m", "sigma_z_m", "sigma_heading_deg")
        data["start"] = {"t_ns": int(start.t_ns), **dict(zip(names, values, strict=True))}
    return dump(data)
