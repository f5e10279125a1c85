"""The files for those who carry on say what is so."""

from __future__ import annotations

import tomllib

import yaml
from folders import ROOT

from localiser import __version__

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_citation_has_the_version_and_the_licence() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["license"]) == (__version__, PROJECT["license"])
    assert citation["title"] == PROJECT["name"]


def test_the_workflow_runs_what_the_project_runs_on_every_version() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    assert job["strategy"]["matrix"]["python"][0] == PROJECT["requires-python"].removeprefix(">=")
    assert job["steps"][-1] == {"run": ".ci/run"} and (ROOT / ".ci" / "run").exists()


def test_libraries_whose_interface_changes_between_minor_versions_are_capped() -> None:
    for library in ("rerun-sdk", "rosbags"):
        (stated,) = (one for one in PROJECT["dependencies"] if one.startswith(library))
        assert ",<0." in stated


def test_nothing_asks_for_a_package_of_an_index_that_has_none() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    texts = [path.read_text(encoding="utf-8") for path in [*pages, *(ROOT / "localiser").rglob("*.py")]]
    assert not any("pip install 'localiser[" in text for text in texts)
