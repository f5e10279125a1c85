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
exclude_patterns = ["Thumbs.db", ".DS_Store", "notes"]  # notes are read in a clone
html_theme = "furo"
html_title = "localiser"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = html_show_sphinx = html_copy_source = False
html_theme_options = {"sidebar_hide_name": False}
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "Array": "Array"}
autodoc_default_options = {"members": True, "undoc-members": False}

OUTWARD_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(((?:(?:\.\./)+|notes/)[^)\s]*)\)")


def read(app: Any, docname: str, source: list[str]) -> None:
    """Fit a page to the site: what is only in a clone is no link."""
    page = Path(app.env.doc2path(docname)).parent
    source[0] = OUTWARD_LINK.sub(lambda link: _inward(link, page), source[0])


def _inward(link: re.Match[str], page: Path) -> str:
    target = (page / link[2].partition("#")[0]).resolve()
    return link[0] if target.is_relative_to(DOCS) and not target.is_relative_to(DOCS / "notes") else link[1]


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
