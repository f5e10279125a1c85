"""The flown camera in a real room: every split of its images into a map and a query, by many seeds.

python benchmarks/real_room.py                  # the data: $LOCALISER_DATA/vicon_room, else ../shared/data/vicon_room
python benchmarks/real_room.py --seeds 0-1 --results build/real_room.json

A run that was stopped goes on where it was: runs that are in the file of results are not made again. Delete the file
after a change of the program. NEES is against the truth as if it were exact; NEES* adds the covariance that the truth
is stated to have (1 cm, 0.2°). For `halves` the map is of the first half of the flight, and the query of the second
half; `old` counts the images alone that see old scenery, by poses, see `sees_old_scenery`.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from localiser import Log, open_log, replay_log
from localiser.config import read_config
from localiser.evaluate import Errors, errors_against, nees
from localiser.filter import CORRECT_M, CORRECT_RAD, SURE, Sighting
from localiser.geometry import Array, map_from_robot, robot_from_map, wrap_angle
from localiser.landmarks import LandmarkMap, field_of_view_rad, landmark_ends, predicted_lines
from localiser.mapping import build_map, cache_folder, edges_of_log
from localiser.replay import Replay

TRUTH_COV = np.diag([0.01, 0.01, np.deg2rad(0.2)]) ** 2
"""Covariance of the truth at an image, as the data state it: a centimetre and 0.2°."""
EVEN, ODD = ("left_even", "right_even"), ("left_odd", "right_odd")
SPLITS = [(EVEN, "left_odd"), (EVEN, "right_odd"), (ODD, "left_even"), (ODD, "right_even")]
ALL = EVEN + ODD
STARTS = ("truth", "global")
RANGES_M, DIRECTIONS = np.arange(1.0, 5.5, 0.5), 25
AGAIN_RAD, FEWEST_MOMENTS, OLD_SHARE = np.deg2rad(45.0), 4, 0.5


def sees_old_scenery(poses: Array, earlier: Array, half_view_rad: float) -> NDArray[np.bool_]:
    """Return which camera poses (T, 3) see what the earlier ones (K, 3) saw; results of a run play no part in it.

    A fan of points 1 to 5 m away stands for the view. A point is old where four earlier poses at least had it in view
    within 5 m, from a direction within 45° of this one: a landmark of the map needs four images. An image sees old
    scenery where half of its points are old.
    """
    bearing, range_m = np.meshgrid(np.linspace(-half_view_rad, half_view_rad, DIRECTIONS), RANGES_M)
    fan = np.column_stack([(range_m * np.sin(bearing)).ravel(), -(range_m * np.cos(bearing)).ravel()])
    share = []
    for pose in poses:
        points = map_from_robot(pose, fan)
        ray = points - pose[:2]
        seen = np.zeros(len(points), dtype=np.int64)
        for before in earlier:
            right, back = robot_from_map(before, points).T
            ray_before = points - before[:2]
            cosine = (ray * ray_before).sum(axis=1) / np.maximum(np.hypot(*ray.T) * np.hypot(*ray_before.T), 1e-9)
            in_view = (np.abs(np.arctan2(right, -back)) < half_view_rad) & (np.hypot(right, back) <= RANGES_M[-1])
            seen += in_view & (cosine > np.cos(AGAIN_RAD))
        share.append((seen >= FEWEST_MOMENTS).mean())
    return np.array(share) >= OLD_SHARE


def part(log: Log, first: bool, until_ns: int) -> Log:
    """Return the images of a log until a time, or those after it."""
    return replace(log, frames=[frame for frame in log.frames if (frame.t_ns <= until_ns) == first])


def half_time(logs: Sequence[Log]) -> int:
    """Return the time (ns) of the last image of the first half of all images."""
    times = np.unique([frame.t_ns for log in logs for frame in log.frames])
    return int(times[(len(times) - 1) // 2])


def measured(log: Log) -> Log:
    """Return a log with the edges of its images in place of the images: they are the same for all seeds."""
    edges = edges_of_log(log, read_config(None, [], log.settings).edges, cache=cache_folder())
    frames = [Sighting(frame.t_ns, found) for frame, found in zip(log.frames, edges, strict=True)]
    return replace(log, frames=frames)


def figures(run: Replay, log: Log, chosen: NDArray[np.bool_] | None = None) -> dict[str, float | None]:
    """Return the figures of a run over its images, or those that are chosen."""
    track, errors = run.track, errors_against(run.track, log.groundtruth)
    sure = track.p_correct > SURE
    found = int(np.argmax(sure)) if sure.any() else None
    judged = np.ones(len(track), dtype=bool) if chosen is None else chosen.copy()
    if run.start is None:  # before it is found there is no place to judge
        judged[: len(track) if found is None else found] = False
    wrong = (errors.position_m > CORRECT_M) | (np.abs(errors.heading_rad) > CORRECT_RAD)
    if not judged.any():
        return {"images": 0, "found": None}
    return {
        "images": int(judged.sum()),
        "found": None if found is None else found + 1,
        "rmse_m": float(np.sqrt(np.mean(errors.position_m[judged] ** 2))),
        "median_m": float(np.median(errors.position_m[judged])),
        "heading_deg": float(np.degrees(np.sqrt(np.mean(errors.heading_rad[judged] ** 2)))),
        "nees": float(np.nanmean(errors.nees[judged])),
        "nees_truth": float(np.nanmean(nees(_difference(run, errors), track.covs + TRUTH_COV)[judged])),
        "sure": float(sure[judged].mean()),
        "sure_and_wrong": float((sure & wrong)[chosen if chosen is not None else slice(None)].mean()),
    }


def _difference(run: Replay, errors: Errors) -> Array:
    off = run.track.poses - errors.truth
    off[:, 2] = wrap_angle(off[:, 2])
    return off


class Results:
    """Figures of runs by name, kept in a file after every run."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.known = json.loads(path.read_text()) if path.exists() else {}

    def of(self, name: str, make: Callable[[], dict]) -> dict:
        """Return the figures of a run, from the file where they are known."""
        if name not in self.known:
            self.known[name] = make()
            self.path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = self.path.with_suffix(".part")
            unfinished.write_text(json.dumps(self.known, indent=1))
            unfinished.replace(self.path)
        return self.known[name]


class Room:
    """The logs, and the maps of them, each made when it is first needed."""

    def __init__(self, folder: Path) -> None:
        self.logs = {name: open_log(folder / name) for name in ALL}
        self.until_ns = half_time(list(self.logs.values()))
        self._maps: dict[str, LandmarkMap] = {}
        self._measured: dict[str, Log] = {}

    def map_of(self, name: str, logs: list[Log]) -> LandmarkMap:
        """Return the map of some logs at their true poses."""
        if name not in self._maps:
            settings = read_config(None, [], logs[0].settings)
            self._maps[name] = build_map(logs, config=settings, cache=cache_folder()).landmark_map
        return self._maps[name]

    def edges_of(self, name: str) -> Log:
        """Return a log with its edges measured."""
        if name not in self._measured:
            self._measured[name] = measured(self.logs[name])
        return self._measured[name]

    def split(self, mapped: Sequence[str], query: str, start: str, seed: int) -> dict:
        """Return the figures of a query log on the map of others."""
        log = self.edges_of(query)
        made = self.map_of("+".join(mapped), [self.logs[name] for name in mapped])
        return {"all": figures(replay_log(log, landmark_map=made, start=start, seed=seed), log)}

    def halves(self, query: str, start: str, seed: int) -> dict:
        """Return the figures of the second half of a log on the map of the first half of all."""
        firsts = [part(self.logs[name], True, self.until_ns) for name in ALL]
        made, log = self.map_of("first half", firsts), part(self.edges_of(query), False, self.until_ns)
        log = replace(log, odometry=_after(log, log.frames[0].t_ns))
        earlier = [at_images(firsts[0]), at_images(firsts[2])]  # of one camera: both took their images together
        old = sees_old_scenery(at_images(log), np.concatenate(earlier), field_of_view_rad(log.camera) / 2)
        run = replay_log(log, landmark_map=made, start=start, seed=seed)
        return {"all": figures(run, log), "old": figures(run, log, old)}


def at_images(log: Log) -> Array:
    """Return the true poses (T, 3) of the camera when it took the images."""
    return log.camera.pose_in_map(log.groundtruth.sampled(_times(log)).poses)


def _times(log: Log) -> NDArray[np.int64]:
    return np.array([frame.t_ns for frame in log.frames], dtype=np.int64)


def _after(log: Log, t_ns: int) -> object:
    first = max(int(np.searchsorted(log.odometry.t_ns, t_ns, side="right")) - 1, 0)
    return replace(log.odometry, t_ns=log.odometry.t_ns[first:], poses=log.odometry.poses[first:])


def row(label: str, start: str, runs: list[dict]) -> str:
    """Return a line of the table: medians over seeds, the worst in brackets."""
    found = [run["found"] for run in runs]
    cells = [
        label,
        start,
        str(runs[0]["images"]) if start == "truth" else "",
        _found(found) if start != "truth" else "",
    ]
    for name, decimals in (
        ("rmse_m", 3),
        ("median_m", 3),
        ("heading_deg", 2),
        ("nees", 1),
        ("nees_truth", 1),
        ("sure", 2),
        ("sure_and_wrong", 2),
    ):
        values = [run[name] for run in runs if name in run]
        worst = (min if name == "sure" else max)(values, default=np.nan)
        cells.append(f"{np.median(values) if values else np.nan:.{decimals}f} ({worst:.{decimals}f})")
    return "| " + " | ".join(cells) + " |"


def _found(found: list[int | None]) -> str:
    known = [each for each in found if each is not None]
    return f"{len(known)} of {len(found)}, by image {max(known, default=0)}"


def draw_edges(room: Room, out: Path, image: int = 25) -> None:
    """Draw the edges of an image of the odd left ones on the map of the even ones as lines, without the photograph."""
    import matplotlib.pyplot as plt

    log = room.edges_of("left_odd")
    made = room.map_of("+".join(EVEN), [room.logs[name] for name in EVEN])
    frame = replay_log(log, landmark_map=made, start="truth", seed=0).frames[image]
    edges, matches, camera = frame.located.edges, frame.matches, log.camera.at(frame.located.edges.mount)
    figure, axes = plt.subplots(figsize=(7.52, 5.0))
    ends = landmark_ends(made, log.camera)
    _, lines = predicted_lines(camera, frame.located.estimate.pose_as_seen, ends, matches.visible)
    kinds = (
        ("expected landmark", lines, "#4477aa", 1.0),
        ("edge of no landmark", edges.ends_px[matches.landmark < 0], "#cc3311", 1.2),
        ("edge of a landmark", edges.ends_px[matches.landmark >= 0], "#228833", 2.2),
    )
    for label, drawn, colour, width in kinds:
        for number, line in enumerate(drawn):
            axes.plot(*np.asarray(line).T, color=colour, linewidth=width, label=label if number == 0 else None)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), xlabel="pixels", aspect="equal")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.1), ncols=3, frameon=False)
    figure.savefig(out, dpi=100, bbox_inches="tight")


def main() -> None:
    """Make all runs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("LOCALISER_DATA", "../shared/data")) / "vicon_room"
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    parser.add_argument("--seeds", default="0-4", help="first and last seed")
    parser.add_argument("--starts", default=",".join(STARTS), help="truth, global, or both")
    parser.add_argument("--results", type=Path, default=Path("build/real_room.json"))
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the edges of one image, and nothing else")
    options = parser.parse_args()
    if options.picture is not None:
        draw_edges(Room(options.folder), options.picture)
        return
    low, _, high = options.seeds.partition("-")
    seeds, starts = range(int(low), int(high or low) + 1), options.starts.split(",")
    results, room = Results(options.results), Room(options.folder)
    rows = []
    with Progress() as progress:
        task = progress.add_task("Replaying", total=(len(SPLITS) + len(ALL)) * len(starts) * len(seeds))

        def runs_of(name: str, make: Callable[[int], dict]) -> list[dict]:
            made = []
            for seed in seeds:
                made.append(results.of(f"{name}, seed {seed}", lambda seed=seed: make(seed)))
                progress.advance(task)
            return made

        for mapped, query in SPLITS:
            for start in starts:
                label = f"{'even' if mapped is EVEN else 'odd'} → {query}"
                runs = runs_of(f"{label}, {start}", lambda seed, m=mapped, q=query, s=start: room.split(m, q, s, seed))
                rows.append(row(label, start, [run["all"] for run in runs]))
        for query in ALL:
            for start in starts:
                label = f"first half → second of {query}"
                runs = runs_of(f"{label}, {start}", lambda seed, q=query, s=start: room.halves(q, s, seed))
                rows += [row(f"{label}, {kind}", start, [run[kind] for run in runs]) for kind in ("all", "old")]
    text = "map → query | start | images | found | RMSE m | median m | heading ° | NEES | NEES* | sure | sure, wrong"
    print(f"| {text} |", "|" + "---|" * (text.count("|") + 1), *rows, sep="\n")


if __name__ == "__main__":
    main()
