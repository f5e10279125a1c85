"""Count the project: lines and files of every package, words of documentation, commands and options.

    python benchmarks/code_size.py            # the table, beside the budget
    python benchmarks/code_size.py --check    # exit code 1 where something is above its ceiling

Lines are those of all kinds, in Python files. What grows has to pay with something else of its group: where the project
is not at its goal yet, the ceiling is what it has now, and goes down with it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from typer.main import get_command

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from localiser.commands import app  # noqa: E402

FILTER = ("observation", "filter", "relocalisation", "visual_odometry")
CORE = ("edges", "landmarks", "particles", "motion", "geometry", "documents", "camera", "localiser", "errors")

# What is counted: the ceiling of today, and the goal.
BUDGETS = {
    "lines: " + ", ".join(FILTER): (4_600, 4_600),
    "lines: " + ", ".join(CORE): (5_127, 5_200),
    "lines: around the core": (24_480, 24_500),
    "lines: all of localiser": (34_144, 34_300),
    "files: all of localiser": (190, 220),
    "lines: tests": (28_000, 28_000),
    "lines: benchmarks": (6_500, 6_500),
    "lines: other Python": (1_600, 1_600),
    "words: docs, README, CHANGELOG": (45_000, 45_000),
    "commands": (24, 24),
    "options": (125, 125),
}


def main() -> None:
    """Print the table; with --check end with exit code 1 where something is above its ceiling."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit code 1 where something is above its ceiling")
    arguments = parser.parse_args()
    packages = by_package()
    print(f"{'package':<24}{'files':>8}{'lines':>8}{'below 60 lines':>16}")
    for name, lengths in packages.items():
        print(f"{name:<24}{len(lengths):>8}{sum(lengths):>8}{sum(length < 60 for length in lengths):>16}")
    found = counted(packages)
    width = max(map(len, BUDGETS)) + 2
    print(f"\n{'':<{width}}{'now':>8}{'ceiling':>9}{'goal':>8}")
    over = [name for name, (ceiling, _) in BUDGETS.items() if found[name] > ceiling]
    for name, (ceiling, goal) in BUDGETS.items():
        print(f"{name:<{width}}{found[name]:>8}{ceiling:>9}{goal:>8}{'  above' if name in over else ''}")
    if over and arguments.check:
        sys.exit(1)


def by_package() -> dict[str, list[int]]:
    """Return the lengths in lines of the files of every package and module of localiser."""
    packages: dict[str, list[int]] = {}
    for path in python_files("localiser"):
        name = path.relative_to(ROOT / "localiser").parts[0].removesuffix(".py")
        packages.setdefault(name, []).append(lines_of(path))
    return packages


def counted(packages: dict[str, list[int]]) -> dict[str, int]:
    """Return what `BUDGETS` names. packages: see `by_package`."""
    lines = {name: sum(lengths) for name, lengths in packages.items()}
    core = [sum(lines[name] for name in names) for names in (FILTER, CORE)]
    commands = list(commands_of(get_command(app)))
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CHANGELOG.md"]
    others = [*python_files("docs"), *python_files("examples"), *python_files("paper"), *ROOT.glob("*.py")]
    values = [
        *core,
        sum(lines.values()) - sum(core),
        sum(lines.values()),
        sum(map(len, packages.values())),
        *(sum(map(lines_of, python_files(folder))) for folder in ("tests", "benchmarks")),
        sum(map(lines_of, others)),
        sum(len(page.read_text(encoding="utf-8").split()) for page in pages),
        len(commands),
        sum(parameter.param_type_name == "option" for command in commands for parameter in command.params),
    ]
    return dict(zip(BUDGETS, values, strict=True))


def python_files(folder: str) -> Iterable[Path]:
    """Return the Python files of a folder of the project."""
    return sorted((ROOT / folder).rglob("*.py"))


def lines_of(path: Path) -> int:
    """Return the number of lines of a file."""
    return path.read_text(encoding="utf-8").count("\n")


def commands_of(command: Any) -> Iterable[Any]:
    """Yield a command that does something by itself, and those below it."""
    if not getattr(command, "commands", {}) or getattr(command, "invoke_without_command", False):
        yield command
    for inner in getattr(command, "commands", {}).values():
        yield from commands_of(inner)


if __name__ == "__main__":
    main()
