"""The glossary names only what the package has."""

import ast
import re
from pathlib import Path

import pytest

import vttig_jax
from vttig_jax.report.words import WORDS

pytestmark = pytest.mark.smoke

PACKAGE = Path(vttig_jax.__file__).parent
GLOSSARY = PACKAGE.parent / "docs" / "glossary.md"


def names_of(source: str) -> set[str]:
    """Every name, attribute, argument and text of a module's source."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        for field in ("id", "attr", "arg", "name", "module"):
            value = getattr(node, field, None)
            if isinstance(value, str):
                found |= set(value.split("."))
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
    return found


def test_every_name_of_the_glossary_is_in_the_package():
    files = [*PACKAGE.rglob("*.py")]
    known = {file.stem for file in files}.union(*(names_of(file.read_text()) for file in files))
    rows = [line for line in GLOSSARY.read_text().splitlines() if line.startswith("| ")]
    named = {
        part
        for row in rows
        for code in re.findall(r"`([^`]+)`", row.split("|")[3])
        for part in re.findall(r"\w+", code)
    }
    assert len(named) > 50
    assert named - known == set()
    assert "no_such_name" not in known


def test_the_words_of_a_report_are_those_of_explain():
    section = GLOSSARY.read_text().partition("## Words of a report")[2]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if "| " in line]
    assert dict(rows[1:]) == dict(WORDS.values())
