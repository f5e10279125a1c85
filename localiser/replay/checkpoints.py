"""What a replay saves so that it can be resumed: the filter, and what the figures of the whole run are made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from localiser.filter import FilterState, LocatedFrame
from localiser.localiser import identity
from localiser.replay.run_inputs import RunInputs
from localiser.storage import checkpoint_of, load_checkpoint, save_checkpoint

STAGES = ("load", "edges", "filter", "sinks")


@dataclass(slots=True, eq=False)
class Progress:
    """How far a replay has come.

    events: how many of the log's the filter has taken. frames: what was located, without images and particles.
    timing: what each of those took (ms), by stage.
    """

    events: int = 0
    frames: list[LocatedFrame] = field(default_factory=list)
    timing: dict[str, list[float]] = field(default_factory=lambda: {stage: [] for stage in STAGES})


@dataclass(slots=True, eq=False)
class Running:
    """All that changes during a replay."""

    state: FilterState
    rng: np.random.Generator
    done: Progress


@dataclass(frozen=True, slots=True)
class Checkpoints:
    """Where checkpoints go. every: images from one to the next, 0: only when the run ends, at its end or before."""

    path: Path
    every: int = 0

    def save(self, inputs: RunInputs, running: Running) -> None:
        """Write a checkpoint in the place of the one before. Raises OutputError."""
        save_checkpoint(self.path, running.state, running.rng, inputs.identity, running.done)

    def is_due(self, frames: int) -> bool:
        """Whether one is to be written after this many images."""
        return bool(self.every) and frames % self.every == 0


def begun(inputs: RunInputs, rng: np.random.Generator) -> Running:
    """Return a replay at its beginning: before any event, or, of a live run that was resumed, where that went on.

    A state belongs to its settings, map and camera: with others the replay starts about there, as for any start.
    Raises InputError when the state is damaged.
    """
    log = inputs.log
    if log.resumed and inputs.start is log.start:
        saved = checkpoint_of(log.resumed, log.path)
        if saved.identity == identity(inputs.config, inputs.landmark_map, log.camera):
            return Running(saved.state, saved.rng, Progress(events=1))  # the start is in the state
    return Running(FilterState(), rng, Progress())


def resumed(path: Path, inputs: RunInputs) -> Running:
    """Return a replay as it was when its checkpoint was written. Raises InputError."""
    saved = load_checkpoint(path, inputs.identity, Progress)
    return Running(saved.state, saved.rng, saved.kept)
