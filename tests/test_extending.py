"""Every example of docs/extending.md runs in a clone of the project and prints what the page says."""

import copy
import re
from collections.abc import Iterator

import pytest
from folders import ROOT

from localiser import edges, storage

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
REPLAYED = ("motion model", "sink")  # along the whole of a log
EXAMPLES = dict(re.findall(r"^## Your own ([\w ]+)$.*?```python\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL))


@pytest.fixture(autouse=True)
def _registered_for_one_test() -> Iterator[None]:
    detectors, formats = copy.copy(edges.DETECTORS), copy.copy(storage.FORMATS)
    yield
    edges.DETECTORS.clear()
    edges.DETECTORS.update(detectors)
    storage.FORMATS[:] = formats


def test_every_seam_has_an_example() -> None:
    assert list(EXAMPLES) == ["detector", "observation", "motion model", "log reader", "sink"]


@pytest.mark.parametrize(
    "title", [pytest.param(title, marks=pytest.mark.slow) if title in REPLAYED else title for title in EXAMPLES]
)
def test_example_prints_what_the_page_says(
    title: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    code = EXAMPLES[title]
    exec(compile(code, f"docs/extending.md: {title}", "exec"), {"__name__": "example"})
    assert capsys.readouterr().out.splitlines() == re.findall(r"^# prints: (.*)$", code, re.MULTILINE)
