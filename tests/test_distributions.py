"""What is handed out holds what the project is, and nothing that a user left beside it."""

from __future__ import annotations

import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path, PurePosixPath

import pytest
from folders import ROOT
from installed import build

STRAYS = (
    "logs/office/log.yaml",
    "maps/mine.yaml",
    "results/corridor/1/run.rrd",
    "drive.mcap",
    ".hypothesis/examples/a",
    "build/site/index.html",
    "localiser/geometry/__pycache__/a.pyc",
)
GENERATED = {"PKG-INFO"}


def tracked() -> set[str]:
    """Return the files of the project; skips where nobody can tell."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return {name for name in listed.stdout.splitlines() if (ROOT / name).is_file()}


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> tuple[set[str], set[str], set[str]]:
    """Return the project's files, those of the source archive and those of the wheel, built beside a user's files."""
    project, folder = tracked(), tmp_path_factory.mktemp("project")
    for name in project:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    for name in STRAYS:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("a user's")
    archive, wheel = build(folder, tmp_path_factory.mktemp("dist"))
    with tarfile.open(archive) as source, zipfile.ZipFile(wheel) as built:
        inside = {"/".join(PurePosixPath(name).parts[1:]) for name in source.getnames()}
        return project, inside, set(built.namelist())


def test_the_source_archive_is_the_project(archives: tuple[set[str], set[str], set[str]]) -> None:
    project, source, _ = archives
    own = {name for name in project if not name.startswith(("logs/", "maps/")) or "corridor" in name}
    assert source - GENERATED == own


def test_the_wheel_is_the_package_and_the_example(archives: tuple[set[str], set[str], set[str]]) -> None:
    project, _, wheel = archives
    example = {name for name in project if name.startswith(("configs/", "logs/corridor/", "maps/corridor.yaml"))}
    package = {name for name in project if name.startswith("localiser/")}
    metadata = {name for name in wheel if ".dist-info/" in name}
    assert wheel - metadata == package | {f"localiser/example/{name}" for name in example}


def test_an_editable_installation_gets_no_second_example(tmp_path: Path) -> None:
    from hatchling.builders.wheel import WheelBuilder

    wheel = next(WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["editable"]))
    with zipfile.ZipFile(wheel) as built:
        assert not any("example" in name for name in built.namelist())
