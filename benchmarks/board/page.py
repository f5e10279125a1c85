"""The page of the scoreboard: kept as JSON, printed as a table, and compared with another one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from board.run import FIGURES, NEVER, Values

ROOT = Path(__file__).resolve().parents[2]
Page = dict[str, dict[int, Values]]
"""Figures by row and seed."""
BIGGER_IS_BETTER = {"sure", "log_score", "matched", "recall", "precision", "within_1_deg"}
RATES = {"sure", "sure_wrong", "ece", "matched", "recall", "precision", "within_1_deg"}
UNJUDGED = {"ms", "matched", "warned_s"}  # told, but no reason by itself
ALSO = {"log_score": 0.01, "found": 1.0, "rmse_m": 0.0005, "median_m": 0.0005, "heading_deg": 0.01, "nees": 0.1}
"""The least change that counts: below it a figure is as good, whatever the interval says."""
LEAST_RATE, LEAST_SHARE, ALL_WORSE = 0.01, 0.03, 0.10
HONEST_NEES = 3.0


def seeds_of(text: str) -> list[int]:
    """Return the seeds that `0-4` or `3` stands for."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


# -- kept and printed --------------------------------------------------------------------------------------------------


def save(path: Path, page: Page, groups: Mapping[str, str]) -> None:
    """Write a page: a line for each run."""
    rows = [
        json.dumps(
            {"group": groups[name], "row": name, "seed": seed} | {key: plain(one) for key, one in values.items()}
        )
        for name, runs in page.items()
        for seed, values in runs.items()
    ]
    path.write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")


def load(path: Path) -> Page:
    """Return a page that was saved."""
    page: Page = {}
    for run in json.loads(path.read_text(encoding="utf-8")):
        values = {key: NEVER if one is None else one for key, one in run.items() if key not in ("group", "row", "seed")}
        page.setdefault(run["row"], {})[run["seed"]] = values
    return page


def plain(value: float) -> float | None:
    """Return a number as JSON can have it, with five digits; None for never."""
    return float(f"{value:.5g}") if np.isfinite(value) else None


def table(page: Page, groups: Mapping[str, str]) -> str:
    """Return the page as Markdown: median and worst of each figure."""
    lines: list[str] = []
    last: tuple[str, list[str]] = ("", [])
    for name, runs in page.items():
        keys = list(next(iter(runs.values())))
        if (groups[name], keys) != last:
            titles = [FIGURES[key][0] if key in FIGURES else key for key in keys]
            lines += ["", f"| {groups[name]} | " + " | ".join(titles) + " |", "|---" * (len(keys) + 1) + "|"]
            last = (groups[name], keys)
        cells = [cell(key, [values[key] for values in runs.values()]) for key in keys]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def cell(key: str, values: Sequence[float]) -> str:
    """Return median and worst of some seeds."""
    middle, worst = float(np.median(values)), min(values) if key in BIGGER_IS_BETTER else max(values)
    if key == "nees":
        worst = max(values, key=lambda one: abs(np.log(max(one, 1e-9) / HONEST_NEES)))
    shown = [_number(key, one) for one in (middle, worst)]
    return shown[0] if len(values) == 1 else f"{shown[0]} ({shown[1]})"


def _number(key: str, value: float) -> str:
    if not np.isfinite(value):
        return "–"
    if key in RATES:
        return f"{100 * value:.1f} %"
    digits = {"rmse_m": 4, "median_m": 4, "found": 0, "ms": 1, "nees": 2, "warned_s": 1}.get(key, 2)
    return f"{value:.{digits}f}"


# -- compared ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a figure of a row changed. verdict: `worse`, `better`, or `` where it is the same."""

    row: str
    key: str
    before: float
    now: float
    verdict: str


def compared(before: Page, now: Page) -> list[Verdict]:
    """Return a verdict on every figure of every row that both pages have, by the seeds that both have."""
    verdicts = []
    for name, runs in now.items():
        seeds = [seed for seed in runs if seed in before.get(name, {})]
        for key in next(iter(runs.values())) if seeds else []:
            pairs = np.array([[before[name][seed].get(key, np.nan), runs[seed][key]] for seed in seeds])
            if not np.isnan(pairs).any():
                middle = np.median(pairs, axis=0)
                verdicts.append(Verdict(name, key, float(middle[0]), float(middle[1]), verdict(key, pairs)))
    return verdicts


def verdict(key: str, pairs: np.ndarray) -> str:
    """Return what pairs (S, 2) of a figure before and now come to."""
    bad = badness(key, pairs)
    gained = np.isfinite(bad[:, 0]) != np.isfinite(bad[:, 1])
    both = np.isfinite(bad).all(axis=1)
    change = np.where(both, np.subtract(bad[:, 1], bad[:, 0], where=both, out=np.zeros(len(bad))), 0.0)
    change = np.where(gained, np.where(np.isfinite(bad[:, 1]), -1.0, 1.0) * _large(key, bad), change)
    if not change.any():
        return ""
    size = np.abs(np.where(np.isfinite(bad[:, 0]), bad[:, 0], 0.0))
    middle = float(np.median(size))
    least = LEAST_RATE if key in RATES else max(LEAST_SHARE * middle, ALSO.get(key, 0.0))
    shift = float(np.median(change))
    count = len(change)
    half = student.ppf(0.975, count - 1) * change.std(ddof=1) / np.sqrt(count) if count > 1 else np.inf
    beyond = abs(change.mean()) > half and abs(shift) >= least and np.sign(shift) == np.sign(change.mean())
    each = np.maximum(ALL_WORSE * size, LEAST_RATE if key in RATES else ALSO.get(key, 0.0))
    everyone = count >= 5 and ((change >= each).all() or (change <= -each).all())
    return ("worse" if change.mean() > 0 else "better") if beyond or everyone else ""


def badness(key: str, values: np.ndarray) -> np.ndarray:
    """Return numbers of which the larger is the worse. NEES: how far its logarithm is from an honest one, in nats."""
    if key == "nees":
        with np.errstate(invalid="ignore"):
            return np.abs(np.log(np.maximum(values, 1e-9) / HONEST_NEES))
    return -values if key in BIGGER_IS_BETTER else values


def _large(key: str, bad: np.ndarray) -> float:
    """Return what a change from or to never counts as: as much as the largest finite value."""
    finite = bad[np.isfinite(bad)]
    return max(float(np.abs(finite).max()) if len(finite) else 1.0, ALSO.get(key, 1.0))


def comparison(verdicts: Sequence[Verdict], reference: str) -> str:
    """Return what is worse and what is better, as Markdown, and ratios of time and matches over all rows."""
    lines = ["", f"Against {reference}:"]
    for word in ("worse", "better"):
        chosen = [one for one in verdicts if one.verdict == word and one.key not in UNJUDGED]
        lines += ["", f"{word}: {len(chosen)} figures of {len({one.row for one in chosen})} rows"]
        for row in dict.fromkeys(one.row for one in chosen):
            parts = [
                f"{FIGURES[one.key][0] if one.key in FIGURES else one.key} "
                f"{_number(one.key, one.before)} → {_number(one.key, one.now)}"
                for one in chosen
                if one.row == row
            ]
            lines.append(f"- {row}: " + ", ".join(parts))
    times = [one.now / one.before for one in verdicts if one.key == "ms" and one.before > 0]
    if times:
        lines += ["", f"processor time of an image, median of rows: {np.median(times):.2f} × that of before"]
    return "\n".join(lines)


def of(reference: str, script: str, rows: Sequence, seeds: Sequence[int], jobs: int) -> Page:
    """Return the page of a saved file, or of a commit, whose `localiser/` these benchmarks run here.

    Raises SystemExit where the commit cannot be found or run.
    """
    if Path(reference).exists():
        return load(Path(reference))
    packed = subprocess.run(
        ["git", "archive", reference, "localiser", "configs"], check=False, cwd=ROOT, capture_output=True
    )
    if packed.returncode:
        raise SystemExit(f"--against: expected a saved page or a commit, found {reference}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with tarfile.open(fileobj=BytesIO(packed.stdout)) as archive:
            archive.extractall(folder, filter="data")
        saved = folder / "page.json"
        exactly = [f"{row.group}: {row.name}" for row in rows]
        command = [sys.executable, script, "--seeds", f"{seeds[0]}-{seeds[-1]}", "--jobs", str(jobs), "--save", saved]
        environment = os.environ | {"LOCALISER_SOURCE": str(folder)}
        ended = subprocess.run(
            [*command, "--only", *exactly], check=False, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
        )
        if ended.returncode or not saved.exists():
            raise SystemExit(
                f"--against: the benchmarks do not run with the code of {reference}; compare with its page"
            )
        return load(saved)
