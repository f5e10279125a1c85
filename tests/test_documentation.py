"""The pages under docs/ and the README: links lead somewhere, and dotted names are modules, objects or settings."""

import importlib
import re
from pathlib import Path

from folders import ROOT

from localiser.config import Config

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PACKAGES = {path.stem for path in (ROOT / "localiser").iterdir() if not path.stem.startswith("_")}


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives the headings of a page."""
    headings = re.findall(r"^#+ +(.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            if target.startswith(("http://", "https://")):
                continue
            path, _, anchor = target.partition("#")
            linked = (page.parent / path).resolve() if path else page
            assert linked.exists(), f"{page}: {target}"
            assert not anchor or anchor in anchors(linked), f"{page}: {target}"


def is_setting(names: list[str]) -> bool:
    value: object = Config()
    for name in names:
        if isinstance(value, dict):  # whose keys are the user's
            return True
        if not hasattr(value, name):
            return False
        value = getattr(value, name)
    return True


def is_importable(names: list[str]) -> bool:
    for split in range(len(names), 0, -1):
        try:
            value: object = importlib.import_module(".".join(["localiser", *names[:split]]))
        except ModuleNotFoundError:
            continue
        for name in names[split:]:
            if not hasattr(value, name):
                return False
            value = getattr(value, name)
        return True
    return False


def test_dotted_names_exist() -> None:
    sections = PACKAGES | set(Config.model_fields)
    for page in PAGES:
        for text in set(re.findall(r"`([a-z_]+(?:\.\w+)+)[^`]*`", page.read_text(encoding="utf-8"))):
            names = text.removeprefix("localiser.").split(".")
            is_file = bool({"py", "md", "csv", "yaml", "json", "toml", "png", "jpg"} & set(names))
            if names[0] in sections and not is_file:
                assert is_setting(names) or is_importable(names), f"{page}: {text}"
