"""Judge results: errors against truth, consistency, the limit of accuracy, tables and pictures."""

from localiser.evaluate.accuracy import Errors, Track, errors_against
from localiser.evaluate.bound import bearing_information, posterior_bound, rms_position
from localiser.evaluate.consistency import fraction_inside, nees, nees_band
from localiser.evaluate.constants import learnt_constants
from localiser.evaluate.flat import figure_at, flat_figures, is_time
from localiser.evaluate.metrics import ABOUT, DECIMALS, metrics, timing_metrics
from localiser.evaluate.moments import WorstMoments
from localiser.evaluate.page import report_page
from localiser.evaluate.report import picture_style, write_report
from localiser.evaluate.residuals import residual_sums
from localiser.evaluate.tables import COLUMNS, fit_width, new_table, run_tables
from localiser.evaluate.twins import without_twins
from localiser.evaluate.wheels import bias_figures, fit_wheels
