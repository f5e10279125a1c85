"""Count the lines of code of Python files: without blank lines, comments and docstrings.

    python benchmarks/code_size.py localiser paper
    python benchmarks/code_size.py localiser --against REVISION

With `--against`, the same folders of a git revision are counted beside it. A folder that the revision lacks counts 0
there, so that code that moved elsewhere still counts.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import tokenize
from collections.abc import Iterable
from pathlib import Path

_NOT_CODE = frozenset(
    [tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER]
)


def code_lines(source: str) -> int:
    """Return how many lines of a module hold code; a docstring or any other bare string is none."""
    bare_strings = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    code = {line for token in tokens if token.type not in _NOT_CODE for line in range(token.start[0], token.end[0] + 1)}
    return len(code - bare_strings)


def sources_now(folder: str) -> Iterable[str]:
    """Return the modules of a folder as they are on the disk."""
    return [path.read_text() for path in sorted(Path(folder).rglob("*.py"))]


def sources_at(revision: str, folder: str) -> Iterable[str]:
    """Return the modules of a folder as they were at a git revision."""
    listed = subprocess.run(
        ["git", "ls-tree", "-r", "--name-only", revision, f"{folder}/"], capture_output=True, text=True, check=True
    )
    names = [name for name in listed.stdout.splitlines() if name.endswith(".py")]
    return [
        subprocess.run(["git", "show", f"{revision}:{name}"], capture_output=True, text=True, check=True).stdout
        for name in names
    ]


def counts(sources: Iterable[str]) -> tuple[int, int, int]:
    """Return the number of files, of all lines and of lines of code."""
    texts = list(sources)
    return len(texts), sum(text.count("\n") for text in texts), sum(map(code_lines, texts))


def main() -> None:
    """Print files, lines and lines of code of each folder and of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+")
    parser.add_argument("--against", metavar="REVISION")
    arguments = parser.parse_args()

    revisions = [arguments.against] if arguments.against else []
    totals = {}
    print(f"{'folder':24}{'revision':>12}{'files':>8}{'lines':>8}{'code':>8}")
    for revision in (*revisions, None):
        rows = [
            counts(sources_at(revision, folder) if revision else sources_now(folder)) for folder in arguments.folders
        ]
        for folder, row in zip(arguments.folders, rows, strict=True):
            print(f"{folder:24}{(revision or 'now')[:10]:>12}{row[0]:8}{row[1]:8}{row[2]:8}")
        totals[revision] = sum(row[2] for row in rows)
    if arguments.against:
        print(f"code now / at {arguments.against}: {totals[None] / totals[arguments.against]:.3f}")


if __name__ == "__main__":
    main()
