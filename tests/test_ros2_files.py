"""Files for ROS 2 and Docker: what they call can be called."""

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest
import yaml
from folders import ROOT
from typer.main import get_command

from localiser.commands.main import app
from localiser.config import LiveParameters, read_config
from localiser.ros import outputs_named

FOLDER = ROOT / "examples" / "ros2"


SUBSTITUTION = re.compile(r"\$\((?:var|env) \w+\)")


def launched() -> list[str]:
    """Return the words of the launch file's call: ROS cuts it at substitutions, then splits each piece as a shell."""
    launch = yaml.safe_load((FOLDER / "localiser.launch.yaml").read_text(encoding="utf-8"))
    (cmd,) = (part["executable"]["cmd"] for part in launch["launch"] if "executable" in part)
    words = [""]
    for number, text in enumerate(SUBSTITUTION.split(cmd)):
        words[-1] += "x" if number else ""
        first, *others = shlex.split(text) or [""]
        words += [""] if text[:1].isspace() else []
        words[-1] += first
        words += [*others, ""] if text[-1:].isspace() else others
    return [word for word in words if word]


def commands() -> list[list[str]]:
    """Return every call of the program as words, without the values that others put in."""
    services = yaml.safe_load((FOLDER / "compose.yaml").read_text(encoding="utf-8"))["services"]
    calls = [service["command"][2].split("exec ")[1] for service in services.values() if service["command"][0] == "sh"]
    return [launched(), *(shlex.split(re.sub(r"\$\{[^}]*\}", "x", call)) for call in calls)]


@pytest.mark.parametrize("call", commands(), ids=" ".join)
def test_every_call_has_commands_and_options_that_there_are(call: list[str]) -> None:
    words = list(call)
    assert words.pop(0) == "localiser"
    command = get_command(app)
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    asked = {word.split("=")[0] for word in words if re.match(r"--?[a-z]", word)}
    assert asked <= known, asked - known


def settings() -> tuple[list[str], dict[str, str]]:
    """Return what the launch file sets, with x where an argument stands, and the defaults of its arguments."""
    launch = yaml.safe_load((FOLDER / "localiser.launch.yaml").read_text(encoding="utf-8"))["launch"]
    words = launched()
    defaults = {part["arg"]["name"]: part["arg"].get("default", "") for part in launch if "arg" in part}
    return [words[k + 1] for k, word in enumerate(words) if word == "--set"], defaults


def test_what_the_launch_file_sets_is_read() -> None:
    given, defaults = settings()
    as_it_is = [re.sub(r"(\w+)=x$", lambda found: f"{found[1]}={defaults[found[1]]}", text) for text in given]
    assert read_config(None, as_it_is).live == LiveParameters(namespace="/", publish={"pose": "amcl_pose"})
    asked = {"live.dds=x": "live.dds=7", "live.use_sim_time=x": "live.use_sim_time=true"}
    found = read_config(None, [asked.get(text, text) for text in given]).live
    assert (found.dds, found.use_sim_time, found.namespace) == (7, True, "x")


def test_two_robots_publish_on_topics_of_their_own() -> None:
    names = read_config(None, [text for text in settings()[0] if "publish" in text]).live.publish
    first, second = ({one.name for one in outputs_named(names, robot).values()} for robot in ("/robot1", "/robot2"))
    assert not first & second


def test_the_router_has_the_version_that_is_locked() -> None:
    """Both ends of a link speak one version of zenoh's protocol; newer features need a router that has them."""
    (locked,) = re.findall(r"^eclipse-zenoh==(\S+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    assert f"image: eclipse/zenoh:{locked}\n" in (FOLDER / "compose.yaml").read_text(encoding="utf-8")


def shell_scripts() -> dict[str, str]:
    """Return the scripts of the services, as the shell gets them."""
    services = yaml.safe_load((FOLDER / "compose.yaml").read_text(encoding="utf-8"))["services"]
    commands = {name: service["command"] for name, service in services.items()}
    return {name: words[2].replace("$$", "$") for name, words in commands.items() if words[0] == "sh"}


@pytest.mark.parametrize(("name", "script"), shell_scripts().items())
def test_a_container_installs_the_newest_wheel(name: str, script: str, tmp_path: Path) -> None:
    for age, version in enumerate(("0.3.0", "0.10.0", "0.2.0")):
        wheel = tmp_path / f"localiser-{version}-py3-none-any.whl"
        wheel.touch()
        os.utime(wheel, (1e9 - age, 1e9 - age))
    install, _, _ = script.replace("/dist", str(tmp_path)).partition("&&")
    shown = install.replace("pip install -q", "echo")
    said = subprocess.run(["sh", "-c", shown], capture_output=True, text=True, check=True).stdout
    assert said.strip() == f"{tmp_path}/localiser-0.3.0-py3-none-any.whl[live]", name


def test_the_map_of_the_container_is_in_a_clone() -> None:
    (default,) = re.findall(r"\$\{MAP:-([^}]*)\}", shell_scripts()["localiser"])
    assert (ROOT / default).is_file()


def test_every_argument_of_the_launch_file_is_used() -> None:
    text = (FOLDER / "localiser.launch.yaml").read_text(encoding="utf-8")
    named = {part["arg"]["name"] for part in yaml.safe_load(text)["launch"] if "arg" in part}
    assert named == set(re.findall(r"\$\(var (\w+)\)", text))
