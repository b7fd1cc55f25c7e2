"""The rooms of the package do not grow: upper bounds on their code lines and on their constants.

`python -c "from tests.test_size import sizes; print(sizes())"` prints what the bounds become after
a change that made a room smaller.
"""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

import vttig_jax

pytestmark = pytest.mark.smoke

PACKAGE = Path(vttig_jax.__file__).parent

BOUNDS = {
    "vttig_jax": (16, 0),  # the files beside the rooms
    "base": (1150, 18),  # 950
    "pair": (621, 1),  # 560
    "kinematics": (1136, 23),  # 780
    "geometry": (3222, 53),  # 2800
    "logs": (9994, 274),  # 7400
    "rig": (280, 1),  # 260
    "model": (2019, 45),
    "identify": (3352, 39),  # 9000 together with posterior
    "posterior": (2549, 46),
    "control": (5246, 77),  # 3600
    "plotting": (1557, 44),  # 2000 together with the report
    "runs": (2377, 11),  # 900
    "cli": (3220, 15),  # 2600
    "report": (579, 5),
}
"""Room: (code lines, constants). Beside it stands its budget, the code lines that it may have in
the end; for all rooms together it is 31000."""

NO_CODE = {
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.COMMENT,
    tokenize.ENDMARKER,
}

ARITHMETIC = (
    ast.Tuple,
    ast.UnaryOp,
    ast.BinOp,
    ast.Name,
    ast.Attribute,
    ast.operator,
    ast.unaryop,
    ast.expr_context,
)


def code_lines(source: str) -> int:
    """Lines that hold code: no docstring, no line with a comment only and no blank line."""
    code, documentation = set(), set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and (
            ast.get_docstring(node) is not None
        ):
            text = node.body[0]
            documentation.update(range(text.lineno, (text.end_lineno or text.lineno) + 1))
    return len(code - documentation)


def constants(source: str) -> int:
    """Names in capitals to which a module assigns a number or a tuple of numbers.

    Arithmetic with named values counts too, as in `5 * DEG`.
    """
    found = 0
    for node in ast.parse(source).body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value and is_numeric(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                found += sum(bool(re.fullmatch("[A-Z0-9_]+", ast.unparse(one))) for one in names)
    return found


def is_numeric(value: ast.expr) -> bool:
    """Is the value arithmetic, or a tuple of it, with at least one number written out?"""
    leaves = [node for node in ast.walk(value) if not isinstance(node, ARITHMETIC)]
    numbers = [isinstance(one, ast.Constant) and type(one.value) in (int, float) for one in leaves]
    return bool(numbers) and all(numbers)


def sizes() -> dict[str, tuple[int, int]]:
    """Code lines and constants of every room; the files beside the rooms are under `vttig_jax`."""
    found: dict[str, tuple[int, int]] = {}
    for path in PACKAGE.rglob("*.py"):
        source = path.read_text("utf-8")
        room = PACKAGE.name if path.parent == PACKAGE else path.relative_to(PACKAGE).parts[0]
        lines, numbers = found.get(room, (0, 0))
        found[room] = (lines + code_lines(source), numbers + constants(source))
    return found


def grown(now: dict[str, tuple[int, int]], bounds: dict[str, tuple[int, int]]) -> list[str]:
    """One sentence for each bound that a room exceeds; a room without bounds may hold nothing."""
    return [
        f"The room `{room}` has {size} {what}, {size - bound} more than its bound of {bound}: make"
        " it smaller, or raise the bound in tests/test_size.py and say why in the commit message."
        for room in now
        for what, size, bound in zip(
            ("code lines", "constants"), now[room], bounds.get(room, (0, 0)), strict=True
        )
        if size > bound
    ]


def test_no_room_grows():
    found = grown(sizes(), BOUNDS)
    assert not found, "\n".join(found)


SOURCE = '''"""A module.

Its documentation has three lines.
"""

# a comment
WIDTH, _DEPTH = 2**24, -3 << 30  # a comment beside code
ANGLE: float = 5 * DEG
LEVELS = (0.5, 0.95)
NAMES, FLAG, OTHER, small = ("a", "b"), True, WIDTH, 3


class A:
    """A class."""

    INNER = """first

third"""
'''


def test_what_is_counted_and_what_has_grown_is_named():
    assert (code_lines(SOURCE), constants(SOURCE)) == (8, 4)
    assert code_lines("def f():\n    x = 1\n    '''no docstring'''\n") == 3
    bounds = {"base": (1268, 19), "rig": (326, 1)}
    assert grown(bounds, bounds) == []
    for more in ((327, 1), (326, 2)):
        assert len(grown(bounds | {"rig": more}, bounds)) == 1
        assert len(grown({"new": more}, {})) == 2
