"""The tests that run on every processor cover every verb of the command line."""

import ast
from pathlib import Path

from vttig_jax.cli.main import VERBS

TESTS = Path(__file__).parent


def has_portable_test(path: Path) -> bool:
    """Does a test of this file carry the mark?"""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    marks = [
        ast.unparse(mark)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        for mark in node.decorator_list
    ]
    return "pytest.mark.portable" in marks


def test_every_verb_has_one():
    missing = [
        v for v in VERBS if not has_portable_test(TESTS / "cli" / f"test_{v.replace('-', '_')}.py")
    ]
    assert missing == []


def test_a_file_without_one_is_seen():
    assert not has_portable_test(TESTS / "test_imports.py")
