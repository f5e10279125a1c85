"""Inputs that once were faults are told now; the harness finds faults, and kills what takes too much."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import attack
import attack_bombs as bombs
import attack_inputs
import pytest
from folders import ROOT
from small_bag import Recorder, bag

from localiser.image_files import decode
from localiser.storage import open_log
from localiser.storage.bags import Messages

KEPT = sorted((ROOT / "tests" / "attacks").glob("*/*/*"))
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="processes are watched by /proc")


@pytest.mark.parametrize("kept", KEPT, ids=lambda path: f"{path.parent.parent.name}-{path.parent.name}")
def test_what_once_was_a_fault_is_told(kept: Path, tmp_path: Path) -> None:
    attack_inputs.use_samples(ROOT / "logs" / "corridor")
    (shutil.copytree if kept.is_dir() else shutil.copy)(kept, tmp_path / kept.name)
    (tmp_path / "out").mkdir()
    end = attack.attempt(attack_inputs.TARGETS[kept.parent.parent.name], tmp_path / kept.name, tmp_path / "out")
    assert end["end"] in attack.FAULT_FREE, end


@pytest.mark.parametrize("suffix", sorted(attack_inputs.FORMS))
def test_a_case_is_the_same_each_time_and_differs_from_the_next(suffix: str) -> None:
    data = b"a,b\n1,2\n3,4\n"
    made = [[attack_inputs.mutated(data, suffix, random.Random(f"map {k}")) for k in range(20)] for _ in range(2)]
    assert made[0] == made[1] and len(set(made[0])) > 5


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_some_pictures_are_costly(suffix: str) -> None:
    """They are made from a good one, and refused or read."""
    data = bombs.black((64, 48)) if suffix == ".png" else bombs.jpeg_of_scans((64, 48), 2)
    made = [attack_inputs.FORMS[suffix](data, random.Random(number)) for number in range(200)]
    costly = {len(each) // 2**19: each for each in made if len(each) > 2**20}
    assert costly
    for each in costly.values():
        with suppress(ValueError):
            assert decode(each, 0) is not None


def test_some_transforms_are_many() -> None:
    mount = Messages().encode(Messages().mount(5 * 10**9, open_log(ROOT / "logs" / "corridor").camera))
    assert max(len(attack_inputs.message(mount, random.Random(number))) for number in range(200)) > 2**19


def test_some_names_are_hostile_and_some_keys_collide() -> None:
    made = [attack_inputs.FORMS[".yaml"](b"name: a\n", random.Random(k)) for k in range(200)]
    assert any(b"\\e[2J" in each for each in made) and any(b"$x_{" in each for each in made)
    assert any(b"4611686018427387902: 0" in each for each in made)


def _broken(path: Path, out: Path) -> None:
    raise IndexError("broken")


def _drafted(path: Path, out: Path) -> None:
    (out / ".localiser-0123.part").write_text("")


def _marked(path: Path, out: Path) -> None:
    (out / "table.md").write_text("| \x1b[2J |")


@pytest.mark.parametrize(("run", "end"), [(_broken, "IndexError"), (_drafted, "draft"), (_marked, "markup")])
def test_faults_are_told_by_their_kind(tmp_path: Path, run: attack_inputs.Run, end: str) -> None:
    assert attack.attempt(attack_inputs.Target("x", run), tmp_path, tmp_path)["end"] == end


def _deletes(path: Path, out: Path) -> None:
    path.with_name("victim").unlink()


def test_a_reader_that_changes_a_file_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what lies beside a database has none of them do so, as it is or changed."""
    samples = tmp_path / "samples"
    (bag(samples / "bag", lambda recorder: Recorder.image(recorder, 10**8), "sqlite3") / "bag.db3").rename(
        samples / "file.db3"
    )
    ends = [attack.case("bag-beside", k, samples, tmp_path / str(k))["end"] for k in range(20)]
    assert set(ends) == {"value", "refused"}
    target = attack_inputs.Target("file.db3", _deletes, change=attack_inputs.READERS["bag-beside"].change)
    monkeypatch.setitem(attack_inputs.TARGETS, "bag-beside", target)
    assert attack.case("bag-beside", 1, samples, tmp_path / "changed")["end"] == "changed"


def test_no_cache_is_where_others_can_write(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("")
    ends = [attack.case("cache", k, tmp_path, tmp_path / str(k)) for k in range(30)]
    assert {end["end"] for end in ends} == {"value"}, ends


@LINUX
@pytest.mark.slow  # quick: the other tests of this file
def test_a_worker_that_is_killed_is_told_and_started_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "samples").mkdir()
    (tmp_path / "samples" / "map.yaml").write_text("format: localiser-map/1\nlandmarks: [{id: 1, x: 1.0, z: 2.0}]\n")
    worker = attack.Worker(tmp_path / "samples", tmp_path / "worker")
    try:
        assert worker("map", 1, 60.0, tmp_path / "kept")["end"] in attack.FAULT_FREE
        monkeypatch.setattr(attack, "MEMORY_MB", 1.0)
        assert worker("map", 2, 60.0, tmp_path / "kept")["end"] == "memory"
        assert (tmp_path / "kept" / "end.json").exists()
        monkeypatch.undo()
        assert worker("map", 3, 60.0, tmp_path / "kept")["end"] in attack.FAULT_FREE
    finally:
        worker.close()


@LINUX
@pytest.mark.parametrize(("does", "asleep"), [("input()", True), ("while True: pass", False)])
def test_who_waits_for_a_processor_does_not_sleep(does: str, asleep: bool) -> None:
    """A worker that the machine leaves no processor for is not taken for one that hangs."""
    command = [sys.executable, "-c", f"print(1, flush=True)\n{does}"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            while attack.is_asleep(process.pid) != asleep:  # until it has come there
                pass
        finally:
            process.kill()
