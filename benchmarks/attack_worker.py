"""One worker: takes cases from standard input, a line each, and answers on standard output how each ended.

Limits of time and memory are enforced by whoever started it, see `attack_pool`. SIGUSR1 writes where it is.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import random
import signal
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import attack_targets as targets

from localiser.errors import LocaliserError

LONGEST_MESSAGE = 2001


def case(name: str, number: int, samples: Path, folder: Path) -> dict[str, Any]:
    """Prepare a case in `folder`, run it, and return how it ended.

    end: value, refused, or what is wrong; at: where, for faults; seconds: processor time, without the preparation.
    """
    target = targets.TARGETS[name]
    out = folder / "out"
    out.mkdir(parents=True)
    path = targets.prepared(target, samples, folder / "in", random.Random(f"{name} {number}"))
    before = contents(folder / "in")
    end = attempt(target, path, out)
    if name in targets.READERS and contents(folder / "in") != before:
        end |= {"end": "changed", "at": "a file that is read, or one beside it"}
    return end


def contents(folder: Path) -> dict[str, bytes]:
    """Return what the regular files in a folder hold, by their paths."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    return {os.fsdecode(path): path.read_bytes() for path in files}


def attempt(target: targets.Target, path: Path, out: Path) -> dict[str, Any]:
    """Run a target on an input and return how that ended, see `case`."""
    begin = time.process_time()
    here = Path.cwd()
    try:
        target.run(path, out)
        end: dict[str, Any] = {"end": "value"}
    except LocaliserError as error:
        end = {"end": "refused"}
        if "\n" in str(error) or len(str(error)) > LONGEST_MESSAGE:
            end = {"end": "message", "at": "an error of more than one paragraph", "text": str(error)[:5000]}
    except Exception as error:
        last = [frame for frame in traceback.extract_tb(error.__traceback__) if "/localiser/" in frame.filename]
        place = f"{last[-1].filename.split('/localiser/')[-1]}:{last[-1].lineno}" if last else "outside"
        end = {"end": type(error).__name__, "at": place, "text": traceback.format_exc()[-5000:]}
    finally:
        os.chdir(here)
    drafts = [part.name for part in out.rglob(".localiser-*")]
    if drafts and end["end"] in ("value", "refused"):
        end = {"end": "draft", "at": "left behind", "text": ", ".join(drafts)}
    return end | {"seconds": round(time.process_time() - begin, 4)}


def _peak_mb() -> float:
    """Return the most memory (MB) since it was asked last (Linux)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            Path("/proc/self/clear_refs").write_text("5")
            return int(line.split()[1]) / 1024
    return 0.0


def _import_all() -> None:
    """Import what most cases need, so that the first ones do not take longer than the others."""
    import localiser.batch
    import localiser.commands.map
    import localiser.replay
    import localiser.simulate
    import localiser.storage.bags  # noqa: F401


def main() -> None:
    faulthandler.register(signal.SIGUSR1, file=sys.__stderr__, all_threads=True)
    warnings.filterwarnings("error", category=RuntimeWarning, module="localiser")
    answers = os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 1)
    samples = Path(sys.argv[1])
    targets.use_samples(samples)
    _import_all()
    for line in sys.stdin:
        name, number, folder = json.loads(line)
        _peak_mb()
        said = Path(folder).with_suffix(".said")
        with said.open("w") as file, contextlib.redirect_stdout(file), contextlib.redirect_stderr(file):
            end = case(name, number, samples, Path(folder))
        if end["end"] in ("value", "refused") and "Traceback" in said.read_text(errors="replace"):
            end |= {"end": "traceback", "at": "printed", "text": said.read_text(errors="replace")[-5000:]}
        print(json.dumps(end | {"peak_mb": round(_peak_mb(), 1)}), file=answers, flush=True)


if __name__ == "__main__":
    main()
