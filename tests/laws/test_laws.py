"""Every row of the table keeps every law; every public function has a row."""

import pytest

from tests.laws import checks, table
from vttig_jax.kinematics import first_order, flank_table, functions

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
    offered = table.public_functions(flank_table) | table.public_functions(first_order)
    assert offered - without_numbers - {"flank_offsets"} == covered
