"""The errors that a user sees: one paragraph, no traceback, exit code 2."""

from __future__ import annotations

from pathlib import Path


class LocaliserError(Exception):
    """Something that the user can mend; the message says what and where."""

    exit_code = 2


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


class OutputError(LocaliserError):
    """Results that cannot be written where they were asked for."""


class RunEndedEarlyError(LocaliserError):
    """A run that broke off; what was done until then is on disk, and the message says where."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code
