"""Read files of bounded size; whatever is wrong with one is an InputError that names it."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from localiser.errors import InputError

MAX_DOCUMENT_BYTES = 16 * 2**20


@contextmanager
def open_regular(path: Path, what: str = "file") -> Iterator[BinaryIO]:
    """Yield a regular file, open for reading. what: it is, for the error where there is none. Raises InputError.

    A pipe, a device or a socket could keep its reader waiting for ever; opening it does not.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(descriptor, "rb") as file:  # noqa: PTH123 - of a descriptor
            _require_regular(path, os.fstat(descriptor).st_mode)
            yield file
    except FileNotFoundError:
        raise InputError(f"no such {what}", path=path) from None
    except IsADirectoryError:
        raise InputError("expected a file, found a folder", path=path) from None
    except (OSError, ValueError) as error:
        if getattr(error, "errno", None) in (errno.ENXIO, errno.ENODEV):
            raise InputError("expected a file, found a device or pipe", path=path) from None
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", path=path) from None


def require_regular(path: Path, what: str = "file") -> None:
    """Raise InputError unless `path` is a regular file that can be read; to be asked before a library opens it."""
    with open_regular(path, what):
        pass


def text_of(path: Path | str) -> str:
    """Return a path, or an address, for a library that takes text alone. Raises InputError where it is no text.

    Libraries in C and Rust end the whole program over the name of a file that has other bytes than UTF-8.
    """
    text = str(path)
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError("expected a name of UTF-8 text, found other bytes in it", path=text) from None
    return text


def _require_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise InputError("expected a file, found a folder", path=path)
    if not stat.S_ISREG(mode):
        raise InputError("expected a file, found a device or pipe", path=path)


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """Return what a regular file holds. Raises InputError when it is missing, not a file, or larger than allowed."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise InputError(f"expected at most {max_bytes} bytes, found {size}", path=path)
        return file.read(size)  # a larger bound would be taken from memory at once


def read_text(path: Path, max_bytes: int = MAX_DOCUMENT_BYTES) -> str:
    """Return the text of a UTF-8 file, with or without byte order mark. Raises InputError."""
    data = read_bytes(path, max_bytes)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"expected UTF-8 text, found byte {data[error.start]:#04x}", path=path, line=line) from None
