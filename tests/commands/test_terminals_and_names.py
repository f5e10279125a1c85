"""Every command on a terminal of ASCII, with names that are no text or too long, and where nothing can be written."""

from __future__ import annotations

import os
import shutil
import sys
import traceback
from contextlib import suppress
from pathlib import Path

import attack_inputs
import pytest

pytestmark = [
    pytest.mark.slow,  # commands by the dozen; one command for each of these is in test_main.py and test_output.py
    pytest.mark.skipif(sys.platform != "linux", reason="names that are no text, /dev/full"),
]
LONG = "n" * 300
WRITERS = [name for name, (_, line) in attack_inputs.LINES.items() if "OUT" in line]


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = attack_inputs.make(tmp_path_factory.mktemp("good") / "samples")
    attack_inputs.use_samples(folder)
    return folder


class Shell:
    """Runs commands on changed inputs, on a terminal of ASCII or into a file."""

    def __init__(self, samples: Path, folder: Path) -> None:
        self.samples, self.folder = samples, folder

    def put(self, name: str, folder: Path) -> Path:
        """Copy the input of a command into a folder, and return its path."""
        source = self.samples / attack_inputs.LINES[name][0]
        folder.mkdir(exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / source.name)
        return folder / source.name

    def __call__(self, name: str, given: Path, out: Path, stdout: Path | None = None) -> tuple[object, str]:
        """Return how a command ended, and what it said; another exception than the program's own is a failure."""
        line = attack_inputs.LINES[name][1]
        places = {"SAMPLES": str(self.samples), "IN": str(given), "OUT": str(out)}
        words = [attack_inputs.in_places(word, places) for word in line.split() if word != "--quiet"]
        words += attack_inputs.FEW if line.startswith(("replay", "batch")) else []
        said, before = self.folder / "said", (sys.stdout, sys.stderr)
        code: object = 0
        printed = (stdout or self.folder / "printed").open("w", encoding="ascii")
        with suppress(OSError), printed, said.open("w", encoding="ascii") as errors:  # closing it tells again
            sys.stdout, sys.stderr = printed, errors
            try:
                from localiser.commands import main

                sys.argv = ["localiser", *words]
                main()
            except SystemExit as end:
                code = end.code
            except BaseException:
                raise AssertionError(traceback.format_exc()) from None
            finally:
                sys.stdout, sys.stderr = before
        text = said.read_text()
        assert "Traceback" not in text
        assert not list(self.folder.rglob(".localiser-*")), "a draft is left"
        return code, text


@pytest.fixture
def shell(samples: Path, tmp_path: Path) -> Shell:
    return Shell(samples, tmp_path)


@pytest.mark.parametrize("name", attack_inputs.LINES)
def test_names_that_are_no_text_on_a_terminal_of_ascii(shell: Shell, tmp_path: Path, name: str) -> None:
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe"))
    code, text = shell(name, shell.put(name, odd), odd)
    assert code in (0, None) or "Error: " in text


@pytest.mark.parametrize("name", attack_inputs.LINES)
def test_an_output_that_is_full(shell: Shell, tmp_path: Path, name: str) -> None:
    code, text = shell(name, shell.put(name, tmp_path / "in"), tmp_path, Path("/dev/full"))
    assert code in (0, None) or "No space left on device" in text or "Error: " in text


@pytest.mark.parametrize("name", attack_inputs.LINES)
def test_an_input_whose_name_is_too_long(shell: Shell, tmp_path: Path, name: str) -> None:
    code, text = shell(name, tmp_path / LONG, tmp_path)
    assert code == 2 and text


@pytest.mark.parametrize("name", WRITERS)
def test_a_folder_that_cannot_be_made(shell: Shell, tmp_path: Path, name: str) -> None:
    """One whose name is too long, and a file in the place of a folder."""
    (tmp_path / "file").write_text("mine")
    given = shell.put(name, tmp_path / "in")
    for out in (tmp_path / LONG, tmp_path / "file"):
        code, text = shell(name, given, out)
        assert code not in (0, None) and text
    assert (tmp_path / "file").read_text() == "mine"
