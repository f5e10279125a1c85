"""The public API: every name is there, is what it says, stays itself when all modules are imported, is documented."""

import ast
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import localiser

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "localiser"
PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
SIGNATURES = dict(re.findall(r"^### `(\w+)\((.*?)\)[^)]*`$", PAGE, re.MULTILINE))
HEAVY = ("numpy", "cv2", "scipy", "numba", "pydantic", "rerun", "matplotlib", "filterpy")


def import_every_module() -> list[str]:
    names = [module.name for module in pkgutil.walk_packages(localiser.__path__, "localiser.")]
    names.remove("localiser.__main__")
    for name in names:
        importlib.import_module(name)
    return names


def test_importing_the_package_imports_no_library() -> None:
    code = f"import localiser, sys; print([name for name in {HEAVY} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_public_names_are_no_modules_after_every_module_was_imported() -> None:
    """Importing a module sets its name in the package: it must not take the place of a function."""
    modules = {name.removeprefix("localiser.") for name in import_every_module()}
    assert modules.isdisjoint(localiser.__all__)
    for name in localiser.__all__:
        assert not isinstance(getattr(localiser, name), ModuleType) and callable(getattr(localiser, name))


def test_a_star_import_and_dir_give_the_public_names() -> None:
    space: dict[str, object] = {}
    exec("from localiser import *", space)
    assert set(localiser.__all__) <= set(space) and set(localiser.__all__) <= set(dir(localiser))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        localiser.nothing  # noqa: B018


def test_type_checkers_see_the_same_names() -> None:
    (typed,) = (node for node in ast.parse((PACKAGE / "__init__.py").read_text()).body if isinstance(node, ast.If))
    seen = {
        alias.name: statement.module
        for statement in typed.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    assert set(seen) == set(localiser.__all__) and (PACKAGE / "py.typed").exists()
    for name, module in seen.items():
        assert getattr(importlib.import_module(str(module)), name) is getattr(localiser, name)


def test_every_public_name_is_on_the_page() -> None:
    assert set(localiser.__all__) <= set(re.findall(r"`(\w+)[(`]", PAGE))


def test_every_function_is_in_code_that_runs() -> None:
    for name in localiser.__all__:
        if inspect.isfunction(getattr(localiser, name)):
            assert name in SIGNATURES and any(re.search(rf"\b{name}\(", code) for code in CODE), name


@pytest.mark.parametrize("name", SIGNATURES)
def test_signatures_on_the_page_are_those_of_the_code(name: str) -> None:
    written = inspect.signature(eval(f"lambda {SIGNATURES[name]}: None")).parameters.values()
    real = inspect.signature(getattr(localiser, name)).parameters.values()
    assert [(p.name, p.kind, p.default) for p in written] == [(p.name, p.kind, p.default) for p in real]
