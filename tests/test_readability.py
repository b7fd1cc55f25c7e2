"""The sizes of folders, files, functions and calls that a reader can take in at once."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

import vttig_jax

pytestmark = pytest.mark.smoke

PACKAGE = Path(vttig_jax.__file__).parent
SOURCES = sorted(path for path in PACKAGE.rglob("*.py") if path.name != "__init__.py")

MOST_FILES = 15
"""Files in a folder."""
MOST_LINES = 400
"""Lines in a file."""
MOST_LINES_OF_A_FUNCTION = 60
MOST_ARGUMENTS = 5
"""Arguments of one call that are told apart by their position only."""

POSITIONAL_ONLY = {"Geom_BSplineSurface"}
"""Functions of other libraries that take no names."""


def long_functions(tree: ast.AST, most: int = MOST_LINES_OF_A_FUNCTION) -> Iterator[str]:
    """Functions of more than `most` lines without their docstring."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            lines = _lines(node)
            if ast.get_docstring(node) is not None:
                lines -= _lines(node.body[0])
            if lines > most:
                yield f"{node.name}: {lines} lines"


def _lines(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def long_calls(tree: ast.AST) -> Iterator[str]:
    """Calls with more positional arguments than a reader can tell apart."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            told = [one for one in node.args if not isinstance(one, ast.Starred)]
            if len(told) > MOST_ARGUMENTS and name not in POSITIONAL_ONLY:
                yield f"line {node.lineno}: {name}"


def test_folders_hold_few_files():
    folders = Counter(path.parent for path in SOURCES)
    assert {str(folder): files for folder, files in folders.items() if files > MOST_FILES} == {}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_files_functions_and_calls_are_short(path):
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    assert len(text.splitlines()) <= MOST_LINES
    assert list(long_functions(tree)) == []
    assert list(long_calls(tree)) == []


def test_what_is_too_long_is_seen():
    tree = ast.parse("def f():\n    x = 1\n    return g(1, 2, 3, 4, 5, 6)")
    assert list(long_functions(tree, most=2)) == ["f: 3 lines"]
    assert list(long_calls(tree)) == ["line 3: g"]
    assert list(long_calls(ast.parse("g(1, 2, 3, 4, 5, six=6)"))) == []
