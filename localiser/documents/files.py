"""Read files of bounded size; whatever is wrong with one is an InputError that names it."""

from __future__ import annotations

import stat
from pathlib import Path

from localiser.errors import InputError

MAX_DOCUMENT_BYTES = 16 * 2**20


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """Return what a regular file holds. Raises InputError when it is missing, not a file, or larger than allowed."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError("expected a file, found a folder", path=path)
        if not stat.S_ISREG(status.st_mode):
            raise InputError("expected a file, found a device or pipe", path=path)
        if status.st_size > max_bytes:
            raise InputError(f"expected at most {max_bytes} bytes, found {status.st_size}", path=path)
        with path.open("rb") as file:
            return file.read(status.st_size)  # a larger bound would be taken from memory at once
    except FileNotFoundError:
        raise InputError("no such file", path=path) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", path=path) from None


def read_text(path: Path, max_bytes: int = MAX_DOCUMENT_BYTES) -> str:
    """Return the text of a UTF-8 file, with or without byte order mark. Raises InputError."""
    data = read_bytes(path, max_bytes)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"expected UTF-8 text, found byte {data[error.start]:#04x}", path=path, line=line) from None
