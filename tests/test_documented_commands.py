"""What the documentation says to type: every command is one of the program, and tutorials run as they are written."""

from __future__ import annotations

import re
import shutil
from contextlib import suppress
from pathlib import Path

import pytest
import typer
from documented import FRAMES, PAGES, TUTORIALS, blocks, commands, mentions, stands_for_another
from folders import ROOT
from short_log import CORRIDOR, Localiser, cut_log
from typer.core import TyperGroup

from localiser.commands import app, demo


def parsed(words: list[str]) -> None:
    """Have the program understand words, without running them. Raises what says why it does not."""
    command, context, name = typer.main.get_command(app), None, "localiser"
    with suppress(typer.Exit):  # --help
        while isinstance(command, TyperGroup):
            context = command.make_context(name, list(words), parent=context)
            _, rest, _ = command.make_parser(context).parse_args(list(words))
            if not rest:
                return
            name, command, words = command.resolve_command(context, rest)
        command.make_context(name, list(words), parent=context)


def test_there_are_commands_to_test() -> None:
    assert len([words for page in PAGES for words in commands(page)]) > 80


def test_every_command_is_one_of_the_program() -> None:
    """As it is written, where nothing in it stands for something else."""
    for page in PAGES:
        for words in commands(page):
            if not stands_for_another(words):
                parsed(words)
        for words in mentions(page):
            if not stands_for_another(words) and words != ["--install-completion"]:  # which would be done
                with suppress(typer.BadParameter):
                    parsed(words)


def test_a_command_that_the_program_has_not_is_found() -> None:
    for words in (["repaly", "log"], ["replay", "log", "--sede", "1"], ["map", "biuld", "log"], ["evaluate"]):
        with pytest.raises(Exception, match=r"(?i)no such|missing"):
            parsed(words)


FEW_FRAMES = {"fleet": 10}
"""Images of the example in a tutorial that replays them a dozen times."""


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs_as_it_is_written(
    page: Path, localiser: Localiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From top to bottom, on the first images of the example."""
    shipped = tmp_path / "localiser" / "example"
    (shipped / "logs").mkdir(parents=True)
    cut_log(CORRIDOR, shipped / demo.LOG, FEW_FRAMES.get(page.stem, FRAMES))
    for part in ("configs", "maps"):
        shutil.copytree(ROOT / part, shipped / part)
    monkeypatch.setattr(demo, "PACKAGE", shipped.parent)
    monkeypatch.chdir(tmp_path)
    if "localiser demo --keep ." not in "".join(block.text for block in blocks(page)):
        shutil.copytree(shipped, tmp_path, dirs_exist_ok=True)
    ran = 0
    for block in blocks(page):
        if block.language == "python":
            exec(compile(block.text, str(page), "exec"), {"__name__": "page"})
        if block.language == "sh":
            for words in block.commands():
                result = localiser(*(name for word in words for name in named(word)))
                assert result.exit_code == 0, f"{words}: {result.out}{result.err}"
                ran += 1
    assert ran >= 2


def named(word: str) -> list[str]:
    """Return a word as a shell hands it on: the files that it names with a star, else itself."""
    return sorted(map(str, Path().glob(word))) if "*" in word else [word]


PROGRAM = re.compile(r"\bpython ((?:benchmarks|docs)/\w+\.py)([^\n`#]*)")


def test_programs_beside_the_package_have_the_options_that_are_documented() -> None:
    """They take minutes to hours, so they are not run here; tests/benchmarks runs their parts."""
    for page in PAGES:
        for program, arguments in PROGRAM.findall(page.read_text(encoding="utf-8")):
            if program.endswith("mrclam.py"):  # the program itself, with another format
                parsed(arguments.split())
                continue
            code = (ROOT / program).read_text(encoding="utf-8")
            for option in re.findall(r"--[a-z-]+", arguments):
                assert f'"{option}"' in code, f"{page}: {program} has no option {option}"
