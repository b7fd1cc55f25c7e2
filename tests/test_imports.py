"""What imports what: nothing heavy at the start, and no floor of the house from a higher one."""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import nbformat
import pytest

import vttig_jax

pytestmark = pytest.mark.smoke

PACKAGE = Path(vttig_jax.__file__).parent

VERBS = [path for path in PACKAGE.glob("cli/verbs/*.py") if path.stem != "__init__"]

FLOORS = (
    "base",
    "pair",
    "kinematics",
    "geometry",
    "logs",
    "rig",
    "model",
    "identify",
    "posterior",
    "control",
    "plotting",
    "runs",
    "report",
    "cli",
)
"""From the ground up; a module imports from its own floor and those below."""

INNER_FLOORS = {
    "base": (
        "facade",
        "results",
        "errors",
        "shown_text",
        "logger",
        "units",
        "angles",
        "arrays",
        "runtime",
        "threads",
        "numerics",
        "files",
    ),
    "geometry": (
        "tooth",
        "surface",
        "form",
        "checks",
        "mounting",
        "measures",
        "backlash",
        "deviations",
        "flanks",
        "contact",
        "contact_report",
        "outline",
        "mesh",
        "drawing",
        "patches",
        "sewing",
        "solid",
    ),
    "logs": (
        "source",
        "channel",
        "readers",
        "slope",
        "recognition",
        "encoder_log",
        "read",
        "motion",
        "lines",
        "checks",
        "preview",
        "inspection",
    ),
    "model": (
        "density",
        "outliers",
        "rows",
        "runs",
        "scope",
        "columns",
        "newton",
        "problem",
        "functionals",
        "mixed_fit",
        "gears",
        "starts",
        "components",
        "lines",
        "parameter",
        "parameters",
    ),
    "identify": (
        "fit_settings",
        "records",
        "orders",
        "accuracy",
        "starts",
        "readings",
        "given",
        "door",
        "coverage",
        "checking",
        "result",
        "findings",
        "archive",
        "identification",
        "many",
        "backlash",
    ),
    "posterior": (
        "until",
        "convergence",
        "checkpoint",
        "proposal",
        "target",
        "chains",
        "rig_draws",
        "summary",
        "sampler",
        "planning",
        "calibration",
    ),
    "control": (
        "fields",
        "hermite",
        "motion",
        "plants",
        "hardware",
        "controllers",
        "scenario",
        "compensation",
        "simulation",
        "sweeps",
        "tuning",
    ),
    "report": (
        "words",
        "content",
        "verdict",
        "charts",
        "comparison",
        "page",
    ),
    "cli": (
        "output",
        "library_messages",
        "program_cache",
        "completion",
        "options",
        "axis_options",
        "fit_options",
        "drive_options",
        "verbs",
        "main",
    ),
}
"""Floors inside a room, from the ground up: its sub-rooms and its own modules."""

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


def test_what_inspect_needs_imports_no_jax():
    for module in (
        "pair.pair_file",
        "logs.encoder_log",
        "logs.read",
        "cli.verbs.inspect",
    ):
        assert imported(f"import vttig_jax.{module}") & {"jax", "equinox"} == set()


def test_no_verb_imports_jax_before_it_begins():
    """Compiled programs are kept only where JAX is imported after the command has begun."""
    verbs = ", ".join(f"vttig_jax.cli.verbs.{path.stem}" for path in VERBS)
    assert imported(f"import {verbs}") & {"jax", "equinox", "scipy"} == set()
    assert len(VERBS) > 20


def public_names(package: str = "") -> dict[str, str]:
    """Public name → relative module, as the stub of the package or of a room says it."""
    tree = ast.parse((PACKAGE / package / "__init__.pyi").read_text("utf-8"))
    return {
        alias.name: "." * node.level + node.module
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.level and node.module
        for alias in node.names
        if alias.asname == alias.name  # an import without `as` is not exported by a stub
    }


def test_the_names_for_type_checkers_are_those_found_at_run_time():
    assert dir(vttig_jax) == sorted([*public_names(), "__version__"]) == sorted(vttig_jax.__all__)


def test_each_public_name_is_the_one_of_its_module():
    for name in public_names():
        value = getattr(vttig_jax, name)
        assert callable(value) and value.__name__ == name
        assert vars(vttig_jax)[name] is value, name  # found directly from now on


def test_a_room_has_a_front_door():
    for room in FLOORS[:-1]:
        package = import_module(f"vttig_jax.{room}")
        homes = public_names(room)
        assert dir(package) == sorted(package.__all__) == sorted(homes)
        for name, home in homes.items():
            assert getattr(package, name) is getattr(import_module(home, f"vttig_jax.{room}"), name)
        with pytest.raises(AttributeError, match="no attribute 'nonesuch'"):
            package.nonesuch  # noqa: B018
        modules_there = {path.stem for path in (PACKAGE / room).iterdir()}
        assert modules_there & set(homes) == set()


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


def test_a_deep_import_is_seen():
    assert deep_imports("x\n>>> from vttig_jax.pair.gear_pair import load_pair") != []
    assert deep_imports("from vttig_jax.pair import load_pair\nimport vttig_jax") == []


def test_the_version_is_that_of_the_distribution():
    from importlib.metadata import version

    assert vttig_jax.__version__ == version("vttig-jax")


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nonesuch'"):
        import_module("vttig_jax").nonesuch  # noqa: B018


def test_no_submodule_shadows_a_public_name():
    modules = {path.stem for path in PACKAGE.iterdir() if path.is_dir() or path.suffix == ".py"}
    assert modules & set(public_names()) == set()
    assert "base" in modules  # the listing sees submodules at all


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
    floor = module.split(".")[1]
    found = []
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
            upwards = FLOORS.index(target) > FLOORS.index(floor)
        if upwards or (floor, target) in FORBIDDEN_BELOW:
            found.append(name)
    return found


def is_upwards_inside(module: str, name: str) -> bool:
    """Does an import of a module of the same room point to a higher floor of it?"""
    room, own = module.split(".")[1:3]
    floors = INNER_FLOORS.get(room, ())
    target = name.split(".")[2]
    if not floors or own in (target, "__init__"):
        return False
    return target not in floors or floors.index(target) > floors.index(own)


def modules() -> dict[str, Path]:
    """Every module on a floor by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if len(parts) > 2:
            found[".".join(parts)] = path
    return found


def test_imports_point_downwards():
    found = {name: violations(path.read_text("utf-8"), name) for name, path in modules().items()}
    assert {name: upwards for name, upwards in found.items() if upwards} == {}


def test_every_folder_with_code_is_a_floor():
    assert {module.split(".")[1] for module in modules()} <= set(FLOORS)


def test_every_module_of_a_room_stands_on_an_inner_floor():
    for room, floors in INNER_FLOORS.items():
        own = {name.split(".")[2] for name in modules() if name.split(".")[1] == room}
        assert own - {"__init__"} == set(floors), room


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of nodes that reach one another."""
    groups = connected(graph)
    return [sorted(group) for group in groups if len(group) > 1]


def connected(graph: dict[str, set[str]]) -> list[set[str]]:
    """Strongly connected components, by closing the graph under reachability."""
    reached = {node: reachable(graph, node) for node in graph}
    groups: list[set[str]] = []
    for node in graph:
        if not any(node in group for group in groups):
            groups.append({node} | {other for other in reached[node] if node in reached[other]})
    return groups


def reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    """Nodes that can be reached in one step or more."""
    seen: set[str] = set()
    ahead = [*graph[start]]
    while ahead:
        node = ahead.pop()
        if node not in seen:
            seen.add(node)
            ahead += graph[node]
    return seen


def import_graph() -> dict[str, set[str]]:
    """Module → modules it imports at any depth of its code."""
    known = modules()
    graph: dict[str, set[str]] = {}
    for module, path in known.items():
        names = set(imports(path.read_text("utf-8"), module))
        names |= {name.rpartition(".")[0] for name in names}
        graph[module] = {name for name in names if name in known and name != module}
    return graph


def test_no_module_imports_itself_through_others():
    assert cycles(import_graph()) == []


def test_a_cycle_is_seen():
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


def test_the_floor_check_sees_an_upward_import():
    for module, source in (
        ("vttig_jax.base.files.text_tables", "from ...pair.gear_pair import Gear"),
        ("vttig_jax.base.files.text_tables", "from ... import pair"),
        ("vttig_jax.pair.gear_pair", "import vttig_jax.kinematics.first_order"),
        ("vttig_jax.kinematics.first_order", "from vttig_jax.cli import main"),
        ("vttig_jax.logs.read", "def f():\n    from ..rig.synthetic import SyntheticRig"),
        ("vttig_jax.rig.synthetic", "import vttig_jax"),
        ("vttig_jax.rig.synthetic", "from vttig_jax import fit"),
        ("vttig_jax.control.plants.plant", "from ...identify.identification import fit"),
        ("vttig_jax.control.plants.plant", "from ...posterior import summary"),
        ("vttig_jax.plotting.dispatch", "if True:\n    from ..cli.output import progress"),
        ("vttig_jax.control.motion.motion", "from ..plants.plant import Plant"),
        ("vttig_jax.identify.door", "from . import archive"),
        ("vttig_jax.identify.door", "from .nonesuch import fitting"),
    ):
        assert violations(source, module) != []


def test_the_floor_check_passes_a_downward_import():
    for module, source in (
        ("vttig_jax.pair.gear_pair", "from ..base.units import DEG\nfrom .schema import PairSpec"),
        ("vttig_jax.plotting.dispatch", "from ..posterior import summary"),
        ("vttig_jax.plotting.dispatch", "from ..control.sweeps.table import SweepTable"),
        ("vttig_jax.cli.verbs.fit", "import vttig_jax\nimport numpy"),
        ("vttig_jax.base.files.text_tables", "from vttig_jax_extra import x\nimport tabulate"),
        ("vttig_jax.control.plants.plant", "from ..motion.motion import Motion"),
    ):
        assert violations(source, module) == []


@pytest.fixture
def draw_rooms():
    """The script `docs/draw_rooms.py`."""
    place = PACKAGE.parent / "docs" / "draw_rooms.py"
    spec = spec_from_file_location("draw_rooms", place)
    assert spec is not None and spec.loader is not None
    script = module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def test_the_diagram_of_the_rooms_is_that_of_the_imports(draw_rooms):
    text = draw_rooms.DOCUMENT.read_text("utf-8")
    assert draw_rooms.drawn(text) == text
    without = text.replace("    pair --> base\n", "")
    assert without != text and draw_rooms.drawn(without) == text


def test_an_arrow_that_a_longer_road_replaces_is_left_out(draw_rooms):
    graph = {"a": {"b", "c"}, "b": {"c"}, "c": set()}
    assert draw_rooms.reduced(graph) == {"a": {"b"}, "b": {"c"}, "c": set()}
