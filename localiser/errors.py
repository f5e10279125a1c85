"""The errors that a user sees: one paragraph, no traceback, exit code 2."""

from __future__ import annotations

import warnings
from pathlib import Path

_LONGEST = 2000


class LocaliserError(Exception):
    """Something that the user can mend; the message says what and where.

    It is one paragraph, whatever a file or a library put into it: characters that a terminal would act on are escaped.
    """

    exit_code = 2

    def __init__(self, message: str) -> None:
        super().__init__(one_paragraph(message))


def one_paragraph(text: str) -> str:
    """Return a text on one line, not too long, with characters that cannot be printed as their escapes."""
    line = " ".join(text[: 2 * _LONGEST].split())
    if not line.isprintable():
        line = "".join(mark if mark.isprintable() else repr(mark)[1:-1] for mark in line)
    return line if len(line) <= _LONGEST else line[:_LONGEST] + "…"


def reason_of(error: OSError) -> str:
    """Return why the system refused something; where a folder was copied, why the first of its files was not."""
    if error.args and isinstance(error.args[0], list):  # of shutil: (source, target, reason) of each file
        return str(error.args[0][0][-1])
    return error.strerror or str(error)


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error comes of too little memory, whoever tells it: Python, the loader of a library, or OpenCV."""
    told = ("Cannot allocate memory", "failed to map segment", "start new thread", "Insufficient memory")
    return isinstance(error, MemoryError) or any(words in str(error) for words in told)


class InputError(LocaliserError):
    """A file, a field or an option that is not what it should be.

    The message reads `file:line: field: expected …, found …`; parts that are not known are left out.
    """

    def __init__(
        self,
        problem: str,
        *,
        path: Path | str | None = None,
        line: int | None = None,
        column: int | None = None,
        field: str | None = None,
    ) -> None:
        place = ":".join(str(part) for part in (path, line, column) if part is not None)
        super().__init__(": ".join(part for part in (place, field, problem) if part))
        self.problem, self.path, self.line, self.column, self.field = problem, path, line, column, field


class InputWarning(UserWarning):
    """Something in a file that was passed over or taken otherwise than it is written; the command line prints it."""


class InputNote(InputWarning):
    """What was chosen of a file where it could have been otherwise; not printed with --quiet."""


def warn(problem: str, *, path: Path | str, line: int | None = None, kind: type[InputWarning] = InputWarning) -> None:
    """Tell once of something in a file that is no error."""
    warnings.warn(kind(str(InputError(problem, path=path, line=line))), stacklevel=3)


class OutputError(LocaliserError):
    """Results that cannot be written where they were asked for."""


class RunEndedEarlyError(LocaliserError):
    """A run that broke off; what was done until then is on disk, and the message says where."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code
