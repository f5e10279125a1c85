"""Find vertical edges in images: tables and pictures of what each detector finds, and how far detectors agree."""

from localiser.app.edges.inputs import Taken, inputs_of
from localiser.app.edges.mount import mount_warnings
from localiser.app.edges.run import EdgeRun, Outputs

__all__ = ["EdgeRun", "Outputs", "Taken", "inputs_of", "mount_warnings"]
