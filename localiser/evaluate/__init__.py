"""Judge results: errors against truth, consistency, the limit of accuracy, tables and pictures."""

from localiser.evaluate.accuracy import Errors, Track, errors_against
from localiser.evaluate.bound import bearing_information, posterior_bound, rms_position
from localiser.evaluate.consistency import nees, nees_band, share_inside
from localiser.evaluate.efficiency import Efficiency, efficiency
from localiser.evaluate.metrics import metrics, timing_metrics
from localiser.evaluate.report import write_report
from localiser.evaluate.table import errors_table
from localiser.evaluate.wheels import bias_figures, fit_wheels

__all__ = [
    "Efficiency",
    "Errors",
    "Track",
    "bearing_information",
    "bias_figures",
    "efficiency",
    "errors_against",
    "errors_table",
    "fit_wheels",
    "metrics",
    "nees",
    "nees_band",
    "posterior_bound",
    "rms_position",
    "share_inside",
    "timing_metrics",
    "write_report",
]
