"""The count of the project beside its budgets."""

from __future__ import annotations

import sys

import code_size
import pytest


def test_what_is_above_its_ceiling_ends_the_check(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
