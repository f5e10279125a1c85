"""Find vertical edges in images: tables and pictures of what each detector finds, and how far detectors agree."""

from localiser.commands.edges.inputs import Taken, inputs_of
from localiser.commands.edges.mount import mount_warnings
from localiser.commands.edges.run import EdgeRun, Outputs

__all__ = ["EdgeRun", "Outputs", "Taken", "inputs_of", "mount_warnings"]
