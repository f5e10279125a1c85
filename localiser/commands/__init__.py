"""The command line: arguments, progress and messages only."""

from localiser.commands.main import app, main
