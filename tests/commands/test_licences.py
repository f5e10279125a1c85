"""The licences of what is installed."""

from __future__ import annotations

import tomllib

from folders import ROOT

from localiser.commands.licences import licences


def test_everything_that_the_program_needs_states_a_licence() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found = {}
    for requirement in project["dependencies"]:
        found |= licences(requirement.split(">")[0])
    assert {"numpy", "rerun-sdk", "pyyaml", "llvmlite"} <= set(found), "and what these need"
    assert "not stated" not in {licence for _, licence in found.values()}
