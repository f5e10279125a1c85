"""The command line: arguments, progress and messages only."""

from localiser.cli.main import app, main

__all__ = ["app", "main"]
