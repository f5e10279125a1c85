"""A program that speaks by Debian's Fast DDS: built from an IDL file and one source."""

import shutil
import subprocess
from pathlib import Path

SOURCES = Path(__file__).resolve().parent / "fastdds"
TOOLS = ("fastddsgen", "g++")
NEEDS = "needs Debian's fastddsgen, libfastrtps-dev and g++"


def can_be_built() -> bool:
    """Whether there is what it is built with."""
    return all(shutil.which(tool) for tool in TOOLS)


def built_in(folder: Path) -> Path:
    """Build the program in a folder and return its path."""
    for name in ("ros.idl", "peer.cpp"):
        shutil.copy(SOURCES / name, folder)
    sources = ["peer.cpp", "ros.cxx", "rosPubSubTypes.cxx"]
    for command in (
        ["fastddsgen", "-replace", "ros.idl"],
        ["g++", "-std=c++17", "-O1", *sources, "-lfastrtps", "-lfastcdr", "-o", "peer"],
    ):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "peer"
