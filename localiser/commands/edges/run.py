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
from localiser.commands.edges.records import COLUMNS, PROFILE, csv_text, mount_by_edges, rows_of
from localiser.config import Config, in_force, to_yaml
from localiser.edges import Edges, find_edges
from localiser.errors import LocaliserError, RunEndedEarlyError
from localiser.geometry import Twist
from localiser.replay import Stop, asked_to_stop
from localiser.storage import Image, RunFolder, json_text, output_errors, require_new, write_camera, write_text

FORMAT = "localiser-edges/1"
KEPT_IMAGES = 200
"""So many images tell whether the stated mount is right; a large batch is not held in memory."""


@dataclass(slots=True)
class EdgeRun:
    """Images of one camera, and detectors that all look for edges in each.

    out: new or empty folder for results, else results/edges/1, 2, …. pictures: whether to draw what was found.
    last, mounts: what the detectors found in the image that was done last, and tilt and roll by that (degrees).
    kept: what they found in the first `KEPT_IMAGES`.
    """

    camera: Camera
    images: Sequence[Taken]
    config: Config
    detectors: Sequence[str]
    out: Path | None = None
    pictures: bool = True
    folder: Path = field(init=False)
    comparison: Comparison = field(init=False)
    last: dict[str, Edges] = field(init=False, default_factory=dict)
    mounts: dict[str, dict[str, float]] = field(init=False, default_factory=dict)
    kept: dict[str, list[Edges]] = field(init=False, default_factory=dict)

    def run(self, progress: Callable[[], None]) -> None:
        """Find the edges of all images, calling `progress` after each.

        Raises RunEndedEarlyError at the first image that is not what it should be, or when the user stops it; what
        was done until then is on disk.
        """
        first = self.images[0].load()  # a wrong camera is told before a folder is made
        self.comparison = Comparison(list(self.detectors))
        self._found(first, None)  # detectors make what they keep for a camera, so that no image's time has it
        self.folder = self._new_folder()
        write_camera(self.camera, self.folder / "camera.yaml")
        write_text(self.folder / "config.yaml", to_yaml(in_force(self.config)))
        done, asked = 0, Stop()
        try:
            with asked_to_stop() as asked:
                for taken in self.images:
                    if asked.is_set():
                        raise KeyboardInterrupt
                    self._one(taken, taken.load())
                    done += 1
                    progress()
        except (KeyboardInterrupt, LocaliserError) as error:
            reason, exit_code = "stopped", asked.exit_code
            if isinstance(error, LocaliserError):
                reason, exit_code = str(error), error.exit_code
            reached = f"The run ended after {done} of {len(self.images)} images; what was done is in {self.folder}"
            raise RunEndedEarlyError(f"{reason}. {reached}", exit_code) from error
        finally:
            rows = self.comparison.rows()
            write_text(self.folder / "detectors.csv", csv_text(rows[0], rows))

    def _new_folder(self) -> Path:
        """Return the folder of the results, made. Raises OutputError when it holds something already."""
        if self.out is None:
            return RunFolder.create(Path("results"), "edges").path
        require_new(self.out)
        with output_errors(self.out):
            self.out.mkdir(parents=True, exist_ok=True)
        return self.out

    def _found(self, image: Image, twist: Twist | None) -> dict[str, tuple[Edges, float]]:
        """Return what each detector finds in an image, from left to right, and in how many ms."""
        found = {}
        for name in self.detectors:
            parameters = replace(self.config.edges, detector=name)
            begin = perf_counter()
            edges = find_edges(image, self.camera, parameters, twist=twist, with_probabilities=True)
            ms = 1e3 * (perf_counter() - begin)
            found[name] = edges.take(np.argsort(edges.bearing, kind="stable")), ms
        return found

    def _one(self, taken: Taken, image: Image) -> None:
        found = self._found(image, taken.twist)
        self.last = {name: edges for name, (edges, _) in found.items()}
        self.mounts = {name: mount_by_edges(edges, self.camera, self.config.edges) for name, edges in self.last.items()}
        self.comparison.add(self.last, {name: ms for name, (_, ms) in found.items()}, self.camera)
        for name, edges in self.last.items():
            if len(self.kept.setdefault(name, [])) < KEPT_IMAGES:
                self.kept[name].append(edges)
        self._write(taken)
        if self.pictures:
            title = Path(taken.image).name
            save_overlay(self.folder / f"{taken.stem}.png", image, self.camera, self.last, title=title)

    def _write(self, taken: Taken) -> None:
        """Write what was found in an image as JSON, and append it to edges.csv, which so survives a stop."""
        about = {"image": taken.image, **({} if taken.t_ns is None else {"t_ns": taken.t_ns})}
        rows = {name: rows_of(edges) for name, edges in self.last.items()}
        detectors = {
            name: {
                "edges": [{**row, "profile": profile} for row, profile in zip(rows[name], edges.profile, strict=True)],
                "rejected_px": edges.rejected_px,
                "rejected": len(edges.rejected_px),
                "mount_by_edges": self.mounts[name],
            }
            for name, edges in self.last.items()
        }
        head = {"format": FORMAT, **about, "width": self.camera.width, "height": self.camera.height}
        columns = {**COLUMNS, "profile": PROFILE}
        write_text(self.folder / f"{taken.stem}.json", json_text({**head, "columns": columns, "detectors": detectors}))
        path = self.folder / "edges.csv"
        table = [{**about, "detector": name, **row} for name in rows for row in rows[name]]
        with output_errors(path):
            text = csv_text([*about, "detector", *COLUMNS], table, header=not path.exists())
            with path.open("a", encoding="utf-8", newline="") as file:
                file.write(text)
