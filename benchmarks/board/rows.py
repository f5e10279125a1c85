"""The rows of the scoreboard: a row is a situation, and one run of it with a seed comes to figures."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from edge_scenes import Light

from board import changes, floors, marked
from board.drives import REAL_MAPS, drive_of, is_there, on_map, third_of
from board.run import Drive, Values, figures, run
from board.worlds import hours_of

MINUTES = 1.5  # of a drive in a simulated building
HALF_MINUTES = 4.0  # of one that goes from its mapped half to the other and back
HOUSE_FAULTS_S = (20.0, 33.0, 46.0, 60.0)
RENDERED = ("corridor", "office", "house", "bookstore")
SIMULATED = {"shop": "shelves", "chairs": "chairs", "crowd": "crowd", "ring": "ring", "alike": "alike"}
PAIRINGS = (
    ("vicon_room/left_odd", "vicon even"),
    ("vicon_room/right_odd", "vicon even"),
    ("vicon_room/left_even", "vicon odd"),
    ("vicon_room/right_even", "vicon odd"),
    ("office_real/odd", "office even"),
    ("office_real/even", "office odd"),
)
OTHER_BUILDINGS = (
    ("corridor", "bookstore"),
    ("office", "corridor"),
    ("house", "bookstore"),
    ("bookstore", "house"),
    ("office_real/odd", "vicon even"),
    ("vicon_room/left_odd", "office even"),
)
FLOORS = tuple(f"floor{floor}" for floor in range(floors.FLOORS))
OF_WRONG_MAPS = ("sure_wrong", "ece", "log_score", "warned_s", "ms")  # to be sure is no merit there


@dataclass(frozen=True, slots=True)
class Row:
    """A situation. logs: data that it needs. judged: what a seed comes to. quick: whether `--quick` has it.

    is_exact: whether nothing is left to chance, so that one seed is enough.
    """

    group: str
    name: str
    logs: tuple[str, ...]
    judged: Callable[[int], Values]
    quick: bool = False
    is_exact: bool = False

    @property
    def title(self) -> str:
        """What tells it from all others."""
        return f"{self.group}: {self.name}"

    @property
    def is_there(self) -> bool:
        """Whether its data is there."""
        return all(map(is_there, self.logs))


def tracked(drive: Callable[[int], Drive], start: str | None, observation: str, seed: int) -> Values:
    """Return how well a drive is followed from a start near the truth, or found from anywhere (None)."""
    record = run(drive(seed), seed, start=start, observation=observation)
    return figures(record, stated=start is not None)


def misplaced(name: str, seed: int) -> Values:
    """Return what becomes of a start that is stated to 0.1 m and 3°, and is wrong by 2 m or more."""
    drive = drive_of(name)
    return figures(run(drive, seed, start=changes.elsewhere(drive, seed)))


def carried(drive: Callable[[int], Drive], seed: int) -> Values:
    """Return what becomes of a robot that is carried away, from then on."""
    drive = changes.carried(drive(seed), seed)
    return figures(run(drive, seed), first=drive.carried)


def on_wrong_map(drive: Callable[[int], Drive], start: str | None, seed: int) -> Values:
    """Return how sure the filter is on a map on which nothing can be right. start: `own`, its true pose; None."""
    one = drive(seed)
    values = figures(run(one, seed, start=one.truth[0] if start else None, same_building=False))
    return {key: values[key] for key in OF_WRONG_MAPS}


def another_of_its_kind(kind: str, seed: int) -> Drive:
    """Return a drive in a simulated building on the map of the generator's next building of that kind."""
    return replace(hours_of(kind, seed, MINUTES), landmark_map=hours_of(kind, seed + 1, 0.1).landmark_map)


def _log(name: str) -> Callable[[int], Drive]:
    """Return a function from any seed to a log's drive."""
    return lambda _: drive_of(name)


def _faulty_house(fault: str, seed: int) -> Drive:
    drive = changes.part_about(drive_of("house"), HOUSE_FAULTS_S[seed % len(HOUSE_FAULTS_S)])
    return changes.wheels_wrong(drive, fault, changes.BEFORE_S)


def _faulty_office(fault: str, seed: int) -> Drive:
    drive = on_map("office_real/odd", "office even")(seed)
    return changes.wheels_wrong(drive, fault, 4.0 + 2.0 * (seed % 5))


def _mapped(name: str, change: Callable, seed: int) -> Drive:
    drive = drive_of(name)
    return replace(drive, landmark_map=change(drive.landmark_map, seed))


# -- all ---------------------------------------------------------------------------------------------------------------


def every_row() -> list[Row]:
    """Return all rows, real ones first."""
    return [*_real(), *_rendered(), *_trust(), *_half_maps(), *_floors(), *_faults()]


def _real() -> Iterator[Row]:
    for (name, made), change, start in (
        (pairing, change, start) for change in (None, third_of) for start in ("truth", None) for pairing in PAIRINGS
    ):
        drive = on_map(name, made) if change is None else on_map(name, made, change)
        label = f"{name.partition('/')[2] if name.startswith('vicon') else name} on {made}"
        label += ", every third landmark" if change else ""
        label += "" if start else ", start unknown"
        needs = (name, *REAL_MAPS[made])
        yield Row("real", label, needs, partial(tracked, drive, start, "line"), quick=start is not None)
    for robot in (1, 2, 3):
        name = f"mrclam:{robot}"
        yield Row("real", f"MRCLAM {robot}", (name,), partial(tracked, _log(name), "truth", "line"))
    yield Row("edges", "York Urban, photographs", ("york_urban",), york_urban, is_exact=True)


def _rendered() -> Iterator[Row]:
    for observation in ("line", "slope"):
        for name in RENDERED:
            judged = partial(tracked, _log(name), "truth", observation)
            yield Row("rendered", f"{name}, {observation}", (name,), judged, quick=observation == "line")
    yield Row("rendered", "racks", ("racks",), partial(tracked, _log("racks"), "truth", "line"))
    for name, kind in SIMULATED.items():
        drive = partial(_hours, kind)
        yield Row("simulated", name, (), partial(tracked, drive, "truth", "line"))


def _hours(kind: str, seed: int) -> Drive:
    return hours_of(kind, seed, MINUTES)


def _trust() -> Iterator[Row]:
    for name in RENDERED:
        yield Row("trust", f"start unknown, {name}", (name,), partial(tracked, _log(name), None, "line"))
    for name in ("office", "house", "bookstore"):
        yield Row("trust", f"carried away, {name}", (name,), partial(carried, _log(name)))
    for name in ("corridor", "house", "bookstore"):
        yield Row("trust", f"start stated wrong, {name}", (name,), partial(misplaced, name))
    for name, other in OTHER_BUILDINGS:
        needs = (name, *REAL_MAPS.get(other, (other,)))
        drive = on_map(name, other) if other in REAL_MAPS else partial(_on_other, name, other)
        yield Row("wrong map", f"{name} on {other}", needs, partial(on_wrong_map, drive, "own"))
    for name, other in (("house", "bookstore"), ("bookstore", "house")):
        judged = partial(on_wrong_map, partial(_on_other, name, other), None)
        yield Row("wrong map", f"{name} on {other}, start unknown", (name, other), judged)
    for label, kind in (("floor", "floor"), ("corridors", "corridors"), ("shop", "shelves")):
        for start in ("own", None):
            judged = partial(on_wrong_map, partial(another_of_its_kind, kind), start)
            yield Row("wrong map", f"{label} on another's" + ("" if start else ", start unknown"), (), judged)
    for name in ("corridor", "house"):
        drive = partial(_mapped, name, lambda one, _: changes.mirrored(one))
        yield Row("wrong map", f"{name} mirrored", (name,), partial(on_wrong_map, drive, "own"))
    judged = partial(on_wrong_map, partial(floors.on, mapped=False), None)
    yield Row("wrong map", "a floor that nobody mapped, start unknown", FLOORS, judged)
    for label, change in (("30 % removed", changes.removed), ("30 % moved", changes.moved), ("3 cm off", changes.off)):
        for name in ("house", "bookstore"):
            drive = partial(_mapped, name, change)
            yield Row("worn map", f"{name}, {label}", (name,), partial(tracked, drive, "truth", "line"))


def _on_other(name: str, other: str, _: int) -> Drive:
    return replace(drive_of(name), landmark_map=drive_of(other).landmark_map)


def _half_maps() -> Iterator[Row]:
    drives = [(kind, (), partial(_half_hours, kind)) for kind in ("floor", "corridors", "chairs")]
    drives += [(name, (name,), _log(name)) for name in ("house", "bookstore")]
    needs = ("office_real/odd", *REAL_MAPS["office even"])
    drives.append(("office_real/odd on office even", needs, on_map("office_real/odd", "office even")))
    for label, logs, drive in drives:
        yield Row("half a map", label, logs, partial(tracked, partial(_half_mapped, drive), "truth", "line"))


def _half_hours(kind: str, seed: int) -> Drive:
    return hours_of(kind, seed, HALF_MINUTES)


def _half_mapped(drive: Callable[[int], Drive], seed: int) -> Drive:
    return changes.half_mapped(drive(seed))


def _floors() -> Iterator[Row]:
    yield Row("floors", "start unknown on one of four floors", FLOORS, partial(tracked, floors.on, None, "line"))
    yield Row("floors", "lift to another floor", FLOORS, _lifted)
    for name, label in (("shop", "shop"), ("shop bare", "shop without markers")):
        needs = (name, f"{name} mapping")
        drive = partial(marked.on, name)
        yield Row("markers", f"{label}, start unknown", needs, partial(tracked, drive, None, "line"))
        yield Row("markers", f"{label}, carried away", needs, partial(carried, drive))
    for change, label in (("shop moved", "one moved by 2 m"), ("shop twice", "one hung twice")):
        drive, needs = partial(marked.on, change), (change, "shop mapping")
        yield Row("markers", f"shop, {label}, start unknown", needs, partial(tracked, drive, None, "line"))


def _lifted(seed: int) -> Values:
    drive = floors.lift(seed)
    return figures(run(drive, seed, start=None), first=drive.carried)


def _faults() -> Iterator[Row]:
    for fault in ("frozen", "twice", "missing", "restarted"):
        drive = partial(_faulty_house, fault)
        yield Row("faults", f"wheels {fault}, house", ("house",), partial(tracked, drive, "truth", "line"))
        drive, needs = partial(_faulty_office, fault), ("office_real/odd", "office_real/even")
        yield Row("faults", f"wheels {fault}, office_real", needs, partial(tracked, drive, "truth", "line"))
    for name in ("corridor", "house"):
        for off in (-0.1, 0.1):
            drive = partial(_off, name, 0.0, off)
            yield Row("faults", f"height {off:+.1f} m, {name}", (name,), partial(tracked, drive, "truth", "line"))
        for off in (-0.5, 0.5):
            drive = partial(_off, name, off, 0.0)
            yield Row("faults", f"tilt {off:+.1f}°, {name}", (name,), partial(tracked, drive, "truth", "line"))
    lights = {"gain 2.5": Light(gain=2.5), "noise 20": Light(noise_sigma=20.0), "blur 3 px": Light(blur_px=3.0)}
    for label, light in lights.items():
        for name in ("house", "bookstore"):
            drive = partial(_lit, name, light)
            yield Row("faults", f"{label}, {name}", (name,), partial(tracked, drive, "truth", "line"))
    for name in ("corridor", "house"):
        drive = partial(_late, name)
        yield Row("faults", f"clock 0.1 s, {name}", (name,), partial(tracked, drive, "truth", "line"))


def _off(name: str, tilt_deg: float, height_m: float, _: int) -> Drive:
    return drive_of(name, None, tilt_deg, height_m)


def _lit(name: str, light: Light, _: int) -> Drive:
    return drive_of(name, light)


def _late(name: str, _: int) -> Drive:
    return changes.late_images(drive_of(name), 0.1)


def york_urban(_: int) -> Values:
    """Return recall and precision of edges in photographs, and how well tilt and roll follow from them."""
    from edge_data import york_urban as photographs
    from edge_score import MountScore, Score

    from board.drives import DATA
    from localiser import EdgeParameters, find_edges

    scenes, score = list(photographs(DATA / "york_urban")), Score()
    for scene in scenes:
        score.add(scene, find_edges(scene.image, scene.camera, EdgeParameters()))
    off_deg = np.abs(MountScore.of(scenes).error_deg)
    tilt_deg, roll_deg = np.median(off_deg, axis=0)
    return {
        "recall": score.recall,
        "precision": score.precision,
        "bearing_deg": score.median_error_deg,
        "tilt_deg": float(tilt_deg),
        "roll_deg": float(roll_deg),
        "within_1_deg": float((off_deg < 1.0).all(axis=1).mean()),
    }


def maps_needed(logs: Collection[str]) -> list[str]:
    """Return the names of maps that are made of these logs."""
    return [name for name, made_of in REAL_MAPS.items() if set(made_of) <= set(logs)]
