"""What imports what: nothing heavy at the start, and no floor of the house from a higher one."""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from runpy import run_path

import nbformat
import pytest

import vttig_jax

pytestmark = pytest.mark.smoke

PACKAGE = Path(vttig_jax.__file__).parent

VERBS = [path for path in PACKAGE.glob("cli/verbs/*.py") if path.stem != "__init__"]

FLOORS = {
    "base": (
        "facade results errors shown_text logger units angles arrays runtime threads numerics files"
    ),
    "pair": "",
    "kinematics": "",
    "geometry": (
        "tooth surface form checks mounting measures backlash deviations flanks contact "
        "contact_report outline mesh drawing patches sewing solid"
    ),
    "logs": (
        "source channel readers slope recognition encoder_log read motion lines checks preview "
        "inspection"
    ),
    "rig": "",
    "model": (
        "density outliers rows runs scope columns newton problem functionals mixed_fit gears "
        "lines parameter parameters"
    ),
    "identify": (
        "fit_settings records orders turn_averages accuracy starts readings given "
        "checking result findings archive identification many backlash"
    ),
    "posterior": (
        "until convergence checkpoint proposal target chains rig_draws summary sampler planning "
        "calibration"
    ),
    "control": (
        "fields hermite motion plants hardware controllers scenario compensation simulation "
        "sweeps tuning"
    ),
    "plotting": "",
    "runs": "",
    "report": "words content verdict charts comparison page",
    "cli": ("output program_cache options axis_options drive_options fit_options verbs main"),
}
"""Rooms from the ground up, each with the floors inside it: its sub-rooms and its own modules.

A module imports from its own floor and those below; the modules of "" have no order inside."""

FORBIDDEN_BELOW = {("control", "identify"), ("control", "posterior")}


def imported(statement: str) -> set[str]:
    """Top-level packages in `sys.modules` of a fresh interpreter after a statement."""
    code = f"import sys, json\n{statement}\n"
    code += "print(json.dumps([name.partition('.')[0] for name in sys.modules]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


HEAVY = {"jax", "numpy", "scipy", "matplotlib", "equinox", "click"}


def test_what_is_quick_imports_nothing_heavy():
    """The package, the help of the command, and what `inspect` needs."""
    assert imported("import vttig_jax; dir(vttig_jax)") & HEAVY == set()
    assert imported("import vttig_jax; vttig_jax.enable_x64") >= {"jax"}  # the check can fail
    code = "import contextlib, io\nfrom vttig_jax.cli.main import main\n"
    code += "with contextlib.redirect_stdout(io.StringIO()): main(['--help'])"
    assert imported(code) & HEAVY == {"click"}
    inspect = "import vttig_jax.cli.verbs.inspect, vttig_jax.logs.read, vttig_jax.pair.pair_file\n"
    inspect += "vttig_jax.pair.pair_file.parse_pair_spec({'drive': {'ratio': '1/2'}})"
    assert imported(inspect) & {"jax", "equinox"} == set()
    fit = "import vttig_jax.runs.fit_run, vttig_jax.identify.checking\n"
    assert "scipy" in imported(fit + "assert 'scipy.stats' not in sys.modules")  # 0.2 s


def test_no_verb_imports_jax_before_it_begins():
    """Compiled programs are kept only where JAX is imported after the command has begun."""
    verbs = ", ".join(f"vttig_jax.cli.verbs.{path.stem}" for path in VERBS)
    assert imported(f"import {verbs}") & {"jax", "equinox", "scipy"} == set()
    assert len(VERBS) > 20


def public_names(room: str) -> dict[str, str]:
    """Public name → relative module, as the stub of a room says it; the package is room ""."""
    tree = ast.parse((PACKAGE / room / "__init__.pyi").read_text("utf-8"))
    return {
        alias.name: "." * node.level + node.module
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.level and node.module
        for alias in node.names
        if alias.asname == alias.name  # an import without `as` is not exported by a stub
    }


@pytest.mark.parametrize("room", ["", *FLOORS][:-1])
def test_a_front_door_offers_the_names_of_its_stub(room):
    package, homes = import_module(f"vttig_jax.{room}".rstrip(".")), public_names(room)
    own = [] if room else ["__version__"]
    assert dir(package) == sorted(package.__all__) == sorted([*homes, *own])
    for name, home in homes.items():
        value = getattr(package, name)
        assert value is getattr(import_module(home, package.__name__), name)
        assert vars(package)[name] is value, name  # found directly from now on
        assert room or (callable(value) and value.__name__ == name)
    with pytest.raises(AttributeError, match="no attribute 'nonesuch'"):
        package.nonesuch  # noqa: B018
    assert {path.stem for path in (PACKAGE / room).iterdir()} & set(homes) == set()


def test_the_version_is_that_of_the_distribution():
    assert vttig_jax.__version__ == version("vttig-jax")


def texts() -> Iterator[tuple[Path, str]]:
    """README, guides and notebooks."""
    root = PACKAGE.parent
    for path in (root / "README.md", *(root / "docs").glob("*.md")):
        yield path, path.read_text("utf-8")
    for path in (root / "notebooks").glob("*.ipynb"):
        yield path, "".join(line for cell in nbformat.read(path, 4).cells for line in cell.source)


def deep_imports(text: str) -> list[str]:
    """Modules that a text imports from and that are neither the package nor a room."""
    found = re.findall(r"from (vttig_jax[\w.]*) import|import (vttig_jax[\w.]*)", text)
    return [name for pair in found for name in pair if name.count(".") > 1]


def test_what_a_user_reads_imports_from_front_doors_only():
    assert {str(path): deep_imports(text) for path, text in texts() if deep_imports(text)} == {}
    assert deep_imports("x\n>>> from vttig_jax.pair.gear_pair import load_pair") != []


def imports(source: str, module: str) -> Iterator[str]:
    """Absolute names of what a module (`vttig_jax.pair.schema`) imports, anywhere in its code."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[: -node.level] if node.level else []
            name = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{name}.{alias.name}" for alias in node.names)


def violations(source: str, module: str) -> list[str]:
    """Imports of a module that point upwards in the house or in its room, or to the front door."""
    floor, order, found = module.split(".")[1], list(FLOORS), []
    for name in imports(source, module):
        package, _, rest = name.partition(".")
        if package != "vttig_jax":
            continue
        target = rest.partition(".")[0]
        if target not in FLOORS:
            upwards = floor != "cli"  # the public names: they reach every floor
        elif target == floor:
            upwards = is_upwards_inside(module, name)
        else:
            upwards = order.index(target) > order.index(floor)
        if upwards or (floor, target) in FORBIDDEN_BELOW:
            found.append(name)
    return found


def is_upwards_inside(module: str, name: str) -> bool:
    """Does an import of a module of the same room point to a higher floor of it?"""
    room, own = module.split(".")[1:3]
    floors = FLOORS[room].split()
    target = name.split(".")[2]
    if not floors or own in (target, "__init__"):
        return False
    return target not in floors or floors.index(target) > floors.index(own)


def modules() -> dict[str, str]:
    """Dotted name of every module in a room → its source."""
    found = {}
    for path in sorted(PACKAGE.glob("*/**/*.py")):
        name = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        found[name] = path.read_text("utf-8")
    return found


def test_imports_point_downwards():
    found = {name: violations(source, name) for name, source in modules().items()}
    assert {name: upwards for name, upwards in found.items() if upwards} == {}
    assert {name.split(".")[1] for name in found} <= set(FLOORS)
    for room, floors in FLOORS.items():
        own = {name.split(".")[2] for name in found if name.split(".")[1] == room}
        assert not floors or own - {"__init__"} == set(floors.split()), room


def test_no_module_imports_itself_through_others():
    known, graph = modules(), TopologicalSorter()
    for module, source in known.items():
        names = set(imports(source, module))
        names |= {name.rpartition(".")[0] for name in names}
        graph.add(module, *(names & set(known) - {module}))
    graph.prepare()  # raises CycleError with the modules of a circle


def test_an_upward_import_is_seen_and_a_downward_one_is_not():
    for module, source in (
        ("vttig_jax.base.files.text_tables", "from ...pair.gear_pair import Gear"),
        ("vttig_jax.pair.gear_pair", "import vttig_jax.kinematics.first_order"),
        ("vttig_jax.logs.read", "def f():\n    from ..rig.synthetic import SyntheticRig"),
        ("vttig_jax.rig.synthetic", "from vttig_jax import fit"),
        ("vttig_jax.control.plants.plant", "from ...identify.identification import fit"),
        ("vttig_jax.control.motion.motion", "from ..plants.plant import Plant"),
        ("vttig_jax.identify.checking", "from . import archive"),
        ("vttig_jax.identify.checking", "from .nonesuch import fitting"),
    ):
        assert violations(source, module) != []
    for module, source in (
        ("vttig_jax.pair.gear_pair", "from ..base.units import DEG\nfrom .schema import PairSpec"),
        ("vttig_jax.cli.verbs.fit", "import vttig_jax\nimport numpy"),
        ("vttig_jax.base.files.text_tables", "from vttig_jax_extra import x\nimport tabulate"),
        ("vttig_jax.control.plants.plant", "from ..motion.motion import Motion"),
    ):
        assert violations(source, module) == []


def test_the_diagram_of_the_rooms_is_that_of_the_imports():
    script = run_path(str(PACKAGE.parent / "docs" / "draw_rooms.py"))
    text = script["DOCUMENT"].read_text("utf-8")
    without = text.replace("    pair --> base\n", "")
    assert without != text and script["drawn"](without) == script["drawn"](text) == text
    graph = {"a": {"b", "c"}, "b": {"c"}, "c": set()}
    assert script["reduced"](graph) == {"a": {"b"}, "b": {"c"}, "c": set()}
