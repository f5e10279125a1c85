"""Show runs in Rerun: recorded to a file, or live. No other package calls Rerun."""

from localiser.view.file import RrdFile
from localiser.view.palette import MATCHED, UNMATCHED, VISIBLE, Colour
from localiser.view.paths import Context
from localiser.view.viewer import LiveView, RecordingViewer, check_kind, owned_python
