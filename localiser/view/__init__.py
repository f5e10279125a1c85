"""Show runs in Rerun: recorded to a file, or live. No other package calls Rerun."""

from typing import TYPE_CHECKING, Any

from localiser.view import palette
from localiser.view.context import Context
from localiser.view.file import RrdFile
from localiser.view.live import LiveView, check_kind
from localiser.view.mapping import Finished, Growing, MapFile, MapView, building_context
from localiser.view.palette import MATCHED, UNMATCHED, VISIBLE, Colour
from localiser.view.recorded import RecordingViewer

if TYPE_CHECKING:
    from localiser.view.landmark_view import record_aliasing, record_map


def __getattr__(name: str) -> Any:
    """Import what draws maps when it is asked for: Rerun takes most of a second."""
    if name in ("record_aliasing", "record_map"):
        from localiser.view import landmark_view

        return getattr(landmark_view, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
