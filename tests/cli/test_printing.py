"""One module writes text for people; no other module of the package prints."""

import ast
from pathlib import Path

import pytest

import vttig_jax

pytestmark = pytest.mark.smoke

PACKAGE = Path(vttig_jax.__file__).parent

FORBIDDEN = {
    *("print", "input", "click.echo", "click.secho", "click.echo_via_pager", "tqdm"),
    *("sys.stdout.write", "sys.stderr.write", "sys.__stdout__.write", "sys.__stderr__.write"),
    *("os.write", "warnings.warn", "logging.StreamHandler", "logging.FileHandler"),
    *("logging.basicConfig", "traceback.print_exc", "pyplot.title"),
}
"""Calls that would write past `cli/output.py`."""


def calls(source: str) -> list[str]:
    """What a module calls that prints, or that sets a heading.

    Headings of pictures hold foreign names, so that only `plotting/style.py` sets them.
    """
    names = [ast.unparse(n.func) for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
    return [name for name in names if name in FORBIDDEN or name.endswith(".suptitle")]


def test_no_other_module_prints():
    found = {
        path.relative_to(PACKAGE).as_posix(): called
        for path in PACKAGE.rglob("*.py")
        if (called := calls(path.read_text("utf-8")))
    }
    assert set(found) == {"cli/output.py", "plotting/style.py"}
    assert all(name.endswith(".suptitle") for name in found["plotting/style.py"])


def test_the_check_sees_what_prints():
    assert calls("import click\nclick.echo('x')\nprint(1)") == ["click.echo", "print"]
    assert calls("figure.suptitle(name)") == ["figure.suptitle"]
