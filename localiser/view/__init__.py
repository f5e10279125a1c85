"""What a run looks like: recorded to a Rerun file, or shown live; the only place that knows Rerun."""

from localiser.view.context import Context
from localiser.view.file import RrdFile
from localiser.view.live import LiveView, check_kind

__all__ = ["Context", "LiveView", "RrdFile", "check_kind"]
