"""Move the times of a log's images: a log whose images were stamped by another clock than its wheels."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from localiser.documents import read_text, write_text
from localiser.errors import InputError
from localiser.storage.cameras import named_file
from localiser.storage.files import keep_beside
from localiser.storage.folder import LOG_FILE
from localiser.storage.tables import MAX_TABLE_BYTES, Column, csv_of, integer, read_table


def images_table(log: Path) -> Path:
    """Return the table of images that a log folder names. Raises InputError when it is no such folder."""
    folder = log.parent if log.name == LOG_FILE else log
    if not (folder / LOG_FILE).exists():
        raise InputError(
            "expected a log folder, whose times can be written; `localiser convert` makes one of this", path=log
        )
    return named_file(folder, "images")


def move_images(path: Path, later_ns: int) -> Path:
    """Add `later_ns` to the time of every image in a table of images; all else stays.

    Returns where the old file is kept: in the same folder, as FILE.bak, FILE.bak2, … Raises InputError, OutputError.
    """
    times = read_table(path, (Column("t_ns", integer), Column("file", str)), rows_at_least=1).columns["t_ns"]
    text = read_text(path, MAX_TABLE_BYTES)
    header, *rows = [row for row in csv.reader(io.StringIO(text)) if row]
    column = [name.strip() for name in header].index("t_ns")
    for row, time_ns in zip(rows, times, strict=True):
        row[column] = str(time_ns + later_ns)
    kept = keep_beside(path)
    write_text(path, csv_of([header, *rows]))
    return kept
