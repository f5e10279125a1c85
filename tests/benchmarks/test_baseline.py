"""How benchmarks/baseline.py compares digests. Nothing is measured but the log of posts."""

import json
import sys
from pathlib import Path

import baseline
import code_size
import pytest
import short_logs

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
