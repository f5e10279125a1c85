"""What a run looks like: recorded to a Rerun file, or shown live; the only place that knows Rerun."""

from localiser.view.aliasing import record_aliasing
from localiser.view.context import Context
from localiser.view.file import RrdFile
from localiser.view.landmark_view import record_map
from localiser.view.live import LiveView, check_kind
from localiser.view.mapping import Finished, Growing, MapFile, MapView, building_context

__all__ = [
    "Context",
    "Finished",
    "Growing",
    "LiveView",
    "MapFile",
    "MapView",
    "RrdFile",
    "building_context",
    "check_kind",
    "record_aliasing",
    "record_map",
]
