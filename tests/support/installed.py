"""The project as it is handed out: its archives built, and its wheel installed where no clone is."""

import os
import re
import subprocess
import sys
import venv
from pathlib import Path

from folders import ROOT

LOCKED = re.compile(r"^([\w.-]+==[^\\\n]+)", re.MULTILINE)
"""A package with its version and the Pythons that it is for, without the hashes."""


def build(source: Path, out: Path) -> tuple[Path, Path]:
    """Return source archive and wheel of the project in `source`, built into `out`."""
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(out)]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    (archive,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return archive, wheel


class Installed:
    """An environment of its own with the wheel and what it needs, in the versions that the project has locked."""

    def __init__(self, folder: Path) -> None:
        _, wheel = build(ROOT, folder / "dist")
        constraints = folder / "constraints.txt"
        locked = LOCKED.findall((ROOT / "requirements.lock").read_text(encoding="utf-8"))
        constraints.write_text("\n".join(locked))
        venv.create(folder / "venv", with_pip=True)
        self.bin = folder / "venv" / "bin"
        pip = [self.bin / "python", "-m", "pip", "install", "--quiet", "--no-compile", "--constraint", constraints]
        subprocess.run([*pip, f"localiser[live] @ {wheel.as_uri()}"], check=True, env=self.environment())

    def environment(self) -> dict[str, str]:
        """Return environment variables in which nothing leads to the clone."""
        return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}

    def __call__(self, *arguments: object, cwd: Path) -> str:
        """Run `localiser`, which must succeed, in a folder; return what it printed."""
        command = [str(self.bin / "localiser"), *map(str, arguments)]
        run = subprocess.run(command, cwd=cwd, env=self.environment(), capture_output=True, text=True, check=False)
        assert run.returncode == 0, f"{command}: {run.stdout}{run.stderr}"
        return run.stdout
