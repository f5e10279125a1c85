"""Judge results: errors against truth, consistency, the limit of accuracy, tables and pictures."""

from localiser.evaluate.accuracy import Errors, Track, errors_against, found_images, nees, residual_sums
from localiser.evaluate.metrics import ABOUT, DECIMALS, metrics, timing_metrics
from localiser.evaluate.page import WorstMoments, report_page
from localiser.evaluate.report import ellipses, picture_style, save_figure, write_report
from localiser.evaluate.tables import (
    COLUMNS,
    Column,
    figure_at,
    fit_width,
    flat_figures,
    learnt_constants,
    new_table,
    run_tables,
)
