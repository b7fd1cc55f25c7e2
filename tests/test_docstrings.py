"""Every example in a docstring of the package runs and prints what stands below it."""

import ast
import doctest
import re
import textwrap
from pathlib import Path

import pytest

import vttig_jax

pytestmark = pytest.mark.usefixtures("unchecked_module")

PACKAGE = Path(vttig_jax.__file__).parent
_FENCE = re.compile(r"^( *)```python\n(.*?)^\1```", re.MULTILINE | re.DOTALL)


def examples(source: str) -> dict[str, str]:
    """Fenced examples of all docstrings in a module's source, by name of what they document."""
    found = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            name = getattr(node, "name", "module")
            text = ast.get_docstring(node) or ""
            for number, block in enumerate(_FENCE.finditer(text), 1):
                found[f"{name}-{number}"] = textwrap.dedent(block[2])
    return found


def run(name: str, text: str) -> str:
    """What a run of the example finds wrong: nothing, or doctest's report."""
    test = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    report: list[str] = []
    outcome = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(
        test, out=report.append
    )
    if outcome.attempted == 0:
        return "no example inside the fence"
    silent = [
        example.source for example in test.examples if not example.want and _prints(example.source)
    ]
    return "".join(report) + "".join(f"prints nothing to compare: {source}" for source in silent)


def _prints(source: str) -> bool:
    """Whether a line is an expression, so that a reader expects to see its value."""
    return isinstance(ast.parse(source).body[0], ast.Expr) and "enable_x64" not in source


SLOW = {"calibrate", "contact", "contact_report", "fit_many", "sampler", "sweep", "tune"}
"""Modules whose examples take over five seconds, mostly to compile; `-m slow` runs them."""

FOUND = [
    (path, name, text)
    for path in sorted(PACKAGE.rglob("*.py"))
    for name, text in examples(path.read_text(encoding="utf-8")).items()
]


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0]


@pytest.mark.parametrize(
    ("room", "slow"),
    [
        pytest.param(*kind, marks=pytest.mark.slow if kind[1] else ())
        for kind in sorted({(room_of(path), path.stem in SLOW) for path, *_ in FOUND})
    ],
)
def test_the_examples_of_a_room(room, slow, tmp_path, monkeypatch):
    problems = []
    for number, (path, name, text) in enumerate(FOUND):
        if (room_of(path), path.stem in SLOW) == (room, slow):
            (tmp_path / str(number)).mkdir()
            monkeypatch.chdir(tmp_path / str(number))
            problems.append(run(f"{path.name}:{name}", text))
    assert problems and "".join(problems) == ""


def test_public_kinematics_have_examples():
    named = {name for _, name, _ in FOUND}
    assert {"transmission_error-1", "exact_backlash-1", "GearPair-1", "BacklashMap-1"} <= named
    assert {path.stem for path, *_ in FOUND} >= SLOW


SOURCE = '''
def area(r):
    """Area.

    **Example**
    ```python
    >>> {line}
    {want}

    ```
    """
'''


def test_the_runner_sees_what_is_wrong():
    for line, want, words in (
        ("1 + 1", "2", ""),
        ("1 + 1", "3", "Expected:"),
        ("1 / 0", "0", "ZeroDivisionError"),
        ("1 + 1", "", "Got:"),
        ("None", "", "prints nothing to compare"),
    ):
        found = examples(SOURCE.format(line=line, want=want))
        assert list(found) == ["area-1"]
        problem = run("area", found["area-1"])
        assert words in problem and bool(words) == bool(problem)
