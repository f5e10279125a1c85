"""Files for ROS 2 and Docker, and the commands of docs/ros2.md: what they call can be called."""

from __future__ import annotations

import re
import shlex

import pytest
import yaml
from folders import ROOT
from typer.main import get_command

from localiser.commands.main import app

FOLDER = ROOT / "examples" / "ros2"


def commands() -> list[str]:
    """Return every call of the program, without the values that others put in."""
    launch = yaml.safe_load((FOLDER / "localiser.launch.yaml").read_text(encoding="utf-8"))
    calls = [part["executable"]["cmd"] for part in launch["launch"] if "executable" in part]
    services = yaml.safe_load((FOLDER / "compose.yaml").read_text(encoding="utf-8"))["services"]
    calls += [service["command"][2].split("exec ")[1] for service in services.values() if service["command"][0] == "sh"]
    page = (ROOT / "docs" / "ros2.md").read_text(encoding="utf-8")
    calls += [line.split(" #")[0] for line in re.findall(r"^    (localiser .*)$", page, re.MULTILINE)]
    return [re.sub(r"\$\((?:var|env) \w+\)|\$\{[^}]*\}", "x", call) for call in calls]


@pytest.mark.parametrize("call", commands())
def test_every_call_has_commands_and_options_that_there_are(call: str) -> None:
    words = shlex.split(call)
    assert words.pop(0) == "localiser"
    command = get_command(app)
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    asked = {word.split("=")[0] for word in words if re.match(r"--?[a-z]", word)}
    assert asked <= known, asked - known


def test_there_are_calls() -> None:
    assert len(commands()) >= 7


def test_every_argument_of_the_launch_file_is_used() -> None:
    text = (FOLDER / "localiser.launch.yaml").read_text(encoding="utf-8")
    named = {part["arg"]["name"] for part in yaml.safe_load(text)["launch"] if "arg" in part}
    assert named == set(re.findall(r"\$\(var (\w+)\)", text))
