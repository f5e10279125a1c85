"""Machine code is kept between runs, is never out of date, and nothing fails where it cannot be kept."""

import ast
import importlib
import inspect
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

import localiser
from localiser.geometry import compiled, private_folder, write_kept

PACKAGE = Path(str(localiser.__file__)).parent
MODULES_WITH_LOOPS = [
    ".".join(("localiser", *file.relative_to(PACKAGE).with_suffix("").parts))
    for file in sorted(PACKAGE.rglob("*.py"))
    if re.search(r"geometry.compiled import .*\b(entry|compiled)\b", file.read_text())
]
CONSTANTS = (int, float, tuple, np.ndarray, np.generic)
NOWHERE = "/proc/nonexistent"  # where nobody can make a folder, root neither

OTHER = """
from typing import NamedTuple
import numpy as np
from localiser.geometry.compiled import inlined

FACTOR = 3.0
TABLE = np.array([5.0, 7.0])

class Pair(NamedTuple):
    first: float
    second: float

@inlined
def deeper(x):
    return FACTOR * x

@inlined
def helper(x):
    return deeper(x) + TABLE[0]
"""
LOOP = """
import numpy as np
import other
from other import FACTOR, TABLE, Pair, helper
from localiser.geometry.compiled import compiled, entry

@entry
def loop(x, pair):
    made = Pair(x, 5.0)
    return helper(x) + 100.0 * pair.first + 1000.0 * made.first
"""
START = 6.0 + 5.0 + 1100.0 + 2000.0  # of x = 2 and the pair 11, 13


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Keep machine code in a folder of this test."""
    monkeypatch.setenv("LOCALISER_CACHE", str(tmp_path / "cache"))
    compiled.folder.cache_clear()
    yield tmp_path / "cache" / "compiled"
    compiled.folder.cache_clear()


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Tell which folder is chosen in an environment, or where the user has no home."""

    def choose(name: str = "compiled", **environment: object) -> Path | None:
        for variable in ("LOCALISER_CACHE", "XDG_CACHE_HOME"):
            monkeypatch.delenv(variable, raising=False)
        for variable, value in environment.items():
            monkeypatch.setenv(variable, str(value))
        monkeypatch.setattr("tempfile.tempdir", None)
        return private_folder(name)

    return choose


class Modules:
    """A loop and what it inlines, in two modules that are imported anew, as a new process would."""

    def __init__(self, where: Path) -> None:
        self.where = where
        self.content = {"other": OTHER, "loop": LOOP}

    def edit(self, name: str, old: str, new: str) -> None:
        assert old in self.content[name]
        self.content[name] = self.content[name].replace(old, new)

    def run(self) -> tuple[float, bool]:
        """Return what the loop gives, and whether its code was kept."""
        for name, content in self.content.items():
            sys.modules.pop(name, None)
            (self.where / f"{name}.py").write_text(content)
        importlib.invalidate_caches()
        module = importlib.import_module("loop")
        value = module.loop(2.0, module.other.Pair(11.0, 13.0))
        return value, sum(module.loop.stats.cache_hits.values()) == 1


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: Path) -> Iterator[Modules]:
    (tmp_path / "source").mkdir()
    monkeypatch.syspath_prepend(tmp_path / "source")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it goes by time, to the second
    yield Modules(tmp_path / "source")
    for name in ("other", "loop"):
        sys.modules.pop(name, None)


def python(code: str, package: Path, **environment: str) -> str:
    """Run code in a process of its own and return what it prints."""
    base = {name: value for name, value in os.environ.items() if name not in ("LOCALISER_CACHE", "XDG_CACHE_HOME")}
    done = subprocess.run(
        [sys.executable, "-c", dedent(code)],
        env={**base, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", **environment},
        cwd=package.parent,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Copy the package, so that it can be changed."""
    copy = tmp_path / "installed" / "localiser"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    return copy


# -- never out of date ------------------------------------------------------------------------------------------------


def test_code_is_compiled_once_and_then_loaded(modules: Modules, kept: Path) -> None:
    assert modules.run() == (START, False)
    assert modules.run() == (START, True)
    assert len(list(kept.iterdir())) == 1


@pytest.mark.parametrize(
    ("module", "old", "new", "value"),
    [
        ("other", "deeper(x) + TABLE[0]", "deeper(x) + TABLE[1]", START + 2.0),
        ("other", "FACTOR * x", "FACTOR + x", START - 1.0),
        ("other", "FACTOR = 3.0", "FACTOR = 4.0", START + 2.0),
        ("other", "[5.0, 7.0]", "[6.0, 7.0]", START + 1.0),
        ("other", "first: float\n    second: float", "second: float\n    first: float", START + 200.0 + 3000.0),
        ("loop", "1000.0", "2000.0", START + 2000.0),
        ("loop", "+ 100.0 * pair.first", "+ 100.0 * FACTOR", START - 800.0),
        ("loop", "@entry", "@compiled", START),
    ],
)
def test_what_changes_the_code_has_it_compiled_anew(modules, module, old, new, value):
    modules.run()
    modules.edit(module, old, new)
    assert modules.run() == (value, False)


def test_two_versions_are_kept_side_by_side(modules: Modules) -> None:
    modules.run()
    modules.edit("other", "FACTOR = 3.0", "FACTOR = 4.0")
    modules.run()
    modules.edit("other", "FACTOR = 4.0", "FACTOR = 3.0")
    assert modules.run() == (START, True)


@pytest.mark.parametrize("name", MODULES_WITH_LOOPS)
def test_loops_take_nothing_from_other_files_but_loops_and_constants(name: str) -> None:
    """All else would change without the key of the machine code."""
    module = importlib.import_module(name)
    source = ast.parse(inspect.getsource(module))
    given = [call.args[0] for call in ast.walk(source) if isinstance(call, ast.Call) and len(call.args) == 1]
    names = {arg.id for arg in given if isinstance(arg, ast.Name)} | {
        node.name for node in source.body if isinstance(node, ast.FunctionDef) and node.decorator_list
    }
    loops = [getattr(module, name, None) for name in sorted(names)]
    functions = [getattr(loop, "py_func", loop) for loop in loops if inspect.isfunction(getattr(loop, "py_func", loop))]
    assert functions
    for function in functions:
        if function.__module__ != name or hasattr(function, "cache_info"):
            continue
        for used in sorted(function.__globals__.keys() & set(function.__code__.co_names)):
            value = function.__globals__[used]
            is_own = getattr(value, "__module__", None) == name
            assert is_own or hasattr(value, "py_func") or isinstance(value, CONSTANTS) or value is np, (function, used)


@pytest.mark.parametrize("content", [b"", b"no checksum", None])
def test_a_damaged_file_is_made_anew(modules: Modules, kept: Path, content: bytes | None) -> None:
    modules.run()
    (file,) = kept.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if content is None else content)
    assert modules.run() == (START, False)
    assert modules.run() == (START, True)


def test_code_that_was_used_last_stays(modules: Modules, kept: Path) -> None:
    modules.run()
    (used,) = kept.iterdir()
    for n in range(1200):
        (kept / f"old-{n:040x}").write_bytes(b"")
        os.utime(kept / f"old-{n:040x}", (n, n))
    (kept / "notes.txt").write_text("of somebody else")
    os.utime(kept / "notes.txt", (0, 0))
    os.utime(used, (0, 0))
    modules.run()
    modules.edit("other", "FACTOR = 3.0", "FACTOR = 4.0")
    modules.run()
    left = {file.name for file in kept.iterdir()}
    assert used.name in left
    assert "notes.txt" in left
    assert len(left) == 1001
    assert f"old-{1199:040x}" in left
    assert f"old-{0:040x}" not in left


# -- anywhere ---------------------------------------------------------------------------------------------------------

COSINE = """
    import tempfile, numpy as np
    {without}
    from localiser.geometry import angle_kernel, compiled
    cos, sin = angle_kernel.cos_sin_of(np.zeros(1))
    print(angle_kernel.__file__, compiled.folder(), cos[0], sin[0])
"""


@pytest.mark.parametrize("has_temporary", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_read_only_installation_runs_without_a_home(package: Path, tmp_path: Path, has_temporary: bool) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    installed = sorted(package.rglob("*"))
    for path in [*installed, package]:
        path.chmod(path.stat().st_mode & ~0o222)
    without = "" if has_temporary else f"tempfile.tempdir = '{NOWHERE}'"
    for seed in "0123" if has_temporary else "0":  # of the order of sets: whatever it is, code is kept once
        said = python(COSINE.format(without=without), package, HOME=NOWHERE, TMPDIR=str(temporary), PYTHONHASHSEED=seed)
    where = temporary / f"localiser-compiled-{os.getuid()}" if has_temporary else None
    assert said == f"{package}/geometry/angle_kernel.py {where} 1.0 0.0"
    assert sorted(package.rglob("*")) == installed
    if where:
        assert stat.S_IMODE(where.stat().st_mode) == 0o700
        assert len(list(where.iterdir())) == 1


def test_the_first_folder_that_can_be_written_is_chosen(chosen: Any, tmp_path: Path) -> None:
    temporary = tmp_path / "t"
    temporary.mkdir()
    own = temporary / f"localiser-compiled-{os.getuid()}"
    cache, home = tmp_path / "cache", tmp_path / "home"
    assert chosen(LOCALISER_CACHE=cache, HOME=home, TMPDIR=temporary) == cache / "compiled"
    assert chosen(XDG_CACHE_HOME=cache, HOME=home, TMPDIR=temporary) == cache / "localiser" / "compiled"
    assert chosen(HOME=home, TMPDIR=temporary) == home / ".cache" / "localiser" / "compiled"
    assert chosen(LOCALISER_CACHE=NOWHERE, HOME=NOWHERE, TMPDIR=temporary) == own
    (tmp_path / "file").write_bytes(b"")
    assert chosen(HOME=tmp_path / "file", TMPDIR=temporary) == own


@pytest.mark.parametrize("fault", ["link", "open to others", "file", "of another user"])
def test_a_folder_that_others_could_write_into_is_not_used(chosen: Any, tmp_path: Path, fault: str) -> None:
    temporary, elsewhere = tmp_path / "t", tmp_path / "elsewhere"
    temporary.mkdir()
    elsewhere.mkdir(mode=0o700)
    own = temporary / f"localiser-compiled-{os.getuid()}"
    if fault == "link":
        own.symlink_to(elsewhere)
    elif fault == "file":
        own.write_bytes(b"")
    else:
        own.mkdir(mode=0o700)
    if fault == "open to others":
        own.chmod(0o770)
    if fault == "of another user":
        if os.getuid() != 0:
            pytest.skip("only root can give a folder away")
        os.chown(own, 65534, 65534)
    assert chosen(HOME=NOWHERE, TMPDIR=temporary) is None
    assert not own.is_dir() or not list(own.iterdir())


@pytest.mark.parametrize("name", ["compiled", "edges"])
@pytest.mark.parametrize("fault", ["open to others", "of another user", "a link to what another user owns"])
def test_a_folder_in_one_that_others_can_change_is_not_used(chosen: Any, tmp_path: Path, fault: str, name: str) -> None:
    """Whoever may write to a parent can put a folder of that user's own in the place of the cache."""
    theirs, stated = tmp_path / "theirs", tmp_path / "theirs" / "a" / "b"
    (stated / name).mkdir(parents=True, mode=0o700)
    if fault == "open to others":
        theirs.chmod(0o777)
    elif os.getuid() != 0:
        pytest.skip("only root can give a folder away")
    else:
        os.chown(theirs, 65534, 65534)
    if fault.startswith("a link"):
        (tmp_path / "link").symlink_to(stated)
        stated = tmp_path / "link"
    temporary = tmp_path / "t"
    temporary.mkdir()
    assert chosen(name, LOCALISER_CACHE=stated, HOME=NOWHERE, TMPDIR=temporary).parent == temporary
    theirs.chmod(0o1777)  # as /tmp is: what is there stays its owner's
    os.chown(theirs, 0, 0) if os.getuid() == 0 else None
    assert chosen(name, LOCALISER_CACHE=stated, HOME=NOWHERE, TMPDIR=temporary) == stated.resolve() / name


def test_a_user_who_is_unknown_to_the_system_has_a_temporary_folder(chosen, tmp_path, monkeypatch):
    """As in `docker --user 12345`."""

    def unknown(uid: int) -> object:
        raise KeyError(uid)

    monkeypatch.delenv("HOME")
    monkeypatch.setattr("pwd.getpwuid", unknown)
    assert chosen("edges", TMPDIR=tmp_path) == tmp_path / f"localiser-edges-{os.getuid()}"


def test_what_is_made_on_the_way_is_the_users_alone(chosen: Any, tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        assert chosen(LOCALISER_CACHE=tmp_path / "a" / "b") == tmp_path / "a" / "b" / "compiled"
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o700


def test_a_disk_that_is_full_keeps_no_draft(tmp_path: Path) -> None:
    code = """
        import resource, sys
        from pathlib import Path
        from localiser.geometry import write_kept
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
        write_kept(Path(sys.argv[1]) / ("part-" + 40 * "0"), bytes(5000), 10)
    """
    subprocess.run([sys.executable, "-c", dedent(code), str(tmp_path)], check=True)
    assert list(tmp_path.iterdir()) == []


def test_drafts_of_a_process_that_was_killed_go_with_the_oldest_files(tmp_path: Path) -> None:
    draft = tmp_path / f"part-{40 * '0'}.0123abcd"
    draft.write_bytes(b"")
    os.utime(draft, (1, 1))
    write_kept(tmp_path / f"part-{40 * '1'}", b"", 1)
    assert not draft.exists()
