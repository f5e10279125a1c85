"""`python -m localiser.commands.licences`: the licences of this program and of all that it depends on."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import metadata

import typer

_NAME = re.compile(r"[A-Za-z0-9._-]+")
_UNKNOWN = "not stated"


def licences(package: str = "localiser") -> dict[str, tuple[str, str]]:
    """Return version and licence of a package, and of all that it needs and that is installed, by name."""
    found: dict[str, tuple[str, str]] = {}
    waiting = [package]
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name in found:
            continue
        try:
            about = metadata.metadata(name)
        except metadata.PackageNotFoundError:
            continue  # for another system, or an extra that is not installed
        found[name] = str(about["Version"]), _licence(about)
        waiting += _needed(name, extras=name == package)
    return dict(sorted(found.items()))


def _needed(name: str, *, extras: bool) -> Iterator[str]:
    for requirement in metadata.requires(name) or ():
        match = _NAME.match(requirement)
        if match and (extras or "extra ==" not in requirement):
            yield match[0]


def _licence(about: metadata.PackageMetadata) -> str:
    """Return what a package states: an SPDX expression, else its classifiers, else the first line of its text."""
    fields = [(key, about[key]) for key in ("License-Expression", "License") if key in about]
    stated = {key: str(text).strip() for key, text in fields}
    if expression := stated.get("License-Expression"):
        return expression
    classifiers = [str(line) for line in about.get_all("Classifier") or () if str(line).startswith("License ::")]
    names = [line.rsplit(" :: ", 1)[-1] for line in classifiers if not line.endswith("OSI Approved")]
    return ", ".join(names) or stated.get("License", "").split("\n")[0][:80] or _UNKNOWN


def main() -> None:
    """Print a line for each package: name, version, licence."""
    for name, (version, licence) in licences().items():
        typer.echo(f"{name:32} {version:16} {licence}")


if __name__ == "__main__":
    main()
