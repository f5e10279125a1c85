"""Every example of docs/extending.md runs, in a clone of the project, and touches no file of the package."""

import copy
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from localiser import edges, storage

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"^## Your own ([\w ]+)$.*?```python\n(.*?)```", PAGE, re.M | re.S))


@pytest.fixture(autouse=True)
def registered_for_one_test(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for module, name in ((edges, "DETECTORS"), (storage, "LOG_READERS")):
        registered = getattr(module, name)
        before = copy.copy(registered)
        yield
        registered.clear()
        registered.update(before) if isinstance(before, dict) else registered.extend(before)


def test_every_seam_has_an_example() -> None:
    assert list(EXAMPLES) == ["detector", "observation", "motion model", "log reader", "sink"]


@pytest.mark.parametrize("title", EXAMPLES)
def test_example_runs(title: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    exec(compile(EXAMPLES[title], f"docs/extending.md: {title}", "exec"), {"__name__": "example"})
