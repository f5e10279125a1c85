"""Write files and folders whole or not at all; what the system says about it is an OutputError that names the path."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from localiser.errors import OutputError, reason_of


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

    The draft lies beside it under a name that no other has, so that neither another run nor a file of the user's is in
    the way. is_new: nothing is overwritten, whoever was there first. A device or pipe, such as /dev/null, is left what
    it is. Raises OutputError.
    """
    _require_replaceable(path)
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


def _require_replaceable(path: Path) -> None:
    """Raise OutputError where something is that is neither a file nor a folder; root could replace it."""
    with suppress(OSError, ValueError):  # nothing is there, or whoever writes there will be told
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise OutputError(f"{path}: expected a file, or a path where nothing is, found a device or pipe")


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
