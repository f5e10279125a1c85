"""The program, run in this process as a shell would run it, and compiled anew for every state of its source.

All figures of runs and maps go through its commands, so that they stay what they are wherever its modules move to.
"""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "results" / "baseline"
"""What is kept from one measurement to the next: compiled loops and partial results; git ignores it."""
ONE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
COMPILED_KEPT = 2  # states of the source


def fingerprint(*folders: str) -> str:
    """Return a short digest of the source in these folders of the project."""
    digest = hashlib.sha256()
    for source in sorted(source for folder in folders for source in (ROOT / folder).rglob("*.py")):
        digest.update(str(source.relative_to(ROOT)).encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:12]


def prepare_environment() -> None:
    """Let child processes use this source, one thread each, and compiled loops of this very source.

    numba's own cache knows only the file that a loop stands in. What the loop takes from other files would go unseen.
    """
    sys.path.insert(0, str(ROOT))
    os.environ |= dict.fromkeys(ONE_THREAD, "1")
    compiled = KEPT / "compiled"
    own = compiled / fingerprint("localiser")
    own.mkdir(parents=True, exist_ok=True)
    own.touch()
    for old in sorted(compiled.iterdir(), key=lambda path: path.stat().st_mtime)[:-COMPILED_KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(own)


def begin_process() -> None:
    """Prepare a worker: OpenCV with one thread, and no other copy of the package than this one."""
    import cv2

    import localiser

    cv2.setNumThreads(1)
    found = Path(str(localiser.__file__)).resolve().parents[1]
    if found != ROOT:
        raise RuntimeError(f"expected the package in {ROOT}, found it in {found}")


def run(*arguments: object, cache: Path) -> None:
    """Run one command of the program. cache: folder in which it may keep edges. Raises RuntimeError when it fails."""
    import mrclam

    from localiser.__main__ import main

    mrclam.register()
    said = io.StringIO()
    words = ["localiser", *map(str, arguments)]
    with (
        patch.object(sys, "argv", words),
        patch.dict(os.environ, {"LOCALISER_CACHE": str(cache)}),
        redirect_stdout(io.StringIO()),
        redirect_stderr(said),
    ):
        try:
            main()
        except SystemExit as end:
            if isinstance(end.code, int) and end.code >= 128:
                raise  # stopped by a signal
            if end.code:
                raise RuntimeError(f"{' '.join(words)}: {said.getvalue().strip()}") from None
