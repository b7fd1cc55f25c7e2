"""What imports what: nothing heavy at the start, and no floor of the house from a higher one."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import vttig_jax

PACKAGE = Path(vttig_jax.__file__).parent

FLOORS = (
    "base",
    "pair",
    "kinematics",
    "geometry",
    "logs",
    "rig",
    "identify",
    "posterior",
    "control",
    "report",
    "cli",
)
"""From the ground up; a module imports from its own floor and those below."""

FORBIDDEN_BELOW = {("control", "identify"), ("control", "posterior")}


def imported(statement: str) -> set[str]:
    """Top-level packages in `sys.modules` of a fresh interpreter after a statement."""
    code = f"import sys, json\n{statement}\n"
    code += "print(json.dumps([name.partition('.')[0] for name in sys.modules]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


HEAVY = {"jax", "numpy", "scipy", "matplotlib", "equinox", "click"}


def test_importing_the_package_imports_nothing_heavy():
    assert imported("import vttig_jax; dir(vttig_jax)") & HEAVY == set()
    assert imported("import vttig_jax; vttig_jax.enable_x64") >= {"jax"}  # the check can fail


def test_the_command_starts_without_numpy_and_jax():
    code = "import contextlib, io\nfrom vttig_jax.cli.main import main\n"
    code += "with contextlib.redirect_stdout(io.StringIO()): main(['--help'])"
    assert imported(code) & HEAVY == {"click"}


@pytest.mark.parametrize(
    "module", ["pair.spec", "logs.encoder_log", "logs.read", "cli.inspect_verb"]
)
def test_what_inspect_needs_imports_no_jax(module):
    assert imported(f"import vttig_jax.{module}") & {"jax", "equinox"} == set()


def public_names() -> dict[str, str]:
    """Public name → module, as the TYPE_CHECKING block of the package says it."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text("utf-8"))
    return {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module
        for alias in node.names
    }


def test_the_names_for_type_checkers_are_those_found_at_run_time():
    assert public_names() == vttig_jax._HOMES
    assert dir(vttig_jax) == sorted([*public_names(), "__version__"])


@pytest.mark.parametrize("name", public_names())
def test_each_public_name_is_the_one_of_its_module(name):
    value = getattr(vttig_jax, name)
    assert callable(value)
    assert value.__name__ == name
    assert vars(vttig_jax)[name] is value  # found directly from now on


def test_the_version_is_that_of_the_distribution():
    from importlib.metadata import version

    assert vttig_jax.__version__ == version("vttig-jax")


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nonesuch'"):
        vttig_jax.nonesuch  # noqa: B018


def test_no_submodule_shadows_a_public_name():
    modules = {path.stem for path in PACKAGE.iterdir() if path.is_dir() or path.suffix == ".py"}
    assert modules & set(public_names()) == set()
    assert "base" in modules  # the listing sees submodules at all


def imports(source: str, module: str) -> Iterator[str]:
    """Absolute names of what a module (`vttig_jax.pair.spec`) imports, at any depth of its code."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[: -node.level] if node.level else []
            name = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{name}.{alias.name}" for alias in node.names)


def violations(source: str, module: str) -> list[str]:
    """Imports of a module that point upwards in the house, or to its front door."""
    floor = module.split(".")[1]
    found = []
    for name in imports(source, module):
        package, _, rest = name.partition(".")
        if package != "vttig_jax":
            continue
        target = rest.partition(".")[0]
        if target not in FLOORS:
            upwards = floor != "cli"  # the public names: they reach every floor
        else:
            upwards = FLOORS.index(target) > FLOORS.index(floor)
        if upwards or (floor, target) in FORBIDDEN_BELOW:
            found.append(name)
    return found


def modules() -> dict[str, Path]:
    """Every module on a floor by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if len(parts) > 2:
            found[".".join(parts)] = path
    return found


@pytest.mark.parametrize("module", modules())
def test_imports_point_downwards(module):
    assert violations(modules()[module].read_text("utf-8"), module) == []


def test_every_folder_with_code_is_a_floor():
    assert {module.split(".")[1] for module in modules()} <= set(FLOORS)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("vttig_jax.base.tables", "from ..pair.gears import Gear"),
        ("vttig_jax.base.tables", "from .. import pair"),
        ("vttig_jax.pair.gears", "import vttig_jax.kinematics.closed"),
        ("vttig_jax.kinematics.closed", "from vttig_jax.cli import main"),
        ("vttig_jax.logs.read", "def f():\n    from ..rig.synthetic import SyntheticRig"),
        ("vttig_jax.rig.synthetic", "import vttig_jax"),
        ("vttig_jax.rig.synthetic", "from vttig_jax import fit"),
        ("vttig_jax.control.plants", "from ..identify.fit import fit"),
        ("vttig_jax.control.plants", "from ..posterior import maps"),
        ("vttig_jax.report.plot", "if True:\n    from ..cli.output import progress"),
    ],
)
def test_the_floor_check_sees_an_upward_import(module, source):
    assert violations(source, module) != []


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "vttig_jax.pair.gears",
            "from ..base.tables import key_values\nfrom .spec import PairSpec",
        ),
        ("vttig_jax.report.plot", "from ..posterior import maps\nfrom ..control import sweep"),
        ("vttig_jax.cli.fit_verb", "import vttig_jax\nimport numpy"),
        ("vttig_jax.base.tables", "from vttig_jax_extra import x\nimport tabulate"),
    ],
)
def test_the_floor_check_passes_a_downward_import(module, source):
    assert violations(source, module) == []
