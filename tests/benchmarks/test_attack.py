"""Inputs that once were faults are told now; the harness finds faults, and kills what takes too much."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from threading import Event

import attack
import attack_bombs as bombs
import attack_formats
import attack_pool
import attack_targets
import attack_values
import attack_worker
import pytest
from folders import ROOT
from small_bag import Recorder, bag

from localiser.errors import InputError
from localiser.image_files import decode
from localiser.storage import open_log
from localiser.storage.bags import Messages

KEPT = sorted((ROOT / "tests" / "attacks").glob("*/*/*"))
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="processes are watched by /proc")


@pytest.mark.parametrize("kept", KEPT, ids=lambda path: f"{path.parent.parent.name}-{path.parent.name}")
def test_what_once_was_a_fault_is_told(kept: Path, tmp_path: Path) -> None:
    attack_targets.use_samples(ROOT / "logs" / "corridor")
    (shutil.copytree if kept.is_dir() else shutil.copy)(kept, tmp_path / kept.name)
    (tmp_path / "out").mkdir()
    target = attack_targets.TARGETS[kept.parent.parent.name]
    end = attack_worker.attempt(target, tmp_path / kept.name, tmp_path / "out")
    assert end["end"] in ("value", "refused"), end


@pytest.mark.parametrize("suffix", sorted(attack_formats.FORMS))
def test_a_case_is_the_same_each_time_and_differs_from_the_next(suffix: str) -> None:
    data = b"a,b\n1,2\n3,4\n"
    made = [attack_formats.mutated(data, suffix, random.Random(f"map {number}")) for number in range(20)]
    assert made == [attack_formats.mutated(data, suffix, random.Random(f"map {number}")) for number in range(20)]
    assert len(set(made)) > 5


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_some_pictures_are_costly(suffix: str) -> None:
    """They are made from a good one, and refused or read."""
    data = bombs.black((64, 48)) if suffix == ".png" else bombs.jpeg_of_scans((64, 48), 2)
    made = [attack_formats.FORMS[suffix](data, random.Random(number)) for number in range(200)]
    costly = {len(each) // 2**19: each for each in made if len(each) > 2**20}
    assert costly
    for each in costly.values():
        with suppress(ValueError):
            assert decode(each, 0) is not None


def test_some_transforms_are_many(tmp_path: Path) -> None:
    log = open_log(ROOT / "logs" / "corridor")
    mount = Messages().encode(Messages().mount(5 * 10**9, log.camera))
    assert max(len(attack_formats.message(mount, random.Random(number))) for number in range(200)) > 2**19


def test_numbers_keep_the_length_of_a_message() -> None:
    rng = random.Random(0)
    assert {len(attack_values.with_number(bytes(40), rng)) for _ in range(200)} == {40}


def test_bags_are_changed_inside_and_still_opened(tmp_path: Path) -> None:
    """Most changes of a bag get past its first check: they are told with the topic, or change what is read."""

    def record(recorder: Recorder) -> None:
        recorder.image(10**8)

    path = next(bag(tmp_path / "bag", record).glob("*.mcap"))
    data, opened = path.read_bytes(), 0
    for number in range(40):
        file = tmp_path / f"{number}.mcap"
        file.write_bytes(attack_formats.mutated(data, ".mcap", random.Random(number)))
        try:
            attack_targets.all_of_log(file, tmp_path)
            opened += 1
        except InputError as error:
            opened += " at " in str(error)
    assert opened > 3


def _broken(path: Path, out: Path) -> None:
    raise IndexError("broken")


def _drafted(path: Path, out: Path) -> None:
    (out / ".localiser-0123.part").write_text("")


def test_faults_are_told_by_their_kind(tmp_path: Path) -> None:
    assert attack_worker.attempt(attack_targets.Target("x", _broken), tmp_path, tmp_path)["end"] == "IndexError"
    assert attack_worker.attempt(attack_targets.Target("x", _drafted), tmp_path, tmp_path)["end"] == "draft"


def _deletes(path: Path, out: Path) -> None:
    path.with_name("victim").unlink()


def test_a_reader_that_changes_a_file_is_a_fault(
    tmp_path: Path, bags_of_sqlite: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what lies beside a database has none of them do so, as it is or changed."""
    ends = [attack_worker.case("bag-beside", k, bags_of_sqlite, tmp_path / str(k))["end"] for k in range(20)]
    assert set(ends) == {"value", "refused"}
    target = attack_targets.Target("file.db3", _deletes, change=attack_targets.READERS["bag-beside"].change)
    monkeypatch.setitem(attack_targets.TARGETS, "bag-beside", target)
    assert attack_worker.case("bag-beside", 1, bags_of_sqlite, tmp_path / "changed")["end"] == "changed"


@pytest.fixture
def bags_of_sqlite(tmp_path: Path) -> Path:
    """Return a folder of samples with a bag."""
    folder = tmp_path / "samples"
    (bag(folder / "bag", lambda recorder: recorder.image(10**8), "sqlite3") / "bag.db3").rename(folder / "file.db3")
    return folder


@LINUX
@pytest.mark.slow  # quick: the other tests of this file
def test_a_worker_that_is_killed_is_told_and_started_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "samples").mkdir()
    (tmp_path / "samples" / "map.yaml").write_text("format: localiser-map/1\nlandmarks: [{id: 1, x: 1.0, z: 2.0}]\n")
    worker = attack_pool.Worker(tmp_path / "samples", tmp_path / "worker")
    try:
        assert worker("map", 1, 60.0, tmp_path / "kept")["end"] in ("value", "refused")
        monkeypatch.setattr(attack_pool, "MEMORY_MB", 1.0)
        monkeypatch.setattr(attack_pool, "LOOK_S", 0.0)
        assert worker("map", 2, 60.0, tmp_path / "kept")["end"] == "memory"
        assert (tmp_path / "kept" / "end.json").exists()
        monkeypatch.undo()
        assert worker("map", 3, 60.0, tmp_path / "kept")["end"] in ("value", "refused")
    finally:
        worker.close()


def test_what_was_run_before_counts_and_a_line_that_was_cut_off_does_not(tmp_path: Path) -> None:
    written = tmp_path / "ends.jsonl"
    line = '{"target": "map", "end": "value", "seconds": 0.1, "case": %d}\n'
    written.write_text(line % 1 + line % 7 + (line % 2)[:-20])
    ends = attack.earlier(written, ["map", "world"], range(5))
    assert ends == {"map": [{"end": "value", "seconds": 0.1, "case": 1}], "world": []}
    assert written.read_text() == line % 1 + line % 7


def test_a_stop_leaves_the_cases_that_have_not_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stop, run = Event(), []
    monkeypatch.setattr(attack_pool.Worker, "__call__", lambda *_: {"end": "value"})

    def done(case: attack_pool.Case, end: dict[str, object]) -> None:
        run.append(case)
        if len(run) == 3:
            stop.set()

    cases = [("map", number) for number in range(100)]
    attack_pool.run_all(cases, tmp_path, tmp_path, 1, lambda name: 1.0, done, stop=stop)
    assert run == cases[:3]


@LINUX
@pytest.mark.parametrize(("does", "asleep"), [("input()", True), ("while True: pass", False)])
def test_who_waits_for_a_processor_does_not_sleep(does: str, asleep: bool) -> None:
    """A worker that the machine leaves no processor for is not taken for one that hangs."""
    command = [sys.executable, "-c", f"print(1, flush=True)\n{does}"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            while attack_pool.is_asleep(process.pid) != asleep:  # until it has come there
                pass
        finally:
            process.kill()
