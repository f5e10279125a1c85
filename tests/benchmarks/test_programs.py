"""Programs beside the package: the harness of attacks, digests of the baseline, the count of the code."""

import json
import random
import shutil
import sys
from pathlib import Path

import attack
import attack_inputs
import baseline
import code_size
import pytest
import short_logs
from folders import ROOT
from small_bag import Recorder, bag

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


CASES = {
    "same": baseline.Case(lambda: "ab"),
    "other": baseline.Case(lambda: "cd"),
    "no data": baseline.Case(lambda: "ef", Path("/nowhere/at/all")),
}


def test_the_committed_file_has_every_case(tmp_path: Path) -> None:
    kept = json.loads(baseline.FILE.read_text(encoding="utf-8"))
    assert kept["format"] == baseline.FORMAT and set(kept["machine"]) == set(baseline.machine())
    assert set(kept["digests"]) == set(baseline.cases_of(tmp_path))
    assert all(len(digest) == 64 for digest in kept["digests"].values())


def test_what_differs_or_was_not_measured_is_told() -> None:
    before = {"same": "ab", "other": "ab", "no data": "ab", "gone": "ab"}
    assert baseline.differing(before, {"same": "ab", "other": "cd"}, CASES) == [
        "other: expected ab, found cd",
        "gone: no longer measured",
    ]


@pytest.mark.parametrize(("machine", "code"), [("here", 1), ("elsewhere", 0)])
def test_another_digest_is_a_loss_where_bytes_can_be_equal(machine, code, monkeypatch, tmp_path, capsys):
    file = tmp_path / "file.json"
    known = baseline.machine() if machine == "here" else {"processor": "another"}
    file.write_text(json.dumps({"machine": known, "digests": {"same": "ab", "other": "ab", "no data": "ab"}}))
    monkeypatch.setattr(baseline, "FILE", file)
    monkeypatch.setattr(baseline, "cases_of", lambda data: CASES)
    monkeypatch.setattr(baseline, "measured", lambda cases, jobs: {name: case.digest() for name, case in cases.items()})
    monkeypatch.setattr(sys, "argv", ["baseline.py", "--check"])
    assert baseline.main() == code
    out = capsys.readouterr().out
    assert "other: expected ab, found cd" in out and "1 digests differ, 1 do not, 1 have no data here" in out
    monkeypatch.setattr(sys, "argv", ["baseline.py", "--check", "--only", "sam"])
    assert baseline.main() == 0


def test_a_digest_is_of_names_and_content(tmp_path: Path) -> None:
    for name, text in (("a", "x"), ("b", "x"), ("c", "y")):
        (tmp_path / name).write_text(text)
    digests = {baseline.digest_of(tmp_path / name) for name in "abc"}
    assert len(digests) == 3 and baseline.digest_of(tmp_path / "a") in digests


def test_logs_for_digests_are_the_same_every_time(tmp_path: Path) -> None:
    first, second = (short_logs.posts(tmp_path / name, 5) for name in ("first", "second"))
    assert (first / "edges.csv").read_bytes() == (second / "edges.csv").read_bytes()


def test_what_is_above_its_ceiling_ends_the_check(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["code_size.py", "--check"])
    found = code_size.counted(code_size.by_package())
    assert found["commands"] > 10 and found["lines: all of localiser"] > 10_000
    monkeypatch.setattr(code_size, "BUDGETS", {name: (count, 0) for name, count in found.items()})
    code_size.main()
    assert "above" not in capsys.readouterr().out
    monkeypatch.setitem(code_size.BUDGETS, "options", (found["options"] - 1, 0))
    with pytest.raises(SystemExit):
        code_size.main()
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines() if "above" in line] == ["options"]
