"""Compile loops by numba, and keep their machine code, so that only the first run has to wait for it.

Numba's own cache does not do (0.68): its key is the time of a loop's file alone, so what is inlined from another file
goes out of date; two processes that compile at once can mix up their files; a damaged file, or no folder that can be
written, ends the program. Here the key is a digest of the loop's file, of the files of loops and the constants that it
imports, of how it is compiled, the types of the arguments, the processor and the versions of numba, LLVM, numpy and
Python. Kept code is never out of date, as long as loops use nothing else from other files, which a test checks.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import re
import secrets
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

# Sums may be contracted to fused operations, but never be put into another order: results do not depend on what stands
# beside a particle.
_RULES: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}
_KEPT_FILES = 1000  # of about 70 kB; those used last stay
_CHECKSUM_BYTES = 32
_OUR_NAME = re.compile(r"\w+-[0-9a-f]{40}(\.[0-9a-f]{8})?")  # the latter: a draft


def _with_numba(function: Callable[..., Any], **rules: Any) -> Any:
    from numba import njit

    rules["no_cfunc_wrapper"] = True  # no C code calls it
    return njit(**rules)(function)


@cache
def _kept(function: Callable[..., Any], is_entry: bool) -> Any:
    loop = _with_numba(function, nogil=True, **(_RULES if is_entry else {"error_model": "numpy"}))
    if hasattr(loop, "targetoptions"):  # a plain function where NUMBA_DISABLE_JIT is set
        loop._cache = _Kept(loop)
    return loop


entry: Callable[[F], F] = partial(_kept, is_entry=True)
"""Compile a loop over particles that Python calls; its machine code is kept. See `compiled`."""
compiled: Callable[[F], F] = partial(_kept, is_entry=False)
"""Compile any other loop, with sums as they are written; its machine code is kept.

A decorator, or called where the loop is first needed: the same function is compiled once.
"""
inlined: Callable[[F], F] = partial(_with_numba, forceinline=True, no_cpython_wrapper=True, **_RULES)
"""Compile a part of loops over particles; it is inlined into the caller, where shapes are constant."""
part: Callable[[F], F] = partial(_with_numba, no_cpython_wrapper=True, error_model="numpy", nogil=True)
"""Compile a part of loops that `compiled` compiles: Python cannot call it, so nothing is made or kept for that."""


# -- where machine code is kept ---------------------------------------------------------------------------------------


@cache
def folder() -> Path | None:
    """Return the folder of kept machine code; None where nothing can be kept, so that every run compiles anew."""
    return private_folder("compiled")


def private_folder(name: str) -> Path | None:
    """Return the folder of this name in which results are kept between runs; None where none can be.

    That is `$LOCALISER_CACHE/NAME`, else `localiser/NAME` in the user's cache folder, else a folder in the one for
    temporary files. It is the first that can be written and that no other user can put anything into, because this
    process trusts what is in it: it executes the code.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    places = [Path(stated) / name] if (stated := os.environ.get("LOCALISER_CACHE")) else []
    with suppress(RuntimeError):  # a user without a home
        places.append(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "localiser" / name)
    with suppress(OSError):  # no folder for temporary files
        places.append(Path(tempfile.gettempdir()) / f"localiser-{name}-{user}")
    return next((private for place in places if (private := _private(place, user))), None)


def _private(place: Path, user: int) -> Path | None:
    """Make a folder where there is none, and return it without links; None where another user could change it.

    Whoever can write to a folder on the way there could put another in its place, but for what is in one like /tmp.
    """
    try:
        place = place.parent.resolve() / place.name
        for folder in (*reversed(place.parents), place):
            if not folder.exists():
                with suppress(FileExistsError):
                    folder.mkdir(mode=0o700)
            found = folder.lstat()
            others_write = found.st_mode & 0o022 and (folder == place or not found.st_mode & stat.S_ISVTX)
            if not stat.S_ISDIR(found.st_mode) or found.st_uid not in (0, user) or others_write:
                return None
        tempfile.TemporaryFile(dir=place).close()
    except (OSError, RuntimeError):  # a link to itself
        return None
    return place if found.st_uid == user else None


class _Kept:
    """The machine code of one loop, a file for each signature; to numba, the loop's cache."""

    def __init__(self, loop: Any) -> None:
        self._loop = loop

    @property
    def cache_path(self) -> str:
        """Where files are kept, for numba's `stats`."""
        return str(folder() or "")

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the compiled loop as numba saved it; None where it is not kept, or its file is damaged."""
        from numba.core.compiler import CompileResult

        path = self._path(signature, target.codegen())
        content = read_kept(path) if path else None
        if content is None:
            return None
        target.refresh()
        return CompileResult._rebuild(target, *pickle.loads(content))

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep a compiled loop, if it can be used by another process."""
        from numba.core.serialize import dumps

        path = self._path(signature, result.codegen)
        if path and not result.lifted and not result.library.has_dynamic_globals:
            write_kept(path, dumps(result._reduce()), _KEPT_FILES)

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        where, function = folder(), self._loop.py_func
        if where is None:
            return None
        # The name of a named tuple's type leaves out its fields.
        fields = [getattr(getattr(argument, "instance_class", None), "_fields", ()) for argument in signature]
        try:
            told = [*_told(function, set())]
        except OSError:  # a loop that stands in no file
            return None
        # A set is printed in another order by each process.
        rules = [(name, sorted(one) if isinstance(one, set) else one) for name, one in self._loop.targetoptions.items()]
        content = (_versions(), codegen.magic_tuple(), str(signature), fields, rules, told)
        digest = hashlib.sha256(repr((function.__qualname__, content)).encode()).hexdigest()
        return where / f"{function.__name__}-{digest[:40]}"


def read_kept(path: Path) -> bytes | None:
    """Return what `write_kept` wrote there; None where there is nothing, or it is damaged."""
    try:
        content = path.read_bytes()
        os.utime(path)  # used just now
    except OSError:
        return None
    checksum, content = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
    return content if hashlib.sha256(content).digest() == checksum else None


def write_kept(path: Path, content: bytes, most: int) -> None:
    """Write a file whole or not at all, and keep at most so many: those used last. That it cannot be is no failure.

    path: in a folder of `private_folder`, and named `NAME-DIGEST`, with 40 characters of the digest.
    """
    draft = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    try:
        draft.write_bytes(hashlib.sha256(content).digest() + content)
        draft.replace(path)
        ours = [file for file in path.parent.iterdir() if _OUR_NAME.fullmatch(file.name)]
        for file in sorted(ours, key=lambda file: file.stat().st_mtime)[:-most]:
            file.unlink(missing_ok=True)
    except OSError:
        return
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


# -- what machine code depends on -------------------------------------------------------------------------------------


@cache
def _versions() -> tuple[object, ...]:
    import llvmlite
    import numba

    told = [each for each in os.environ.items() if each[0].startswith("NUMBA_") and each[0] != "NUMBA_NUM_THREADS"]
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.version, platform.machine())
    return (*versions, *sorted(told))


def _told(function: Any, met: set[str]) -> Iterator[object]:
    """Yield the content of a loop's file, unless met, and the loops and constants in it, wherever they are defined."""
    file = function.__code__.co_filename
    if file in met:
        return
    met.add(file)
    yield hashlib.sha256(Path(file).read_bytes()).hexdigest()
    for name, value in function.__globals__.items():
        if hasattr(value, "py_func"):
            yield from _told(value.py_func, met)
        elif isinstance(value, (int, float, tuple, np.ndarray, np.generic)) and not name.startswith("__"):
            yield name, value.tolist() if isinstance(value, np.ndarray) else value
