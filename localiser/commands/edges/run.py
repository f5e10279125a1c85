"""The loop over images: find edges by each detector, write tables and a picture, go on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from localiser.camera import Camera
from localiser.commands.edges.compare import Comparison
from localiser.commands.edges.inputs import Taken
from localiser.commands.edges.overlay import save_overlay
from localiser.commands.edges.records import COLUMNS, PROFILE, csv_text, mount_by_edges, records_of, rows_of
from localiser.config import Config, in_force, to_yaml
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.errors import LocaliserError, RunEndedEarlyError
from localiser.replay import stop_request
from localiser.storage import Image, RunFolder, json_text, output_errors, require_new, save_camera, write_text

FORMAT = "localiser-edges/1"
KEPT_IMAGES = 200
"""So many images tell whether the stated mount is right; a large batch is not held in memory."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where results go: `out`, new or empty, else results/edges/1, 2, …; with pictures or tables alone."""

    out: Path | None = None
    pictures: bool = True

    def create(self) -> Path:
        """Return the folder, made. Raises OutputError when it holds something already."""
        if self.out is None:
            return RunFolder.create(Path("results"), "edges").path
        require_new(self.out)
        with output_errors(self.out):
            self.out.mkdir(parents=True, exist_ok=True)
        return self.out


@dataclass(slots=True)
class EdgeRun:
    """Images of one camera, and detectors that all look for edges in each.

    last: what the detectors found in the image that was done last. kept: what they found in the first `KEPT_IMAGES`.
    """

    camera: Camera
    images: Sequence[Taken]
    config: Config
    detectors: Sequence[str]
    outputs: Outputs
    folder: Path = field(init=False)
    comparison: Comparison = field(init=False)
    last: dict[str, Edges] = field(init=False, default_factory=dict)
    kept: dict[str, list[Edges]] = field(init=False, default_factory=dict)

    def run(self, progress: Callable[[], None]) -> None:
        """Find the edges of all images, calling `progress` after each.

        Raises RunEndedEarlyError at the first image that is not what it should be, or when the user stops it; what
        was done until then is on disk.
        """
        first = self.images[0].load()  # a wrong camera is told before a folder is made
        self.comparison = Comparison(list(self.detectors))
        self._warm_up(first)
        self.folder = self.outputs.create()
        save_camera(self.camera, self.folder / "camera.yaml")
        write_text(self.folder / "config.yaml", to_yaml(in_force(self.config)))
        done = 0
        try:
            with stop_request() as stop_if_asked:
                for taken in self.images:
                    stop_if_asked()
                    self._one(taken, taken.load())
                    done += 1
                    progress()
        except KeyboardInterrupt as stop:
            raise self._early("stopped", done, 130) from stop
        except LocaliserError as error:
            raise self._early(str(error), done, error.exit_code) from error
        finally:
            self._write_comparison()

    def _warm_up(self, image: Image) -> None:
        """Let detectors make what they keep for a camera, so that no image's time has it."""
        for name in self.detectors:
            find_edges(image, self.camera, self._parameters(name))

    def _parameters(self, detector: str) -> EdgeParameters:
        return replace(self.config.edges, detector=detector)

    def _one(self, taken: Taken, image: Image) -> None:
        found: dict[str, Edges] = {}
        ms: dict[str, float] = {}
        for name in self.detectors:
            begin = perf_counter()
            edges = find_edges(image, self.camera, self._parameters(name), with_probabilities=True)
            ms[name] = 1e3 * (perf_counter() - begin)
            found[name] = edges.take(np.argsort(edges.bearing, kind="stable"))
        self.comparison.add(found, ms, self.camera)
        self._write(taken, image, found)
        self.last = found
        for name, edges in found.items():
            frames = self.kept.setdefault(name, [])
            if len(frames) < KEPT_IMAGES:
                frames.append(edges)

    def _write(self, taken: Taken, image: Image, found: dict[str, Edges]) -> None:
        about = {"image": taken.image, **({} if taken.t_ns is None else {"t_ns": taken.t_ns})}
        rows = {name: rows_of(edges) for name, edges in found.items()}
        detectors = {
            name: {
                "edges": records_of(edges),
                "rejected_px": edges.rejected_px,
                "rejected": len(edges.rejected_px),
                "mount_by_edges": mount_by_edges(edges, self.camera, self._parameters(name)),
            }
            for name, edges in found.items()
        }
        head = {"format": FORMAT, **about, "width": self.camera.width, "height": self.camera.height}
        columns = {**COLUMNS, "profile": PROFILE}
        write_text(self.folder / f"{taken.stem}.json", json_text({**head, "columns": columns, "detectors": detectors}))
        self._append(
            [*about, "detector", *COLUMNS],
            [{**about, "detector": name, **row} for name in found for row in rows[name]],
        )
        if self.outputs.pictures:
            save_overlay(self.folder / f"{taken.stem}.png", image, self.camera, found, title=Path(taken.image).name)

    def _append(self, columns: Sequence[str], rows: Sequence[dict[str, object]]) -> None:
        """Append to edges.csv, image by image: a large batch is never held in memory, and survives a stop."""
        path = self.folder / "edges.csv"
        with output_errors(path):
            text = csv_text(columns, rows, header=not path.exists())
            with path.open("a", encoding="utf-8", newline="") as file:
                file.write(text)

    def _write_comparison(self) -> None:
        rows = self.comparison.rows()
        write_text(self.folder / "detectors.csv", csv_text(rows[0], rows))

    def _early(self, reason: str, done: int, exit_code: int) -> RunEndedEarlyError:
        reached = f"The run ended after {done} of {len(self.images)} images; what was done is in {self.folder}"
        return RunEndedEarlyError(f"{reason}. {reached}", exit_code)
