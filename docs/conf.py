"""The site of this folder: sphinx-build -W docs build/site."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))

from localiser import __version__  # noqa: E402

project = "localiser"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["Thumbs.db", ".DS_Store"]
html_theme = "furo"
html_title = "localiser"
html_static_path: list[str] = []
html_show_copyright = html_show_sphinx = html_copy_source = False
html_theme_options = {"sidebar_hide_name": False}
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "undoc-members": False}

OUTWARD_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(((?:\.\./)+[^)\s]*)\)")
LISTED = re.compile(r"^(?:[^<\n]*<)?([\w/.-]+?)>?$", re.MULTILINE)
TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.MULTILINE | re.DOTALL)


def read(app: Any, docname: str, source: list[str]) -> None:
    """Fit a page to the site: what is only in a clone is no link, and no page is left out of the contents."""
    page = Path(app.env.doc2path(docname)).parent
    source[0] = OUTWARD_LINK.sub(lambda link: _inward(link, page), source[0])
    if docname == "index":
        source[0] += _further(app.env.found_docs, source[0])


def _inward(link: re.Match[str], page: Path) -> str:
    target = (page / link[2].partition("#")[0]).resolve()
    return link[0] if target.is_relative_to(DOCS) else link[1]


def _further(pages: set[str], index: str) -> str:
    """Return the contents of those pages that the index does not list."""
    listed = {name for contents in TOCTREE.findall(index) for name in LISTED.findall(contents)}
    rest = sorted(page for page in pages - listed - {"index"} if not page.startswith("notes/"))
    return "\n".join(["", "```{toctree}", ":hidden:", ":caption: Further pages", *rest, "```", ""]) if rest else ""


def as_text(app: Any, what: str, name: str, thing: object, options: Any, lines: list[str]) -> None:
    """Have a docstring shown as it is written: it is plain text with `code`, no reStructuredText."""
    text = "\n".join(line.strip() for line in lines)
    pieces = re.split(r"(`[^`]+`)", text)
    lines[:] = "".join(_shown(piece) for piece in pieces).splitlines()


def _shown(piece: str) -> str:
    return f"`{piece}`" if piece.startswith("`") else re.sub(r"([*_|\\])", r"\\\1", piece)


def setup(app: Any) -> None:
    """Connect the functions above."""
    app.connect("source-read", read)
    app.connect("autodoc-process-docstring", as_text)
