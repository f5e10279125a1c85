"""What packages and tests may use of each other: names without an underscore, and what a package's `__init__` offers.

A name with an underscore may change without a word to anybody, so a test that uses it holds no promise to users. A
module inside of a package may be split or renamed as long as its `__init__` goes on offering the same.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from folders import ROOT

TESTS = sorted((ROOT / "tests").rglob("*.py"))
PACKAGE = sorted((ROOT / "localiser").rglob("*.py"))
COMPILED = {"localiser.geometry.compiled", "localiser.geometry.angle_kernel"}  # `geometry` itself never imports numba
NAMED_TUPLES = {"_replace", "_fields", "_asdict"}
PRIVATE = re.compile(r"_[a-zA-Z]\w*")


def own_names(tree: ast.AST) -> set[str]:
    """Return what a file defines itself: its functions and classes, and what is assigned in it."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and is_self(node.value):
            found.add(node.attr)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def is_self(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id in ("self", "cls")


def takes_names(call: ast.Call) -> bool:
    return re.search(r"(attr|patch|object)$", ast.unparse(call.func)) is not None


def foreign_private_names(text: str) -> Iterator[str]:
    """Yield the private names that a file takes from others: imported, as attributes, or as words of a call."""
    tree = ast.parse(text)
    own = own_names(tree) | NAMED_TUPLES
    for node in ast.walk(tree):
        match node:
            case ast.ImportFrom(module=module, names=names):
                used = [*(module or "").split("."), *(each.name for each in names)]
            case ast.Attribute(attr=name):
                used = [name]
            case ast.Call(args=arguments):  # getattr, setattr, patch
                words = [str(each.value) for each in arguments if isinstance(each, ast.Constant)]
                used = [word.rpartition(".")[2] for word in words if takes_names(node)]
            case _:
                used = []
        yield from (name for name in used if PRIVATE.fullmatch(name) and name not in own)


def is_offered(package: str, name: str) -> bool:
    found = getattr(importlib.import_module(package), name, None) if package.startswith("localiser") else None
    return found is not None and not inspect.ismodule(found)


def inner_modules(text: str, package: str) -> Iterator[str]:
    """Yield the modules inside of other packages that a file of `package` imports."""
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.ImportFrom(module=str(module), level=0):
                names = [module, *(f"{module}.{each.name}" for each in node.names if not is_offered(module, each.name))]
            case ast.Import():
                names = [each.name for each in node.names]
            case _:
                names = []
        for name in names:
            top, own, *inner = [*name.split("."), ""][:3]
            if top == "localiser" and own != package and any(inner) and name not in COMPILED:
                file = ROOT / Path(*name.split(".")).with_suffix(".py")
                if file.exists():
                    yield name


def test_no_test_uses_a_private_name() -> None:
    found = {str(file): set(foreign_private_names(file.read_text(encoding="utf-8"))) for file in TESTS}
    assert not {file: names for file, names in found.items() if names}


def test_packages_import_each_other_and_not_their_modules() -> None:
    found = {}
    for file in PACKAGE:
        package = file.relative_to(ROOT / "localiser").parts[0].removesuffix(".py")
        found[str(file)] = set(inner_modules(file.read_text(encoding="utf-8"), package))
    assert not {file: names for file, names in found.items() if names}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("from localiser.geometry.angles import _turn", {"_turn"}),
        ("from localiser._inner import turn", {"_inner"}),
        ("compiled._Kept(loop)", {"_Kept"}),
        ("monkeypatch.setattr(angles, '_turn', None)", {"_turn"}),
        ("patch('localiser.geometry.angles._turn')", {"_turn"}),
        ("found.pose._replace(x=0); np.random.__name__; for_each(_)", set()),
        ("def _mine(): pass\n_mine(); module._mine()", set()),
        ("class Robot:\n  def __init__(self): self._count = 0\n  def same(self, other): return other._count", set()),
    ],
)
def test_private_names_are_found(text: str, found: set[str]) -> None:
    assert set(foreign_private_names(text)) == found


def test_inner_modules_are_found() -> None:
    text = "from localiser.geometry.angles import wrap_angle\nfrom localiser.geometry import poses, compose"
    assert set(inner_modules(text, "filter")) == {"localiser.geometry.angles", "localiser.geometry.poses"}
    assert not set(inner_modules(text, "geometry"))
