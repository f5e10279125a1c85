"""What docs/architecture.md names exists: its layers are those that are checked, its stations can be imported."""

import importlib
import re
import tomllib

from folders import ROOT

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def layers() -> list[set[str]]:
    """Return the modules of every row of the table of layers, from the ground up."""
    table = PAGE.split("<!-- layers:")[1].split("\n\n")[1]
    return [set(re.findall(r"`([\w.]+)`", row.split("|")[1])) for row in table.splitlines()[2:]]


def stations() -> list[str]:
    """Return every dotted name in the drawing of the way of one image."""
    drawing = PAGE.split("<!-- stations:")[1].split("```")[1]
    packages = "|".join(name for row in layers() for name in row)
    return re.findall(rf"\b((?:{packages})(?:\.\w+)+)", drawing)


def found(name: str) -> object:
    """Return the module or the object in a module with this dotted name in the package."""
    *parents, last = name.split(".")
    module = importlib.import_module(".".join(["localiser", *parents]))
    return getattr(module, last, None) or importlib.import_module(f"localiser.{name}")


def test_layers_are_those_that_are_checked() -> None:
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    checked = [set(re.split(r"\s*[|:]\s*", row)) for row in contract[0]["layers"]]
    assert layers() == checked[::-1]
    assert len(checked) <= 13


def test_every_station_and_seam_exists() -> None:
    seams = re.findall(r"`(\w+\.\w+)`", PAGE.split("## How to extend")[1].split("##")[0])
    assert len(stations()) >= 10 and len(seams) >= 5
    for name in [*stations(), *seams]:
        assert found(name) is not None, name


def test_every_file_in_a_package_exists() -> None:
    table = PAGE.split("<!-- files:")[1].split("\n\n")[1]
    for row in table.splitlines()[2:]:
        package, files = re.findall(r"`(\w+)`", row.split("|")[1])[0], re.sub(r"\(.*?\)", "", row.split("|")[2])
        for name in re.findall(r"`(\w+)`", files):
            assert (ROOT / "localiser" / package / f"{name}.py").exists(), f"{package}.{name}"
