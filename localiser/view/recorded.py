"""Show a recorded run in Rerun's viewer, which comes with the library and need not be on the path."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from localiser.view.live import Kind, stop_viewer, viewer_command


class RecordingViewer:
    """The viewer of a recording (.rrd), a process of its own.

    kind: "native" or "web", see `Feed`. address: of the page, for the web. Raises OSError when it cannot start.
    """

    def __init__(self, recording: Path, kind: Kind) -> None:
        command, self.address = viewer_command(kind, str(recording.resolve()))
        environment = {"RUST_LOG": "error", **os.environ}  # else it reports every port that it opens
        self._process = subprocess.Popen(command, start_new_session=True, env=environment)

    def wait(self) -> bool:
        """Wait until the viewer is closed, or the user interrupts, which closes it; return whether it could start."""
        try:
            return self._process.wait() == 0
        except KeyboardInterrupt:
            return True
        finally:
            stop_viewer(self._process)
