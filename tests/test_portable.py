"""The tests that run on every processor cover every verb of the command line."""

import ast
from pathlib import Path

from vttig_jax.cli.main import VERBS

TESTS = Path(__file__).parent


def has_portable_test(path: Path) -> bool:
    """Does a test of this file carry the mark?"""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    functions = (node for node in nodes if isinstance(node, ast.FunctionDef))
    marks = {ast.unparse(mark) for node in functions for mark in node.decorator_list}
    return "pytest.mark.portable" in marks


def test_every_verb_has_one():
    tests = {verb: TESTS / "cli" / f"test_{verb.replace('-', '_')}.py" for verb in VERBS}
    assert [verb for verb, path in tests.items() if not has_portable_test(path)] == []
    assert not has_portable_test(TESTS / "test_imports.py")
