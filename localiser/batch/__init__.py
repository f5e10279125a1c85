"""Replay many logs with many settings and seeds, each combination once, and compare with earlier runs."""

from localiser.batch.against import Verdict, compare_with, read_table_of
from localiser.batch.changes import comparison_table
from localiser.batch.choices import choices_of, seeds_of
from localiser.batch.run import Batch, Opening, run_batch
from localiser.batch.summary import failures, summary_table
from localiser.batch.workers import Workers
