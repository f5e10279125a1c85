"""Files are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from localiser.errors import OutputError
from localiser.storage import require_new, require_new_file, write_bytes


@pytest.mark.parametrize("durably", [False, True])
def test_interrupted_writing_leaves_what_was_there_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, durably: bool
) -> None:
    path = tmp_path / "state"
    write_bytes(path, b"before", durably=durably)

    def fail(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr("os.fsync" if durably else "pathlib.Path.replace", fail)
    with pytest.raises(OutputError, match="state: cannot be written: no space left"):
        write_bytes(path, b"after", durably=durably)
    assert path.read_bytes() == b"before"
    assert [file.name for file in tmp_path.iterdir()] == ["state"]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    require_new(tmp_path)
    require_new(tmp_path / "new")
    require_new_file(tmp_path / "file")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="expected a new or empty folder, found files in it"):
        require_new(tmp_path)
    with pytest.raises(OutputError, match="expected a new file, found one that is there already"):
        require_new_file(tmp_path / "file")
