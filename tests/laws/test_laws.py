"""Every row of the table keeps every law; every public function has a row."""

import importlib
import pkgutil

import pytest

from tests.laws import checks, table
from vttig_jax import kinematics
from vttig_jax.kinematics import flank_table, functions
from vttig_jax.kinematics.flank_model import FlankModel

SLOW = {True: pytest.mark.slow, False: ()}


@pytest.mark.parametrize(
    "law", [pytest.param(law, id=str(law), marks=SLOW[law.slow]) for law in table.LAWS]
)
def test_every_law_is_kept(law):
    checks.check_double(law.function, law.arguments)
    checks.check_jit_is_eager(law.function, law.arguments)
    checks.check_vmap_is_loop(law.function, law.arguments)
    checks.check_derivatives(law.function, law.arguments)
    checks.check_dimensions(law.function, law.arguments, table.POWER[law.unit], law.scale)
    for kink in law.kinks.values():
        checks.check_finite_gradient(law.function, kink)


@pytest.mark.parametrize("slow", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_new_values_compile_nothing(slow):
    for law in (*table.FUNCTIONS, *table.SURFACES, *table.THICKNESSES):
        if law.slow == slow:
            checks.check_one_trace(law.function, law.arguments)


def test_every_public_function_has_a_row():
    assert table.public_functions(functions) == {law.covers for law in table.FUNCTIONS}
    without_numbers = {"nodes_per_turn", "as_flank_model", "place_of", "gathered"}  # of a user
    covered = {law.covers for law in table.TABLES}
    assert table.public_functions(flank_table) - without_numbers == covered


def test_every_method_of_every_flank_model_has_a_row():
    for module in pkgutil.iter_modules(kinematics.__path__):
        importlib.import_module(f"{kinematics.__name__}.{module.name}")
    models = {
        kind
        for kind in _all_subclasses(FlankModel)
        if kind.__module__.startswith(f"{kinematics.__name__}.")
        and kind.__module__ != flank_table.__name__  # tests/kinematics/test_flank_table.py
        and not kind.__subclasses__()
    }
    assert models == set(table.MODEL_CLASSES)
    wanted = set().union(*(table.public_methods(kind) for kind in models))
    assert wanted == {law.covers for law in table.MODELS}


def _all_subclasses(kind: type) -> set[type]:
    direct = set(kind.__subclasses__())
    return direct.union(*(_all_subclasses(child) for child in direct))
