"""Libraries that take long to import are imported by those who use them."""

from __future__ import annotations

import subprocess
import sys

import pytest

SLOW = {"rosbags", "rerun", "scipy", "matplotlib", "pyarrow", "filterpy", "rich", "lz4"}


@pytest.mark.parametrize("package", ["storage", "view", "evaluate", "config", "replay", "commands.options"])
def test_packages_import_no_slow_library(package: str) -> None:
    code = f"import sys, localiser.{package}; print(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    allowed = {"rich"} if package.startswith("commands") else set()  # the command line's own
    assert not set(done.stdout.split()) & (SLOW - allowed)


def test_the_command_line_imports_nothing_that_help_does_not_need() -> None:
    code = "import sys, localiser.__main__; print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & (SLOW - {"rich"} | {"numpy", "numba", "cv2", "pydantic", "yaml"})
