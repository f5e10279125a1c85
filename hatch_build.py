"""Put the example drive, its map, worlds and configurations into the wheel, for `localiser demo`."""

from __future__ import annotations

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

EXAMPLE = {folder: f"localiser/example/{folder}" for folder in ("configs", "logs/corridor", "maps/corridor.yaml")}


class ExampleHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the example to a wheel. An editable installation reads it from the clone."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Take what is built, its version, and the files to put into it."""
        if version != "editable":
            build_data["force_include"].update(EXAMPLE)
