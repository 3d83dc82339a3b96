"""What type checkers know of the binding."""

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

from rosplat_core import _core


@pytest.mark.skipif(not find_spec("pybind11_stubgen"), reason="pybind11-stubgen is not installed")
def test_type_checkers_know_all_that_the_binding_defines() -> None:
    stub = ast.parse(Path(_core.__file__).with_name("_core.pyi").read_text())
    told = {node.name for node in stub.body if isinstance(node, (ast.ClassDef, ast.FunctionDef))}
    assert told == {name for name in vars(_core) if not name.startswith("_")}
