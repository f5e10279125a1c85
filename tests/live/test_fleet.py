"""The tutorial of several robots on one site, with every robot and every run a process."""

from __future__ import annotations

import shutil
import signal
from contextlib import ExitStack
from pathlib import Path

import pytest
from documented import blocks, commands
from folders import ROOT
from live_processes import SETTINGS, free_endpoint, program
from short_log import Localiser

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")

PAGE = ROOT / "docs" / "tutorials" / "fleet.md"
ROUTER = "tcp/127.0.0.1:7447"


@pytest.mark.slow
def test_the_page_runs_as_it_is_written(localiser: Localiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In its order, but for the port of the router and the number of particles; each run follows its robot."""
    monkeypatch.chdir(tmp_path)
    for part in ("logs", "maps"):
        shutil.copytree(ROOT / part, tmp_path / part)
    endpoint = free_endpoint()
    (site,) = (block.text for block in blocks(PAGE) if block.language == "yaml")
    (tmp_path / "site.yaml").write_text(site.replace(ROUTER, endpoint))
    ran = []
    with ExitStack() as stack:
        runs = []
        for written in commands(PAGE):
            words = [word.replace(ROUTER, endpoint) for word in written]
            if words[0] == "simulate":
                stack.enter_context(program(*words)).wait_to_say("until Ctrl-C")
            elif words[0] == "live":
                runs.append(stack.enter_context(program(*words, "--json", *SETTINGS)))
                runs[-1].poses(3)
            else:
                if words[0] == "batch":
                    assert [run.end(signal.SIGINT) for run in runs] == [0, 0, 0]
                result = localiser(*words)
                assert result.exit_code == 0, result.out + result.err
            ran.append(words[0])
    assert ran == ["simulate", "simulate", "doctor", "live", "live", "pose", "simulate", "live", "batch"]
