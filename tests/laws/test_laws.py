"""Every row of the table keeps every law; every public function has a row."""

import importlib
import pkgutil

import pytest

from tests.laws import checks, table
from vttig_jax import kinematics
from vttig_jax.kinematics import flank_table, functions
from vttig_jax.kinematics.flank_model import FlankModel

SLOW = {True: pytest.mark.slow, False: ()}

each_law = pytest.mark.parametrize(
    "law", [pytest.param(law, id=str(law), marks=SLOW[law.slow]) for law in table.LAWS]
)
each_kink = pytest.mark.parametrize(
    ("law", "kink"),
    [
        pytest.param(law, kink, id=f"{law}-{kink}", marks=SLOW[law.slow])
        for law in table.LAWS
        for kink in law.kinks
    ],
)


@each_law
def test_result_is_double(law):
    checks.check_double(law.function, law.arguments)


@each_law
def test_jit_is_eager(law):
    checks.check_jit_is_eager(law.function, law.arguments)


@each_law
def test_vmap_is_loop(law):
    checks.check_vmap_is_loop(law.function, law.arguments)


@each_law
def test_derivatives_agree(law):
    checks.check_derivatives(law.function, law.arguments)


@each_kink
def test_gradient_is_finite_at_the_kink(law, kink):
    checks.check_finite_gradient(law.function, law.kinks[kink])


@pytest.mark.parametrize("law", table.FUNCTIONS, ids=str)
def test_new_values_compile_nothing(law):
    checks.check_one_trace(law.function, law.arguments)


@each_law
def test_result_scales_by_its_unit(law):
    checks.check_dimensions(law.function, law.arguments, table.POWER[law.unit], law.scale)


def test_every_public_function_has_a_row():
    assert table.public_functions(functions) == {law.covers for law in table.FUNCTIONS}
    without_numbers = {"nodes_per_turn", "as_flank_model"}
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
