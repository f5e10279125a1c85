"""What a user is told of a live run: messages, a line while it runs, figures for a table at its end."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from localiser.edges import DARK_GREY, WASHED_OUT, light_of
from localiser.filter import NOT_FOUND, SURE, LocatedFrame
from localiser.geometry import Array, between

AGAIN_S = 10.0
"""How long a message of one kind is not repeated."""

LIT_EVERY = 5
"""Of how many images one is looked at for its light."""

SILENT_S, AWAITED_S = 1.0, 5.0
"""After how long a source that was heard has gone silent, and one that never was is asked after."""
_NO_WARNINGS = ("located", "sure", "edges", "matched")
MOST_FIGURES = 100_000
RECENT = 20  # images whose rate is that of now


@dataclass(slots=True, eq=False)
class Monitor:
    """Messages and figures of a run. say: takes a message and its level, INFO or WARNING.

    advice: returns what to start or to set where nothing was heard of some roles.
    """

    say: Callable[[str, str], None]
    advice: Callable[[list[str]], str] = lambda roles: f"nothing heard yet of {' and '.join(roles)}"
    counts: Counter[str] = field(default_factory=Counter)
    latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_FIGURES))
    work_ms: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_FIGURES))
    error_m: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_FIGURES))
    newest: LocatedFrame | None = None
    _times: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    _said: dict[str, float] = field(default_factory=dict)
    _heard: dict[str, float] = field(default_factory=dict)
    _silent: dict[str, float] = field(default_factory=dict)
    _awaited: dict[str, float] = field(default_factory=dict)
    _begun: float | None = None
    _advised: bool = False
    _first: float = 0.0
    _last: float = 0.0

    def warn(self, kind: str, text: str) -> None:
        """Count something that is wrong, and say it unless the same was said just now."""
        self.counts[kind] += 1
        now = time.monotonic()
        if now - self._said.get(kind, -AGAIN_S) >= AGAIN_S:
            self._said[kind] = now
            self.say(text, "WARNING")

    def wait(self, kind: str, text: str) -> None:
        """Say what is waited for; it is wrong only when it lasts."""
        now = time.monotonic()
        if kind not in self._awaited:
            self._awaited[kind] = now
            self.inform(text)
        elif now - self._awaited[kind] >= AGAIN_S:
            self.warn(kind, text)

    def inform(self, text: str) -> None:
        """Say something that is as it should be."""
        self.say(text, "INFO")

    def heard(self, role: str) -> None:
        """Note that a source is there."""
        now = time.monotonic()
        if role in self._silent:
            self.inform(f"{role}: back after {now - self._silent.pop(role):.1f} s")
        self._heard[role] = now

    @property
    def heard_nothing(self) -> bool:
        """Whether neither images nor odometry have come."""
        return not self._heard

    def watch(self, expected: tuple[str, ...]) -> None:
        """Say which of the sources have gone silent; and once, what to do about those that nothing was heard of."""
        now = time.monotonic()
        self._begun = now if self._begun is None else self._begun
        if not self._advised and now - self._begun > AWAITED_S:
            self._advised = True
            if missing := [role for role in expected if role not in self._heard]:
                self.say(self.advice(missing), "WARNING")
        for role, since in self._heard.items():
            if role not in self._silent and now - since > SILENT_S:
                self._silent[role] = since
                self.counts[f"{role} silent"] += 1
                self.say(f"{role}: nothing for {SILENT_S:g} s; waiting for it to come back", "WARNING")

    def located(self, frame: LocatedFrame, latency_ms: float, work_ms: float, error_m: float | None) -> None:
        """Count an image that was located; say when the robot is found, and when the map no longer fits."""
        located, landmark = frame.located, frame.matches.landmark
        sure = located.p_correct > SURE
        self.counts.update(located=1, sure=sure, edges=len(landmark), matched=int((landmark >= 0).sum()))
        if sure and self.counts["sure"] == 1:
            x, z, heading = located.estimate.pose
            on = f" on {frame.map_name}" if frame.map_name else ""
            self.inform(f"sure of the pose: x = {x:.2f} m, z = {z:.2f} m, heading = {np.degrees(heading):.1f}°{on}")
        if located.warning:
            self.warn("map", located.warning)
        if self.newest is not None and self.newest.is_found and not frame.is_found and located.reason != NOT_FOUND:
            self.warn("lost", f"the robot may be at another place ({located.reason}): the pose may jump there")
        if located.took_over:
            self.warn("takeover", "another place fits better: the pose jumped there")
        if located.odometry_jumped:
            self.warn("jump", "the odometry jumped: did the base restart? The robot is taken to have gone on as before")
        if located.wheels_are_wrong and self.newest is not None:
            wheels = between(self.newest.located.odometry, located.odometry)
            self.warn(
                "wheels", f"the wheels contradict the edges: {_way(wheels)} instead of {_way(located.increment.mean)}"
            )
        if frame.image is not None and self.counts["located"] % LIT_EVERY == 1:
            light = light_of(frame.image)
            if light.bright_grey < DARK_GREY:
                self.warn("dark images", f"the image is dark: 95 % is below grey level {light.bright_grey:.0f} of 255")
            if light.saturated > WASHED_OUT:
                self.warn("washed-out images", f"the image is washed out: {light.saturated:.0%} of it is white")
        now = time.monotonic()
        self._first, self._last = self._first or now, now
        self._times.append(now)
        self.newest = frame
        self.latency_ms.append(latency_ms)
        self.work_ms.append(work_ms)
        if error_m is not None:
            self.error_m.append(error_m)

    @property
    def wrong(self) -> dict[str, int]:
        """What was wrong, and how often."""
        return {kind: count for kind, count in self.counts.items() if kind not in _NO_WARNINGS}

    @property
    def rate_now_hz(self) -> float:
        """Images a second of late, 0 while there are too few."""
        span = self._times[-1] - self._times[0] if self._times else 0.0
        return (len(self._times) - 1) / span if span > 0 else 0.0

    def rows(self) -> dict[str, str]:
        """Return what a run comes to, as texts by their labels."""
        counts, rows = self.counts, {"images located": str(self.counts["located"])}
        if len(self.latency_ms) > 1 and self._last > self._first:
            rows["rate"] = f"{(counts['located'] - 1) / (self._last - self._first):.1f} Hz"
        for name, values in (("latency", self.latency_ms), ("edges and filter", self.work_ms)):
            if values:
                for label, value in zip(("median", "99 %"), np.percentile(values, [50, 99]), strict=True):
                    rows[f"{name}, {label}"] = f"{value:.0f} ms"
        if counts["located"]:
            rows["images sure"] = f"{100 * counts['sure'] / counts['located']:.0f} %"
        if counts["edges"]:
            rows["edges matched"] = f"{100 * counts['matched'] / counts['edges']:.0f} %"
        if self.error_m:
            rows["error, RMSE"] = f"{np.sqrt(np.mean(np.square(self.error_m))):.3f} m"
            rows["error, worst"] = f"{max(self.error_m):.3f} m"
        return rows


def _way(motion: Array) -> str:
    return f"{np.hypot(motion[0], motion[1]):.2f} m and {np.degrees(motion[2]):.1f}°"


def status_line(monitor: Monitor) -> str:
    """Return where the robot is, how sure that is, and how the run goes, the most important first."""
    frame = monitor.newest
    if frame is None:
        return "waiting for the first image"
    located, landmark = frame.located, frame.matches.landmark
    x, z, heading = located.estimate.pose
    cov = located.estimate.pose_cov
    matched, warnings = int((landmark >= 0).sum()), sum(monitor.wrong.values())
    parts = [
        frame.map_name,
        f"{x:.2f}, {z:.2f} ± {np.sqrt(np.trace(cov[:2, :2])):.2f} m",
        f"{np.degrees(heading):.1f} ± {np.degrees(np.sqrt(cov[2, 2])):.1f}°",
        f"sure {located.p_correct:.2f}" + (f" ({located.reason})" if located.reason else ""),
        f"{warnings} warning{'s' * (warnings > 1)}" if warnings else "",
        f"{monitor.rate_now_hz:.1f} Hz",
        f"{monitor.work_ms[-1]:.0f} ms",
        f"edges {matched}/{len(landmark)}",
    ]
    return "  ".join(part for part in parts if part)
