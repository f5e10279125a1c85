"""The pages of the documentation: links lead somewhere, names and commands exist, and code blocks run as written."""

import copy
import importlib
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import typer
from documented import PAGES, TUTORIALS, blocks, commands, mentions, stands_for_another
from folders import ROOT
from PIL import Image
from short_log import CORRIDOR, cut_log
from typer.core import TyperGroup

from localiser import edges, storage
from localiser.commands import app, demo
from localiser.config import Config

PACKAGES = {path.stem for path in (ROOT / "localiser").iterdir() if not path.stem.startswith("_")}
FRAMES, FEW_FRAMES = 20, 10
"""Images of the example that commands run on; fewer where a tutorial replays them a dozen times."""


# -- links and names --------------------------------------------------------------------------------------------------


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


# -- commands ---------------------------------------------------------------------------------------------------------


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


def test_every_command_is_one_of_the_program() -> None:
    """As it is written, where nothing in it stands for something else."""
    assert len([words for page in PAGES for words in commands(page)]) > 60
    for page in PAGES:
        for words in commands(page):
            if not stands_for_another(words):
                parsed(words)
        for words in mentions(page):
            if not stands_for_another(words) and words != ["--install-completion"]:  # which would be done
                with suppress(typer.BadParameter):
                    parsed(words)


def test_programs_beside_the_package_have_the_options_that_are_documented() -> None:
    """They take minutes to hours, so they are not run here; tests/benchmarks runs their parts."""
    for page in PAGES:
        found = re.findall(r"\bpython ((?:benchmarks|docs)/\w+\.py)([^\n`#]*)", page.read_text(encoding="utf-8"))
        for program, arguments in found:
            if program.endswith("mrclam.py"):  # the program itself, with another format
                parsed(arguments.split())
                continue
            code = (ROOT / program).read_text(encoding="utf-8")
            for option in re.findall(r"--[a-z-]+", arguments):
                assert f'"{option}"' in code, f"{page}: {program} has no option {option}"


# -- code blocks ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [page for page in TUTORIALS if page.stem != "fleet"], ids=lambda page: page.stem
)  # that one waits for robots: tests/live/test_processes.py
def test_a_tutorial_runs_as_it_is_written(page, localiser, tmp_path, monkeypatch):
    """From top to bottom, on the first images of the example: what is marked as shell or Python."""
    shipped = tmp_path / "localiser" / "example"
    (shipped / "logs").mkdir(parents=True)
    cut_log(CORRIDOR, shipped / demo.LOG, FEW_FRAMES if page.stem == "many-logs" else FRAMES)
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


RUN = """
    replay logs/corridor --observation slope --seed 1
    replay logs/corridor --start global
    replay logs/corridor --bag corridor.mcap
    evaluate results/corridor/latest
    camera tilt logs/corridor -o logs/levelled
    camera calibrate --draw-board board.png --board charuco --squares 8x6 --square-m 0.03
    convert logs/corridor corridor.mcap
    map build logs/corridor -o mine.yaml
    map show mine.yaml
    map check mine.yaml --log logs/corridor -o coverage.png
"""
"""Quick commands of the README and of pages that are no tutorials. Others wait for Ctrl-C, take long, or name a file of
one's own; the tests of commands run those."""


@pytest.mark.slow
def test_quick_commands_run_as_they_are_written(localiser, tmp_path, monkeypatch):
    """Beside the first images of the log that ships."""
    documented = [words for page in PAGES for words in commands(page)]
    (tmp_path / "logs").mkdir()
    cut_log(CORRIDOR, tmp_path / "logs" / "corridor", FRAMES)
    monkeypatch.chdir(tmp_path)
    for words in map(shlex.split, RUN.strip().splitlines()):
        assert words in documented
        folder = tmp_path / "corridor.mcap"
        folder.unlink() if folder.is_file() else shutil.rmtree(folder, ignore_errors=True)
        result = localiser(*words)
        assert result.exit_code == 0, f"{words}: {result.out}{result.err}"


EXTENDING = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
SEAMS = dict(re.findall(r"^## Your own ([\w ]+)$.*?```python\n(.*?)```", EXTENDING, re.MULTILINE | re.DOTALL))


@pytest.fixture
def _registered_for_one_test() -> Iterator[None]:
    detectors, formats = copy.copy(edges.DETECTORS), copy.copy(storage.FORMATS)
    yield
    edges.DETECTORS.clear()
    edges.DETECTORS.update(detectors)
    storage.FORMATS[:] = formats


def test_every_seam_has_an_example() -> None:
    assert list(SEAMS) == ["detector", "observation", "motion model", "log reader", "sink"]


def code_of(page: str) -> str:
    return "\n".join(block.text for block in blocks(ROOT / page) if block.language == "python")


PAGES_OF_CODE = {**SEAMS, "docs/api.md": code_of("docs/api.md")}
SLOW = ("motion model", "sink", "docs/api.md")  # along the whole of a log


@pytest.mark.usefixtures("_registered_for_one_test")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in PAGES_OF_CODE]
)
def test_code_prints_what_the_page_says(name, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    code = PAGES_OF_CODE[name]
    exec(compile(code, name, "exec"), {"__name__": "page"})
    assert capsys.readouterr().out.splitlines() == re.findall(r"^# prints: (.*)$", code, re.MULTILINE)


@pytest.mark.parametrize("name", ["recording.png", "report.png", "floors.png", "markers.png"])
def test_pictures_of_a_run_are_of_this_version(name: str) -> None:
    """`python docs/make_pictures.py` makes them anew."""
    sys.path.insert(0, str(ROOT / "docs"))
    made = importlib.import_module("make_pictures")
    with Image.open(made.IMAGES / name) as picture:
        assert picture.text["localiser"] == made.version_of(name)
