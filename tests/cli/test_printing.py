"""One module writes text for people; no other module of the package prints."""

import ast
from pathlib import Path

import pytest

import vttig_jax

pytestmark = pytest.mark.smoke

PACKAGE = Path(vttig_jax.__file__).parent
WRITER = PACKAGE / "cli" / "output.py"

FORBIDDEN = {
    "print",
    "input",
    "click.echo",
    "click.secho",
    "click.echo_via_pager",
    "tqdm",
    "sys.stdout.write",
    "sys.stderr.write",
    "sys.__stdout__.write",
    "sys.__stderr__.write",
    "os.write",
    "warnings.warn",
    "logging.StreamHandler",
    "logging.FileHandler",
    "logging.basicConfig",
    "traceback.print_exc",
    "pyplot.title",
}
"""Calls that would write past `cli/output.py`."""

ONLY_IN_STYLE = {"suptitle"}
"""Headings of pictures hold foreign names, so that only `plotting/style.py` sets them."""


def prints(source: str) -> list[str]:
    """Calls in a module that print."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    return [name for name in (ast.unparse(call.func) for call in calls) if name in FORBIDDEN]


def headings(source: str) -> list[str]:
    """Calls in a module that set a heading."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    names = [call.func.attr for call in calls if isinstance(call.func, ast.Attribute)]
    return [name for name in names if name in ONLY_IN_STYLE]


def test_no_other_module_prints():
    found = {
        str(path.relative_to(PACKAGE)): prints(path.read_text("utf-8"))
        for path in PACKAGE.rglob("*.py")
        if path != WRITER
    }
    assert {path: calls for path, calls in found.items() if calls} == {}


def test_headings_of_pictures_are_set_in_one_place():
    found = {path.name: headings(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")}
    assert {path for path, calls in found.items() if calls} == {"style.py"}


def test_the_check_sees_what_prints():
    assert prints(WRITER.read_text("utf-8")) != []
    assert prints("import click\nclick.echo('x')\nprint(1)") == ["click.echo", "print"]
    assert headings("figure.suptitle(name)") == ["suptitle"]
