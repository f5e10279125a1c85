"""Read files of bounded size, write files and folders whole or not at all; errors name the path."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from localiser.errors import InputError, OutputError, reason_of

MAX_DOCUMENT_BYTES = 16 * 2**20


@contextmanager
def open_regular(path: Path, what: str = "file") -> Iterator[BinaryIO]:
    """Yield a regular file, open for reading. what: it is, for the error where there is none. Raises InputError.

    A pipe, a device or a socket could keep its reader waiting for ever; opening it does not.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(descriptor, "rb") as file:  # noqa: PTH123 - of a descriptor
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise InputError("expected a file, found a device or pipe", path=path)
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


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn what the operating system says about writing `path` into an OutputError."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {reason_of(error)}") from None


@contextmanager
def drafted(path: Path, *, is_new: bool = False) -> Iterator[Path]:
    """Yield where to write a file or a folder; it takes its place at `path` at the end, or is removed after an error.

    The draft lies beside it under a name that no other has. is_new: nothing is overwritten, whoever was there first. A
    device or pipe, such as /dev/null, is left what it is. Raises OutputError.
    """
    with suppress(OSError, ValueError):  # nothing is there, or whoever writes there will be told
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # root could replace it
            raise OutputError(f"{path}: expected a file, or a path where nothing is, found a device or pipe")
    draft = draft_beside(path)
    with output_errors(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            yield draft
            if is_new and not draft.is_dir():
                _link(draft, path)
            else:
                draft.replace(path)
        except BaseException:
            remove(draft)
            raise


def draft_beside(path: Path) -> Path:
    """Return a path beside another one which no other program and no user has."""
    return path.parent / f".localiser-{secrets.token_hex(8)}.part"


def _link(draft: Path, path: Path) -> None:
    """Give a file its name, which must be free."""
    try:
        os.link(draft, path)
    except FileExistsError:
        raise OutputError(f"{path}: expected a path where nothing is, found something there") from None
    except OSError:  # a file system without links
        draft.replace(path)
    else:
        draft.unlink()


def remove(draft: Path) -> None:
    """Remove a file or a folder, if it is there and can be."""
    try:
        draft.unlink(missing_ok=True)
    except OSError:
        shutil.rmtree(draft, ignore_errors=True)


def write_all(write: Callable[[memoryview], int], content: bytes) -> None:
    """Hand all of the content to a call that may take a part of it at a time, and returns how much that was."""
    rest = memoryview(content)
    while rest:
        rest = rest[write(rest) :]


def write_text(path: Path, content: str) -> None:
    """Write a UTF-8 file whole or not at all: an interruption leaves what was there before. Raises OutputError.

    A character that UTF-8 does not have, as in the name of a file that is no text, is written as its escape.
    """
    write_bytes(path, content.encode(errors="backslashreplace"))


def write_bytes(path: Path, content: bytes, *, durably: bool = False) -> None:
    """Write a file whole or not at all: an interruption leaves what was there before. Raises OutputError.

    durably: also when the power fails at any moment, at the cost of waiting for the disk.
    """
    with drafted(path) as draft, draft.open("xb") as file:
        file.write(content)
        if durably:
            file.flush()
            os.fsync(file.fileno())
