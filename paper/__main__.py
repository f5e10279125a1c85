"""Make the tables and the figure of docs/paper.md anew: python -m paper."""

from __future__ import annotations

import re
from pathlib import Path

from paper.figure import figure_png
from paper.reproduce import reproduce

PLACES, SEED = 10, 0
DOCS = Path(__file__).resolve().parents[1] / "docs"


def main() -> None:
    """Replace what stands between the marks of each table."""
    reproduction = reproduce(PLACES, SEED, _unseen)
    (DOCS / "figures" / "paper.png").write_bytes(figure_png(reproduction.found))
    page = (DOCS / "paper.md").read_text()
    for sheet in reproduction.sheets:
        title, *rest = sheet.markdown().rstrip().splitlines()
        table = "\n".join([f"**{title.removeprefix('## ')}**", *rest])
        marks = re.compile(rf"(<!-- {sheet.name} -->\n).*?(\n<!-- end -->)", re.DOTALL)
        page, count = marks.subn(lambda found, table=table: found[1] + table + found[2], page)
        if count != 1:
            raise SystemExit(f"expected one place for the table {sheet.name}, found {count}")
    (DOCS / "paper.md").write_text(page)


def _unseen() -> None:
    """Show no progress."""


if __name__ == "__main__":
    main()
