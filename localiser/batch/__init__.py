"""Replay many logs with many settings and seeds, each combination once, and compare with earlier runs."""

from localiser.batch.choices import choices_of, seeds_of
from localiser.batch.compare import Verdict, compare_with, comparison_table, failures, read_table_of, summary_table
from localiser.batch.run import Batch, Opening, Workers, run_batch
