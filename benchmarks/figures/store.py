"""The committed file of figures, one figure a line, so that a change to it can be read."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from figures.compare import Figure, Key

FORMAT = "localiser-baseline/1"
LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "filterpy")


def machine() -> dict[str, str]:
    """Return what the last bits of a result depend on: processor, Python, libraries."""
    from llvmlite import binding

    processor = f"{platform.machine()} {binding.get_host_cpu_name()}"
    return {"processor": processor, "python": platform.python_version()} | {name: version(name) for name in LIBRARIES}


def read(path: Path) -> tuple[dict[Key, Figure], dict[str, dict[str, Any]]]:
    """Return the figures by group, case and measure, and what is said of each group."""
    if not path.exists():
        return {}, {}
    data = json.loads(path.read_text(encoding="utf-8"))
    if data.get("format") != FORMAT:
        raise SystemExit(f"{path}: expected the format {FORMAT}, found {data.get('format')!r}")
    figures = {
        (group, case, measure): Figure(**values)
        for group, content in data["groups"].items()
        for case, measures in content["figures"].items()
        for measure, values in measures.items()
    }
    return figures, {group: content["about"] for group, content in data["groups"].items()}


def write(path: Path, figures: Mapping[Key, Figure], about: Mapping[str, Mapping[str, Any]]) -> None:
    """Write all figures."""
    lines = ["{", f' "format": {json.dumps(FORMAT)},', ' "groups": {']
    groups = []
    for group, said in about.items():
        cases: dict[str, list[str]] = {}
        for (own, case, measure), figure in figures.items():
            if own == group:
                cases.setdefault(case, []).append(f"    {json.dumps(measure)}: {_figure(figure)}")
        inner = ",\n".join(f"   {json.dumps(case)}: {{\n" + ",\n".join(rows) + "\n   }" for case, rows in cases.items())
        head = f'  {json.dumps(group)}: {{"about": {json.dumps(said)}, "figures": {{'
        groups.append(f"{head}\n{inner}\n  }}}}")
    path.write_text("\n".join([*lines, ",\n".join(groups), " }", "}"]) + "\n", encoding="utf-8")


def _figure(figure: Figure) -> str:
    """Return a figure without what is as it is by default."""
    plain = asdict(Figure(figure.value, figure.loss))
    return json.dumps({name: v for name, v in asdict(figure).items() if name in ("value", "loss") or v != plain[name]})
