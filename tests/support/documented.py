"""The commands and the code in the pages of the documentation."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from folders import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
TUTORIALS = [ROOT / "docs" / "guide.md", *sorted((ROOT / "docs" / "tutorials").glob("*.md"))]
"""Pages that run as a whole, from top to bottom."""
_MEANT = re.compile(r"[A-Z…|<>\[\]]|\.\.\.")
"""What stands for something else: LOG, wheel|vision, …"""
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```|((?:^    [^\n]*\n)+)", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"`(localiser [^`]+)`")


@dataclass(frozen=True, slots=True)
class Block:
    """What stands in one block of a page: shell ("sh"), Python ("python"), or another language."""

    language: str
    text: str

    def commands(self) -> list[list[str]]:
        """Return the words of every `localiser` command, as a shell splits them."""
        lines = self.text.replace("\\\n", " ").splitlines()
        starts = (line.strip().split("&&")[-1].strip() for line in lines)
        return [_words(line) for line in starts if re.match(r"(\.venv/bin/)?localiser ", line)]


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page in its order."""
    found = _BLOCK.findall(page.read_text(encoding="utf-8"))
    return [Block(language, text) if text else Block("", indented) for language, text, indented in found]


def commands(page: Path) -> list[list[str]]:
    """Return the words of every `localiser` command in a page's blocks."""
    return [words for block in blocks(page) for words in block.commands()]


def mentions(page: Path) -> list[list[str]]:
    """Return the words of every `localiser` command in a page's text; arguments may be left out there."""
    return [_words(text.replace("\n", " ")) for text in _INLINE.findall(page.read_text(encoding="utf-8"))]


def stands_for_another(words: list[str]) -> bool:
    """Whether a command is a pattern, such as `localiser replay LOG`."""
    return any(_MEANT.search(word) for word in words)


def _words(line: str) -> list[str]:
    return shlex.split(line, comments=True)[1:]
