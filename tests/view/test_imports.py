"""Libraries that take long to import are imported by those who use them."""

import subprocess
import sys

SLOW = {"rosbags", "rerun", "scipy", "matplotlib", "pyarrow", "filterpy", "rich", "lz4"}
PACKAGES = ("storage", "view", "evaluate", "config", "replay", "commands.options")


def imported(code: str) -> list[set[str]]:
    """Return what each line tells that code prints in a process of its own: names of modules."""
    code = f"import importlib, sys\ndef told(): print(*{{name.split('.')[0] for name in sys.modules}})\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return [set(line.split()) for line in done.stdout.splitlines()]


def test_packages_import_no_slow_library() -> None:
    """One after another: whoever comes later may import no more than the ones before."""
    code = f"for name in {PACKAGES}: importlib.import_module(f'localiser.{{name}}'); told()"
    for package, names in zip(PACKAGES, imported(code), strict=True):
        allowed = {"rich"} if package.startswith("commands") else set()  # the command line's own
        assert not names & (SLOW - allowed), package


def test_the_command_line_imports_nothing_that_help_does_not_need() -> None:
    (names,) = imported("import localiser.__main__; told()")
    assert not names & (SLOW - {"rich"} | {"numpy", "numba", "cv2", "pydantic", "yaml"})
