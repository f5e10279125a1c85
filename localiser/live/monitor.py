"""Messages for the user of a live run, limited in number, and the figures at its end."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

AGAIN_S = 10.0
"""How long a message of one kind is not repeated."""

SILENT_S = 1.0
MOST_FIGURES = 100_000


@dataclass(slots=True, eq=False)
class Monitor:
    """Messages and figures of a run. say: takes a message and its level, INFO or WARNING."""

    say: Callable[[str, str], None]
    counts: Counter[str] = field(default_factory=Counter)
    latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_FIGURES))
    work_ms: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_FIGURES))
    error_m: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_FIGURES))
    _said: dict[str, float] = field(default_factory=dict)
    _heard: dict[str, float] = field(default_factory=dict)
    _silent: dict[str, float] = field(default_factory=dict)
    _first: float = 0.0
    _last: float = 0.0

    def warn(self, kind: str, text: str) -> None:
        """Count something that is wrong, and say it unless the same was said just now."""
        self.counts[kind] += 1
        now = time.monotonic()
        if now - self._said.get(kind, -AGAIN_S) >= AGAIN_S:
            self._said[kind] = now
            self.say(text, "WARNING")

    def inform(self, text: str) -> None:
        """Say something that is as it should be."""
        self.say(text, "INFO")

    def heard(self, role: str) -> None:
        """Note that a source is there."""
        now = time.monotonic()
        if role in self._silent:
            self.inform(f"{role}: back after {now - self._silent.pop(role):.1f} s")
        self._heard[role] = now

    def watch(self, expected: tuple[str, ...]) -> None:
        """Say which of the sources have gone silent."""
        now = time.monotonic()
        for role in expected:
            since = self._heard.setdefault(role, now)
            if role not in self._silent and now - since > SILENT_S:
                self._silent[role] = since
                self.counts[f"{role} silent"] += 1
                self.say(f"{role}: nothing for {SILENT_S:g} s; waiting for it to come back", "WARNING")

    def located(self, latency_ms: float, work_ms: float, error_m: float | None) -> None:
        """Count an image that was located."""
        self.counts["located"] += 1
        now = time.monotonic()
        self._first, self._last = self._first or now, now
        self.latency_ms.append(latency_ms)
        self.work_ms.append(work_ms)
        if error_m is not None:
            self.error_m.append(error_m)

    def figures(self) -> dict[str, float]:
        """Return what a run comes to."""
        figures: dict[str, float] = {"located": float(self.counts["located"])}
        if len(self.latency_ms) > 1 and self._last > self._first:
            figures["rate_hz"] = (self.counts["located"] - 1) / (self._last - self._first)
        for name, values in (("latency", self.latency_ms), ("edges_and_filter", self.work_ms)):
            if values:
                figures[f"{name}_median_ms"], figures[f"{name}_99_ms"] = np.percentile(values, [50, 99]).tolist()
        if self.error_m:
            figures["error_rmse_m"] = float(np.sqrt(np.mean(np.square(self.error_m))))
            figures["error_worst_m"] = max(self.error_m)
        return figures
