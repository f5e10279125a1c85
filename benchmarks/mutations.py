"""Do the tests notice a wrong formula? Seeded mutations, each in a copy of the repository, against the tests.

    python benchmarks/mutations.py --count 30 --seed 0

A mutation changes one operator or function of one formula: + to -, * to /, sin to cos, a sign dropped, < to >. The
formulas are those of geometry, camera, observation, motion, the optimal proposal and mapping. The tests of the mutated
package are run first. If none of them fails, all tests that are not slow are run. A mutation that no test notices is
printed with its line: either a test is missing or the mutation changes nothing.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

FORMULAS = {
    "geometry": (["localiser/geometry/*.py"], ["tests/geometry"]),
    "camera": (["localiser/camera.py"], ["tests/test_camera.py"]),
    "observation": (["localiser/observation/*.py"], ["tests/observation"]),
    "motion": (["localiser/motion/*.py"], ["tests/motion"]),
    "proposal": (["localiser/filter/optimal_proposal*.py"], ["tests/filter"]),
    "mapping": (["localiser/mapping/*.py"], ["tests/mapping"]),
}
_LEFT_OUT = ("compiled.py", "__init__.py", "parameters.py")  # no formulas

_OPERATORS: dict[type[ast.operator], ast.operator] = {
    ast.Add: ast.Sub(),
    ast.Sub: ast.Add(),
    ast.Mult: ast.Div(),
    ast.Div: ast.Mult(),
}
_COMPARISONS: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.Gt(),
    ast.Gt: ast.Lt(),
    ast.LtE: ast.Gt(),
    ast.GtE: ast.Lt(),
}
_FUNCTIONS = {"sin": "cos", "cos": "sin", "maximum": "minimum", "minimum": "maximum", "sqrt": "square", "exp": "log"}


@dataclass(frozen=True)
class Mutation:
    """One changed formula: the file, its line, what stood there and what stands there now."""

    group: str
    path: str
    line: int
    was: str
    now: str
    source: str


def changed(node: ast.AST) -> ast.AST | None:
    """Return the node with its meaning changed, None where it is no part of a formula."""
    match node:
        case ast.BinOp(op=op) if type(op) in _OPERATORS and not _is_text(node):
            return ast.BinOp(node.left, _OPERATORS[type(op)], node.right)
        case ast.Compare(ops=[op]) if type(op) in _COMPARISONS:
            return ast.Compare(node.left, [_COMPARISONS[type(op)]], node.comparators)
        case ast.UnaryOp(op=ast.USub(), operand=ast.Name() | ast.Attribute() | ast.Call() | ast.Subscript()):
            return node.operand
        case ast.Call(func=ast.Attribute(attr=name)) if name in _FUNCTIONS:
            return ast.Call(ast.Attribute(node.func.value, _FUNCTIONS[name], ast.Load()), node.args, node.keywords)
    return None


def _is_text(node: ast.BinOp) -> bool:
    return any(isinstance(each, ast.JoinedStr | ast.List | ast.Tuple) for each in ast.walk(node)) or any(
        isinstance(each, ast.Constant) and isinstance(each.value, str) for each in ast.walk(node)
    )


def mutations_of(group: str, path: Path) -> Iterator[Mutation]:
    """Yield every mutation of a module's functions."""
    source = path.read_text()
    lines = source.splitlines(keepends=True)
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef):
            continue
        for statement in function.body:
            for node in ast.walk(statement):
                new = changed(node)
                segment = ast.get_source_segment(source, node) if new is not None else None
                if new is None or segment is None or "\n" in segment:
                    continue
                text = ast.unparse(ast.fix_missing_locations(ast.copy_location(new, node)))
                begin, end = node.col_offset, node.end_col_offset or 0
                row = lines[node.lineno - 1].encode()
                mutated = (row[:begin] + f"({text})".encode() + row[end:]).decode()
                after = "".join([*lines[: node.lineno - 1], mutated, *lines[node.lineno :]])
                yield Mutation(group, str(path.relative_to(ROOT)), node.lineno, segment, text, after)


def drawn(count: int, seed: int) -> list[Mutation]:
    """Return `count` mutations, spread evenly over the groups, in different functions where there are enough."""
    generator = random.Random(seed)
    chosen: list[Mutation] = []
    for n in range(count):
        group = list(FORMULAS)[n % len(FORMULAS)]
        files = [path for pattern in FORMULAS[group][0] for path in ROOT.glob(pattern) if path.name not in _LEFT_OUT]
        possible = [found for path in sorted(files) for found in mutations_of(group, path)]
        taken = {(each.path, each.line) for each in chosen}
        chosen.append(generator.choice([found for found in possible if (found.path, found.line) not in taken]))
    return chosen


def run_tests(copy: Path, tests: list[str]) -> int:
    """Run tests in a copy of the repository until one fails; return the exit code of pytest."""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    return subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False).returncode


def is_noticed(mutation: Mutation, copy: Path) -> str:
    """Return which tests noticed the mutation, "" where none did."""
    target = copy / mutation.path
    original = target.read_text()
    target.write_text(mutation.source)
    try:
        for tests in (FORMULAS[mutation.group][1], ["tests"]):
            if run_tests(copy, tests) in (1, 2, 3):  # tests failed, could not be collected, or their preparation failed
                return " ".join(tests)
        return ""
    finally:
        target.write_text(original)


def main() -> None:
    """Print each mutation and what noticed it; end with 1 when one was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="print the mutations and run nothing")
    arguments = parser.parse_args()

    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        left_out = shutil.ignore_patterns(".git", ".venv", "results", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=left_out)
        if not arguments.list and run_tests(copy, ["tests/geometry"]) != 0:
            parser.error("tests/geometry fail without any mutation")
        for number, mutation in enumerate(drawn(arguments.count, arguments.seed), 1):
            noticed = "listed" if arguments.list else is_noticed(mutation, copy)
            survivors += not noticed
            verdict = f"noticed by {noticed}" if noticed else "NOT NOTICED"
            print(
                f"{number:3} {mutation.path}:{mutation.line}  {mutation.was}  →  {mutation.now}   {verdict}", flush=True
            )
    raise SystemExit(1 if survivors else 0)


if __name__ == "__main__":
    main()
