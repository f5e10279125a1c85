"""Make the tables and the figure of docs/paper.md anew: python -m paper."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper.figure import figure_png
from paper.reproduce import reproduce

PLACES, SEED = 10, 0
DOCS = Path(__file__).resolve().parents[1] / "docs"


def main() -> None:
    """Replace what stands between the marks of each table."""
    argparse.ArgumentParser(prog="python -m paper", description=__doc__).parse_args()
    reproduction = reproduce(PLACES, SEED)
    (DOCS / "figures" / "paper.png").write_bytes(figure_png(reproduction.found))
    page = (DOCS / "paper.md").read_text()
    for sheet in reproduction.sheets:
        title, *rest = sheet.markdown().rstrip().splitlines()
        table = "\n".join([f"**{title.removeprefix('## ')}**", *rest])
        before, mark, after = page.partition(f"<!-- {sheet.name} -->\n")
        old, end, rest_of_page = after.partition("\n<!-- end -->")
        page = before + mark + table + end + rest_of_page
        if not (old and end):
            raise SystemExit(f"expected a place for the table {sheet.name} in docs/paper.md, found none")
    (DOCS / "paper.md").write_text(page)


if __name__ == "__main__":
    main()
