"""Quick commands of the documentation run as they are written, page by page; of the others a list says why they do not.

Guide and tutorials run as a whole, by test_documented_commands.py.
"""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest
from documented import FRAMES, PAGES, TUTORIALS, commands, stands_for_another
from folders import ROOT
from short_log import CORRIDOR, Localiser, cut_log

LISTED = {
    "waits for Ctrl-C, a window or messages; tests/live and tests/view run it with a robot, or without a display": """
        replay logs/corridor --view web
        view results/corridor/latest
        live demo --view web
        live demo --set live.dds=42
        live --map maps/house.yaml --connect tcp/192.168.1.5:7447
        live --map logs/corridor/map.yaml
        live --map maps/house.yaml --record drive.db3
        live --map house.yaml --set live.publish.pose=amcl_pose
        live --map house.yaml --dds 0
        live --map house.yaml --dds 0 --set live.interface=eth0
        simulate logs/corridor --serve
    """,
    "asks the network or a camera of this computer; tests/commands and tests/live run it": """
        doctor
        doctor --set live.connect=tcp/192.168.1.5:7447
        doctor drive.db3
        doctor --image 0 --picture camera.png
    """,
    "takes more than 2 s; tests/batch runs it on a few images": """
        batch logs/corridor --seeds 0-4 --set mcl.particles=500,2000
        batch logs/corridor --seeds 0-4 --set observation.kind=line,slope -o results/new
        batch logs/* --seeds 0-4 -o results/new --against results/old
        batch logs/* --seeds 0-4 --cluster tcp://10.0.0.1:8786
        batch logs/corridor logs/office ../shared/data/house --start truth --seeds 0-4
            --set observation.kind=line,slope -o results/new
    """,
    "takes more than 2 s; the tutorials run it": """
        map build logs/corridor --poses slam -o corridor-map.yaml
        map build logs/corridor --poses slam -o mine.yaml --trajectory path.tum
    """,
    "takes more than 2 s; tests/simulate and tests/commands run parts of it": """
        simulate configs/worlds/office.yaml -o logs/office
    """,
    "writes the same file as another command on the page; tests/commands/map and tests/mapping run it": """
        map build logs/corridor --poses odometry -o mine.yaml
        map merge mine.yaml -o better.yaml
    """,
    "needs data that do not ship": """
        map build left_even right_even -o room.yaml
        replay left_odd --map room.yaml --start truth --seed 0
    """,
    "stands for a file of one's own": """
        camera sync drive
        camera calibrate views/*.png --floor floor.png --board charuco --squares 8x6 --square-m 0.1 -o camera.yaml
        convert drive.bag logs/drive
        convert a.bag b.db3
        convert drive.mp4 logs/drive --odometry odometry.csv --camera camera.yaml --every 0.2s
        replay drive.db3
        map build monday tuesday -o mine.yaml
        map build logs/corridor --poses mine.tum -o mine.yaml
        map plan building.yaml -o mine.yaml
        map align plan.yaml mine.yaml -o mine_in_plan.yaml
        map merge plan.yaml mine.yaml --align -o whole.yaml
        map align grid.yaml house.yaml -o house_in_grid.yaml
        map merge grid.yaml house.yaml --align -o whole.yaml
        map update mine.yaml logs/today -o newer.yaml
        odometry fit monday tuesday -o robot.yaml
        map build drive.mcap -o house.yaml
        map check house.yaml --log drive.mcap
        replay drive.mcap --map house.yaml
    """,
}
"""Commands that are not run here, by the reason why. A line that is indented further belongs to the one above."""


def listed() -> list[list[str]]:
    """Return the words of every command in the list."""
    joined = "\n".join(LISTED.values()).replace("\n            ", " ")
    return [shlex.split(line) for line in joined.splitlines() if line.strip()]


def runnable(page: Path) -> list[list[str]]:
    """Return the words of a page's commands that are run here, in order."""
    found = commands(page)
    return [words for words in found if not (stands_for_another(words) or words in listed() or words[0] == "=")]


OTHERS = [page for page in PAGES if page not in TUTORIALS]
WITH_COMMANDS = [page for page in OTHERS if runnable(page)]


def test_every_command_in_the_list_is_in_the_documentation() -> None:
    documented = [words for page in OTHERS for words in commands(page)]
    assert [words for words in listed() if words not in documented] == []
    assert all(listed().count(words) == 1 for words in listed())


def test_there_are_commands_to_run() -> None:
    assert sum(len(runnable(page)) for page in WITH_COMMANDS) >= 12


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: str(page.relative_to(ROOT)))
def test_quick_commands_of_a_page_run_as_they_are_written(
    page: Path, localiser: Localiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From top to bottom, beside the first images of the log that ships."""
    (tmp_path / "logs").mkdir()
    cut_log(CORRIDOR, tmp_path / "logs" / "corridor", FRAMES)
    for folder in ("configs", "maps"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    for words in runnable(page):
        result = localiser(*words)
        assert result.exit_code == 0, f"{words}: {result.out}{result.err}"
