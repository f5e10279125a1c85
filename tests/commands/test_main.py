"""The command line: what it prints, and how it says that something is wrong."""

import csv
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from folders import ROOT
from short_log import CORRIDOR, FEW_PARTICLES, FRAMES, Localiser, cut_log
from small_log import write_edge_log, write_small_log
from typer.main import get_command

from localiser import __version__
from localiser.commands.main import app
from localiser.config import read_config


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return cut_log(CORRIDOR, tmp_path / "log", FRAMES)


# -- help and configuration -------------------------------------------------------------------------------------------


def test_version_is_printed_by_the_module_itself() -> None:
    done = subprocess.run([sys.executable, "-m", "localiser", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"localiser {__version__}\n", "")


def test_shown_configuration_is_the_one_in_force_and_reads_back(localiser: Localiser, tmp_path: Path) -> None:
    shown = localiser("config", "show", "--set", "mcl.particles=123", "--set", "observation.kind=slope")
    assert shown.exit_code == 0
    file = tmp_path / "config.yaml"
    file.write_text(shown.out)
    read = read_config(file)
    assert (read.mcl.particles, read.observation.kind) == (123, "slope")
    assert localiser("config", "show", "--config", file).out == shown.out


@pytest.mark.parametrize(
    "arguments",
    [
        ["repaly"],
        ["replay"],
        ["replay", CORRIDOR, "--seed", "-1"],
        ["replay", CORRIDOR, "--seed", str(2**32)],
        ["evaluate"],
    ],
)
def test_wrong_usage_is_told_on_stderr(localiser: Localiser, arguments: list[str]) -> None:
    result = localiser(*arguments)
    assert (result.exit_code, result.out) == (2, "")
    assert "Usage: localiser" in result.err


# -- evaluate and simulate --------------------------------------------------------------------------------------------


def test_evaluate_reads_what_replay_wrote(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    runs = [localiser.replay(log, tmp_path / "out", "--seed", seed) for seed in (0, 1)]
    result = localiser("evaluate", *runs)
    assert (result.exit_code, result.err) == (0, "")
    rmse = [json.loads((run / "metrics.json").read_text())["position_rmse_m"] for run in runs]
    lines = [line.split() for line in result.out.splitlines()]
    table = {line[0]: line[1:] for line in lines if line}
    assert table["corridor/1"][:2] == ["0", f"{rmse[0]:.3f}"]
    assert table["corridor/2"][:2] == ["1", f"{rmse[1]:.3f}"]
    assert localiser("evaluate", *runs, tmp_path / "out" / "corridor" / "latest").out == result.out, "the same run"

    latest = localiser("evaluate", tmp_path / "out" / "corridor")
    assert f"{rmse[1]:.3f}" in latest.out


def test_evaluate_prints_all_figures_for_programs(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    run = localiser.replay(log, tmp_path / "out")
    figures = json.loads((run / "metrics.json").read_text()) | json.loads((run / "timing.json").read_text())
    assert json.loads(localiser("evaluate", run, "--json").out) == {"corridor/1": figures}
    (row,) = csv.DictReader(localiser("evaluate", run, "--csv").out.splitlines())
    assert row["run"] == "corridor/1" and row["nees_mean"] == str(figures["nees_mean"])
    assert row["confidence.sure"] == str(figures["confidence"]["sure"])
    both = localiser("evaluate", run, "--csv", "--json")
    assert (both.exit_code, both.out) == (2, "") and "expected --json or --csv, found both" in both.err


def test_runs_of_the_same_name_keep_a_row_each(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    runs = [localiser.replay(log, tmp_path / seed, "--set", f"seed={seed}") for seed in "12"]
    assert [run.name for run in runs] == ["1", "1"]
    out = "".join(localiser("evaluate", *runs).out.split())  # long paths are folded
    assert all("".join(str(run).split()) in out for run in runs)


def test_evaluate_says_that_a_run_ended_early(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    few = with_cut_image(log)
    assert localiser("replay", log, "--out", tmp_path, "--no-rrd", "--quiet", *few).exit_code == 2
    result = localiser("evaluate", tmp_path / "corridor" / "latest")
    assert result.exit_code == 0
    assert result.err == "corridor/latest ended early: its figures are those of 3 frames.\n"


def test_evaluate_judges_any_trajectory_by_a_given_truth(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    run = localiser.replay(log, tmp_path / "out")
    rmse = json.loads((run / "metrics.json").read_text())["position_rmse_m"]
    files = [run / "trajectory.tum", run / "trajectory.csv", run]
    for truth in (run / "groundtruth.tum", log / "groundtruth.csv"):
        for file in files:
            result = localiser("evaluate", file, "--truth", truth)
            assert (result.exit_code, result.err) == (0, "")
            assert f" {rmse:.3f} " in result.out
    itself = localiser("evaluate", run / "groundtruth.tum", "--truth", run / "groundtruth.tum")
    assert " 0.000 " in itself.out

    later = tmp_path / "later.tum"
    later.write_text("".join(f"9{line}\n" for line in (run / "groundtruth.tum").read_text().splitlines()))
    apart = localiser("evaluate", run, "--truth", later)
    assert apart.exit_code == 2
    assert apart.err.startswith(f"Error: {later}: expected truth during the run")

    without = localiser("evaluate", run / "trajectory.tum")
    assert without.exit_code == 2 and "--truth" in without.err

    aligned = ("evaluate", run, "--json", "--align")
    assert localiser(*aligned, "se2").out == localiser(*aligned, "se2", "--truth", run / "groundtruth.tum").out
    assert "expected origin or se2, found 'sim3'" in localiser(*aligned, "sim3").err
    (run / "groundtruth.tum").unlink()
    assert "groundtruth.tum: --align needs true poses" in localiser(*aligned, "se2").err


def test_a_drive_that_sees_no_landmark_makes_no_log(localiser: Localiser, tmp_path: Path) -> None:
    world = yaml.safe_load((ROOT / "configs" / "worlds" / "corridor.yaml").read_text())
    world["camera"] |= {"width": 320, "height": 240, "focal_px": 277.0}
    world["drive"]["path"] = [{"to": [0.1, 0.7]}, {"to": [0.1, 0.69]}]
    short = tmp_path / "short.yaml"
    short.write_text(yaml.safe_dump(world))
    result = localiser("simulate", short, "-o", tmp_path / "log")
    assert result.exit_code == 2
    assert f"{short}: drive.path" in result.err
    assert not (tmp_path / "log").exists()


# -- bad input --------------------------------------------------------------------------------------------------------


class Bad(NamedTuple):
    """A way to spoil a replay.

    spoil: changes the log in a folder and returns further arguments, in which {log} is that folder. told: what the
    message must say.
    """

    spoil: Callable[[Path], list[str]]
    told: list[str]


def edited(name: str, edit: Callable[[list[str]], list[str]]) -> Callable[[Path], list[str]]:
    """Return what edits the lines of one file of a log."""

    def spoil(log: Path) -> list[str]:
        lines = edit((log / name).read_text().splitlines())
        (log / name).write_text("\n".join(lines) + "\n")
        return []

    return spoil


def replaced(old: str, new: str) -> Callable[[list[str]], list[str]]:
    """Return what replaces a text that must be there."""

    def edit(lines: list[str]) -> list[str]:
        assert any(old in line for line in lines)
        return [line.replace(old, new) for line in lines]

    return edit


def without_folder(log: Path) -> list[str]:
    shutil.rmtree(log)
    return []


def with_cut_image(log: Path) -> list[str]:
    image = log / "images" / "000003.jpg"
    image.write_bytes(image.read_bytes()[:-3000])
    return [*FEW_PARTICLES]


def with_config(text: str) -> Callable[[Path], list[str]]:
    def spoil(log: Path) -> list[str]:
        (log / "mine.yaml").write_text(text)
        return ["--config", "{log}/mine.yaml"]

    return spoil


def with_arguments(*arguments: str) -> Callable[[Path], list[str]]:
    return lambda _: list(arguments)


def with_file_as_results(log: Path) -> list[str]:
    (log / "taken").write_text("a file")
    return ["--out", "{log}/taken"]


def untilted(log: Path) -> list[str]:
    edited("camera.yaml", replaced("tilt_deg: 20.0", "tilt_deg: 0.0"))(log)
    return ["--observation", "slope"]


BAD = {
    "no log": Bad(without_folder, ["{log}: no such log"]),
    "empty images.csv": Bad(edited("images.csv", lambda lines: []), ["images.csv", "t_ns,file"]),
    "truncated image": Bad(
        with_cut_image, ["images.csv:5: file: {log}/images/000003.jpg", "cut off", "after 3 of 12 frames"]
    ),
    "map without landmarks": Bad(
        edited("map.yaml", lambda lines: [*lines[:3], "landmarks: []"]), ["map.yaml:4:", "expected at least 1, found 0"]
    ),
    "missing map": Bad(with_arguments("--map", "{log}/nowhere.yaml"), ["{log}/nowhere.yaml: no such file"]),
    "unknown key of the configuration": Bad(
        with_config("seed: 1\nmcl:\n  particels: 10\n"), ["{log}/mine.yaml:3:3: mcl.particels", "'particles'"]
    ),
    "--set of a text for a number": Bad(with_arguments("--set", "mcl.particles=many"), ["--set mcl", "'many'"]),
    "--start of two numbers": Bad(with_arguments("--start", "1,2"), ["--start", "x,z,heading_deg", "'1,2'"]),
    "--start of nan": Bad(with_arguments("--start", "nan,0,0"), ["--start", "'nan,0,0'"]),
    "slope without tilt": Bad(
        untilted, ["{log}/camera.yaml:", ": mount.tilt_deg: ", "found a tilt of 0°", "slope", "observation.kind=line"]
    ),
    "results in a file": Bad(with_file_as_results, ["{log}/taken", "cannot be written"]),
}  # fmt: skip


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_bad_input_is_told_in_one_paragraph(localiser: Localiser, log: Path, tmp_path: Path, bad: Bad) -> None:
    further = [argument.format(log=log) for argument in bad.spoil(log)]
    arguments = ["replay", log, "--no-rrd", "--quiet", *([] if "--out" in further else ["--out", tmp_path / "out"])]
    result = localiser(*arguments, *further)
    assert (result.exit_code, result.out) == (2, "")
    assert result.err.startswith("Error: ")
    assert result.err.count("\n") == 1
    assert len(result.err) < 600
    for text in bad.told:
        assert text.format(log=log) in result.err

    debugged = localiser(*arguments, *further, "--debug")
    assert debugged.exit_code == 2
    assert debugged.err.startswith("Traceback")
    assert 'replay.py"' in debugged.err or 'main.py"' in debugged.err


def test_debug_may_stand_before_the_command(localiser: Localiser, tmp_path: Path) -> None:
    result = localiser("--debug", "replay", tmp_path / "nowhere")
    assert result.exit_code == 2
    assert "Traceback" in result.err
    assert result.err.splitlines()[-1] == f"Error: {tmp_path / 'nowhere'}: no such log"


def test_bad_world_is_told_with_its_place(localiser: Localiser, tmp_path: Path) -> None:
    world = (ROOT / "configs" / "worlds" / "corridor.yaml").read_text()
    (tmp_path / "world.yaml").write_text(world.replace("furniture:", "furnitur:", 1))
    result = localiser("simulate", tmp_path / "world.yaml", "-o", tmp_path / "log")
    assert result.exit_code == 2 and result.err.count("\n") == 1
    assert "world.yaml:" in result.err and "furnitur: " in result.err and "'furniture'" in result.err
    assert not (tmp_path / "log").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("replay", CORRIDOR, "--map", CORRIDOR / "camera.yaml"), "expected a landmark map, found a camera file"),
        (
            ("replay", CORRIDOR, "--map", ROOT / "configs/worlds/corridor.yaml"),
            "found a world, of which `localiser sim",
        ),
        (("map", "plan", ROOT / "configs/plans/corridor.png"), "the YAML file beside its picture, found a PNG image"),
        (("replay", "drive.mp4"), "found a video, of which `localiser convert VIDEO LOG --camera FILE` makes a log"),
        (("convert", "drive.mp4", "log"), "--camera: missing: a video needs --camera FILE"),
        (("replay", "results"), "found results of replay, the newest first: results/b/2, results/a/1"),
        (("view", "results"), "found results of replay, the newest first: results/b/2, results/a/1"),
        (("replay", CORRIDOR, "--start", "far"), "such as 1.5,-2,90), global or truth, found 'far'"),
        (("live", "--map", CORRIDOR / "map.yaml", "--start", "global"), "such as 1.5,-2,90), found 'global'"),
        (("replay", CORRIDOR, "--set", "particles=500"), "unknown setting; did you mean mcl.particles?"),
        (("doctor", "--connect", "tcp/127.0.0.1:9"), "--connect: is a setting now: --set live.connect=ENDPOINT"),
        (("live", "--map", "map.yaml", "--namespace=robot1"), "--namespace: is a setting now: --set live.namespace="),
        (("live", "demo", "--dds", "7"), "--dds: is a setting now: --set live.dds=DOMAIN"),
        (("pose", "set", "1,2,3", "--ros-distro", "humble"), "--ros-distro: is the environment's ROS_DISTRO now"),
        (("live", "--map", "map.yaml", "--resume"), "--resume: is gone: --checkpoint goes on"),
        (("simulate", "log", "--serve", "--odometry-hz=50"), "--odometry-hz: is gone: a stand-in sends 100 poses"),
        (("replay", "log", "--format", "bag"), "--format: is gone: the format is found out"),
        (("camera", "tilt", "log", "--format=bag"), "--format: is gone: the format is found out"),
        (("convert", "log", "out", "--to", "mcap"), "--to: is gone: OUT says it by .mcap"),
        (("map", "align", "a.yaml", "b.yaml", "--force"), "--force: is gone: nothing that exists is overwritten"),
        (("map", "deduplicate", "map.yaml"), "map deduplicate: is gone: use `localiser map merge MAP`"),
        (("example",), "example: is gone: use `localiser demo --keep FOLDER`"),
    ],
)
def test_what_is_wrong_or_gone_is_told_with_what_to_do(localiser, tmp_path, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    Path("drive.mp4").write_bytes(b"")
    for age, run in enumerate((Path("results/b/2"), Path("results/a/1"))):
        run.mkdir(parents=True)
        (run / "trajectory.csv").write_text("")
        os.utime(run, (1e9 - age, 1e9 - age))
    result = localiser(*words, *(["-o", "out"] if words[:2] == ("map", "plan") else []))
    assert result.exit_code == 2 and told in result.err


def test_missing_files_of_the_other_commands(localiser: Localiser, tmp_path: Path) -> None:
    nowhere, itself = tmp_path / "nowhere", tmp_path / "itself"
    itself.symlink_to(itself)
    for arguments in (
        ["simulate", nowhere, "-o", tmp_path / "log"],
        *(["evaluate", path] for path in (nowhere, itself)),
        ["evaluate", tmp_path, "--truth", nowhere],
        ["convert", write_edge_log(tmp_path / "edges"), itself, "--quiet"],
        ["config", "show", "--config", nowhere],
    ):
        result = localiser(*arguments)
        assert (result.exit_code, result.err.count("\n")) == (2, 1)
        assert result.err.startswith("Error: ")
        assert str(tmp_path) in result.err


# -- what nobody can read or write ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("recorded", "told"),
    [
        ({"position_rmse_m": "x"}, "position_rmse_m: expected a number or null, found 'x'"),
        ({"position_rmse_m": 10**400}, "position_rmse_m: expected a number or null, found one of more than 64 bits"),
        ({"nees_mean": [1]}, "nees_mean: expected a number or null, found [1]"),
        ({"log": {}}, "log: expected a text or an integer or null"),
        ({"frames": True}, "frames: expected an integer or null, found True"),
    ],
)
def test_figures_of_another_type_are_told(localiser, tmp_path, recorded, told):
    (tmp_path / "trajectory.csv").write_text("")
    (tmp_path / "metrics.json").write_text(json.dumps(recorded))
    result = localiser("evaluate", tmp_path)
    assert result.exit_code == 2 and f"metrics.json: {told}" in result.err


def test_a_name_that_is_too_long_for_the_system_is_told(localiser: Localiser) -> None:
    result = localiser("replay", "x" * 300)
    assert result.exit_code == 2 and "Error: " in result.err and "name too long" in result.err.replace("\n", " ")


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full is Linux's")
def test_an_output_that_is_full_is_told_in_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "localiser", "config", "show"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "Error: cannot be written or read: No space left on device\n")


@pytest.mark.parametrize(
    "error",
    [
        "MemoryError()",
        "ImportError('x.so: failed to map segment from shared object')",
        "OSError(12, 'Cannot allocate memory')",
    ],
)
def test_too_little_memory_is_told_in_one_line(error: str) -> None:
    code = f"""
import sys
import localiser.commands
def app(*_, **__): raise {error}
program = sys.modules["localiser.commands.main"]
program.app = app
program.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.startswith("Error: there is too little memory")
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_second_signal_does_not_interrupt_what_the_first_has_removed() -> None:
    code = """
import os, signal
from localiser import __main__ as program
def main():
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGHUP)
        print("removed", flush=True)
program.cli.main = main
program.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (143, "removed\n", "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such names")
def test_a_terminal_of_ascii_and_a_name_that_is_no_text_are_served() -> None:
    command = [sys.executable, "-m", "localiser", "replay", b"/no\xff\xc3\xbc.bag"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(b"Error: /no\\udcff") and done.stderr.endswith(b": no such bag\n")


NO_TEXT = os.fsdecode(b"b\xff\xfe")


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes")
def test_a_log_whose_name_is_no_text_is_served(localiser: Localiser, tmp_path: Path) -> None:
    log = write_edge_log(tmp_path / NO_TEXT)
    run = localiser.replay(log, tmp_path / f"{NO_TEXT}-out")
    assert "b\\udcff" in (run / "run.yaml").read_text()
    shutil.move(log, tmp_path / "images")
    converted = localiser("convert", write_small_log(tmp_path / f"{NO_TEXT}2"), tmp_path / f"{NO_TEXT}.mcap", "--quiet")
    assert converted.exit_code == 0, converted.err


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes")
def test_a_video_whose_name_is_no_text_is_told(localiser: Localiser, tmp_path: Path) -> None:
    """OpenCV would end the whole program."""
    (tmp_path / f"{NO_TEXT}.avi").write_bytes(b"RIFF")
    result = localiser("convert", tmp_path / f"{NO_TEXT}.avi", tmp_path / "log", "--camera", CORRIDOR / "camera.yaml")
    assert result.exit_code == 2 and "expected a name of UTF-8 text" in result.err


def test_quiet_may_stand_anywhere(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    for number, words in enumerate((["--quiet", "convert"], ["convert", "-q"])):
        result = localiser(*words, log, tmp_path / f"{number}.mcap")
        assert (result.exit_code, result.out, result.err) == (0, "", "")
    assert "frames" in localiser("convert", log, tmp_path / "loud.mcap").out


def commands_of(command: Any, name: str = "localiser") -> Iterator[tuple[str, Any]]:
    for part, inner in getattr(command, "commands", {}).items():
        yield from commands_of(inner, f"{name} {part}")
    if not hasattr(command, "commands"):
        yield name, command


def test_every_command_has_an_example_and_help_without_types_of_python_or_broken_choices(localiser: Localiser) -> None:
    found = dict(commands_of(get_command(app)))
    assert len(found) > 20
    for name in found:
        told = localiser(*name.split()[1:], "--help").out
        assert name in told.split("Example")[1], name
        assert not any(kind in told for kind in ("<bool>", "<list[", "<path>", "deg|", "bob|")), name


def test_where_results_go_has_one_short_name_in_all_commands() -> None:
    short = {
        name: option.opts
        for name, command in commands_of(get_command(app))
        for option in command.params
        if "--out" in option.opts
    }
    assert len(short) > 12
    assert all(options == ["--out", "-o"] for options in short.values()), short


@pytest.mark.parametrize(
    ("first", "sums"),
    [
        ("import localiser.__main__", "[w @ w]"),
        ("from localiser.particles import centred", "centred(w.reshape(4, -1), w[:100_000])[0]"),
    ],
)
def test_sums_are_the_same_with_any_number_of_threads(first: str, sums: str) -> None:
    code = (
        f"{first}; import numpy as np; w = np.random.default_rng(0).random(400_000); print(np.array({sums}).tobytes())"
    )
    environments = [os.environ | {"OPENBLAS_NUM_THREADS": count} for count in ("1", "2")]
    assert len({subprocess.check_output([sys.executable, "-c", code], env=each) for each in environments}) == 1
