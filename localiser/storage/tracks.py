"""Write what a run located, image by image, and read it back. A run that breaks off leaves what it did."""

from __future__ import annotations

from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from localiser.documents import output_errors, write_all
from localiser.evaluate import Track, found_images
from localiser.filter import NOT_FOUND, LocatedFrame
from localiser.storage.tables import Column, number, number_or_unknown, read_table
from localiser.storage.trajectories import POSE_COLUMNS, tum_line

TRAJECTORY_CSV = "trajectory.csv"
TRAJECTORY_TUM = "trajectory.tum"
GROUNDTRUTH_TUM = "groundtruth.tum"

_COV = ("cov_xx", "cov_xz", "cov_xh", "cov_zz", "cov_zh", "cov_hh")
_ODOMETRY = ("odometry_x", "odometry_z", "odometry_heading")
PLACE = 0.05  # of the weight that a place must have to be counted
_UPPER = np.triu_indices(3)
COLUMNS = (
    *POSE_COLUMNS,
    *(Column(name, number) for name in (*_COV, "ess")),
    *(Column(name, number_or_unknown, required=False) for name in ("edges", *_ODOMETRY, "p_correct")),
    Column("reason", str, required=False),
    Column("places", number_or_unknown, required=False),
)


class TrackWriter:
    """Writes `trajectory.csv`, `trajectory.tum` and, where the truth is known, `groundtruth.tum`, a line an image.

    The CSV holds our frame, the TUM files the ROS frame. p_correct: probability of being within 0.5 m and 10°; reason:
    why it is low; places: where the robot may be. Columns of constant errors follow the listed ones, each with its
    sigma. Raises OutputError.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, FileIO] = {}
        self._write(TRAJECTORY_TUM, "")

    def frame(self, frame: LocatedFrame) -> None:
        """Write what the filter knows after one image."""
        located, estimate = frame.located, frame.located.estimate
        constants = estimate.names[3:]
        self._begin_csv(constants)
        cells = [str(located.t_ns)]
        cells += [f"{value:.9f}" for value in estimate.pose]
        cells += [f"{value:.9e}" for value in frame.pose_cov[_UPPER]]
        cells += [f"{located.ess:.3f}", str(len(located.edges))]
        cells += ["" if np.isnan(value) else f"{value:.9f}" for value in located.odometry]
        places = 1 if located.clusters is None else int((located.clusters.weight >= PLACE).sum())
        cells += [f"{located.p_correct:.4f}", located.reason, str(places)]
        for column in range(3, 3 + len(constants)):
            cells += [f"{estimate.mean[column]:.9e}", f"{np.sqrt(estimate.cov[column, column]):.9e}"]
        self._write(TRAJECTORY_CSV, ",".join(cells) + "\n")
        if frame.is_found:
            self._write(TRAJECTORY_TUM, tum_line(located.t_ns, estimate.pose))
        if frame.truth is not None:
            self._write(GROUNDTRUTH_TUM, tum_line(located.t_ns, frame.truth))

    def close(self, complete: bool) -> None:
        """End the files; they hold every image so far whether the run is complete or not."""
        self._begin_csv(())
        for name, file in self._files.items():
            with output_errors(self._folder / name):
                file.close()

    def _begin_csv(self, constants: tuple[str, ...]) -> None:
        if TRAJECTORY_CSV not in self._files:
            names = [column.name for column in COLUMNS] + [
                f"{name}{end}" for name in constants for end in ("", "_sigma")
            ]
            self._write(TRAJECTORY_CSV, ",".join(names) + "\n")

    def _write(self, name: str, text: str) -> None:
        """Append to a file, made when it is first written; all of the text is handed to the system, or none."""
        with output_errors(self._folder / name):
            if name not in self._files:
                self._files[name] = (self._folder / name).open("wb", buffering=0)
            file = self._files[name]
            whole = file.tell()
            try:
                write_all(file.write, text.encode())
            except OSError:
                file.seek(whole)
                file.truncate()
                raise


def read_track(path: Path) -> Track:
    """Return what a `trajectory.csv` says; columns of a newer version are passed over. Raises InputError."""
    table = read_table(path, COLUMNS, rows_at_least=1, more_columns=True)
    table.require_time_order(strictly=True)
    covs = np.empty((len(table), 3, 3))
    covs[:, _UPPER[0], _UPPER[1]] = covs[:, _UPPER[1], _UPPER[0]] = table.numbers(*_COV)
    known: dict[str, Any] = {name: table.numbers(name) for name in ("edges", "p_correct") if name in table.columns}
    if all(name in table.columns for name in _ODOMETRY):
        known["odometry"] = table.numbers(*_ODOMETRY)
    if "p_correct" in known:
        looked_for = table.columns.get("reason", ("",))[0] == NOT_FOUND
        known["found"] = found_images(known["p_correct"], is_found=not looked_for)
    return Track.from_poses(table.integers("t_ns"), table.numbers("x", "z", "heading"), covs=covs, **known)
