"""Tables of both flanks, and the closed form, against the flank models and formulas by hand."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.oracles import flank_formulas
from vttig_jax.base.units import DEG, REV
from vttig_jax.kinematics import (
    BacklashMap,
    Bounds,
    FlankTable,
    OrderModel,
    as_flank_model,
    closed_model,
    exact_model,
    tabulate_flanks,
)
from vttig_jax.kinematics.flank_table import nodes_per_turn
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig import paper_eccentricities, paper_pair, paper_rig

PAIR, RIG, TURNS = paper_pair(), paper_eccentricities(), 16
CLOSING = np.array([7e-4, 6e-4])
ANGLES = jnp.asarray(np.random.default_rng(0).uniform(-140.0, 140.0, 256))
values = eqx.filter_jit(lambda bounds, angle: bounds.at(angle))
_tabulated = eqx.filter_jit(tabulate_flanks)


def tabulated(model, turns=TURNS, per_turn=None, **options) -> FlankTable:
    """The table of a compiled program, with the nodes that `tabulate_flanks` takes by itself."""
    return _tabulated(model, turns, per_turn=per_turn or nodes_per_turn(model), **options)


@eqx.filter_jit
def expected(model, angles):
    """TE of both flanks, then their slopes."""

    def both(flank):
        ones = jnp.ones_like(angles)
        return jax.jvp(lambda at: model.transmission_error(at, flank), (angles,), (ones,))

    (lower, lower_slope), (upper, upper_slope) = both("A"), both("B")
    return [lower, upper, lower_slope, upper_slope]


def deviation(bounds: Bounds, model, angles=ANGLES) -> tuple[float, float]:
    """Largest difference in TE and in its slope from a flank model, rad and rad/rad."""
    both = zip(jax.tree.leaves(values(bounds, angles)), expected(model, angles), strict=True)
    found = [float(jnp.abs(one - other).max()) for one, other in both]
    return max(found[:2]), max(found[2:])


@pytest.fixture(scope="module")
def exact():
    return exact_model(PAIR, RIG)


@pytest.fixture(scope="module")
def table(exact) -> FlankTable:
    return tabulated(exact, closing=CLOSING)


def test_the_table_of_a_mesh_order_is_the_model():
    model = paper_rig().flank_model()
    assert model.highest_order == 45.0
    angles = jnp.asarray(np.random.default_rng(1).uniform(-1.0, TURNS + 1.0, 1000) * REV)
    assert deviation(tabulated(model), model, angles)[0] < 1e-9 * DEG
    # A sixth of the nodes and a mesh order of 10⁻⁴ rad: 6⁴ times the error.
    assert deviation(tabulated(model, per_turn=480), model, angles)[0] > 1e-9 * DEG


def test_the_relations_and_their_slopes(exact, table):
    value, slope = deviation(table, exact)
    assert value < 1e-13 and slope < 1e-11
    closed = closed_model(PAIR, RIG)
    value, slope = deviation(closed, exact)
    assert value > 1e-8 and slope > 1e-8


@given(
    sizes=st.tuples(st.floats(0.0, 0.1), st.floats(0.0, 0.1)),
    phases=st.tuples(st.floats(0.0, 360.0), st.floats(0.0, 360.0)),
    gap=st.floats(0.0, 0.5),
)
@example(sizes=(0.0, 0.0), phases=(0.0, 0.0), gap=0.04)
def test_any_eccentricities(sizes, phases, gap):
    model = exact_model(PAIR, Eccentricities(sizes[0], phases[0], sizes[1], phases[1], gap))
    value, slope = deviation(tabulated(model), model)
    assert value < 1e-12 and slope < 1e-10


@pytest.mark.parametrize("form", ["exact", "closed"])
def test_formulas_in_plain_python(form, exact, table):
    bounds = table if form == "exact" else closed_model(PAIR, RIG)
    other_rig = dataclasses.replace(flank_formulas.PAPER, driving=(0.0226, math.radians(49.6)))
    walls = getattr(flank_formulas, form)
    found = values(bounds, ANGLES)
    errors, slopes = (found.lower, found.upper), (found.lower_slope, found.upper_slope)
    for wall, other, error, slope in zip(walls(), walls(other_rig), errors, slopes, strict=True):
        known = np.array([wall(float(angle)) for angle in ANGLES])
        np.testing.assert_allclose(error, known[:, 0], rtol=0, atol=2e-13)
        np.testing.assert_allclose(slope, known[:, 1], rtol=0, atol=2e-9)
        wrong = np.array([other(float(angle))[0] for angle in ANGLES])
        assert np.abs(error - wrong).max() > 1e-7


def test_harmonics_of_any_order():
    """A steep order and one of both shafts; half of its nodes are too few."""
    model = OrderModel(
        ratio=jnp.asarray(0.5625),
        terms=((1, 0), (0, 1), (0, 2), (23, 0), (1, -1)),
        offset=jnp.array([1e-4, 7e-4]),
        cosine=1e-5 * jnp.arange(1.0, 11.0).reshape(2, 5),
        sine=-2e-5 * jnp.arange(1.0, 11.0).reshape(2, 5),
    )
    bound = 3e-7 * float(jnp.abs(model.sine).sum())
    assert deviation(tabulated(model), model)[0] < bound
    assert deviation(tabulated(model, per_turn=23 * 32), model)[0] > bound


def test_the_gap_is_the_backlash_and_closes(exact, table):
    gap = table.gap(ANGLES)
    np.testing.assert_allclose(gap, exact.backlash(ANGLES), rtol=0, atol=1e-13)
    assert float(table.closing_sum) == pytest.approx(CLOSING.sum())
    np.testing.assert_allclose(table.closed_at(gap) * CLOSING.sum(), gap, rtol=1e-14)
    assert np.isinf(tabulated(exact, 1, periodic=False).closed_at(gap)).all()


# A pure function.


def same(one, other, atol: float) -> None:
    """All numbers of two pytrees are the same."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for found, known in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(found, known, rtol=0, atol=atol)


# Where a table ends.


def test_a_periodic_table_repeats_after_the_hunting_period(exact, table):
    same(table.at(ANGLES + TURNS * REV), table.at(ANGLES), 1e-14)
    assert deviation(tabulated(exact, TURNS - 1), exact)[0] > 1e-6


def test_another_table_keeps_the_values_of_its_ends(exact):
    part = tabulated(exact, 2, periodic=False, first_turn=-3)
    inside = jnp.linspace(-3.0, -1.0, 101) * REV
    assert deviation(part, exact, inside)[0] < 1e-13
    for end, outside in ((-3.0, -3.5), (-1.0, 4.0)):
        found, known = part.at(jnp.asarray(outside * REV)), exact.transmission_error(end * REV, "A")
        np.testing.assert_allclose(found.lower, known, rtol=0, atol=1e-14)


def test_flanks_some_turns_later(table):
    for bounds in (table, closed_model(PAIR, RIG)):
        for turns in (-3, 1, 16):
            later = bounds.turned(turns)
            same(later.at(ANGLES), bounds.at(ANGLES + turns * REV), 2e-15 * abs(turns) + 1e-15)
            unmoved = np.allclose(later.gap(ANGLES), bounds.gap(ANGLES), atol=1e-6)
            assert unmoved == (turns == 16)


# What else may be a map.


def test_a_function_of_the_user():
    def function(angle, flank):
        return 1e-4 * jnp.sin(3 * angle) + (5e-4 if flank == "B" else 0.0)

    model = as_flank_model(function, PAIR.ratio)
    found = values(tabulated(model), ANGLES)
    np.testing.assert_allclose(found.lower, 1e-4 * np.sin(3 * ANGLES), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.upper_slope, 3e-4 * np.cos(3 * ANGLES), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.upper - found.lower, 5e-4, rtol=0, atol=1e-15)


def test_maps_and_models_are_taken_as_they_are(exact, table):
    ratio = PAIR.ratio
    assert as_flank_model(exact, ratio) is exact and as_flank_model(table, ratio) is table
    assert as_flank_model(BacklashMap(exact, None, PAIR), ratio) is exact
    with pytest.raises(ValueError, match="flank model, a backlash map, a fit or a function"):
        as_flank_model(3.0, ratio)


def test_a_traced_ratio_needs_a_number_of_nodes(exact):
    arrays = jax.tree.map(jnp.asarray, exact)
    with pytest.raises(ValueError, match="per_turn"):
        jax.eval_shape(lambda model: tabulate_flanks(model, 1), arrays)
    made = jax.eval_shape(lambda model: tabulate_flanks(model, 1, per_turn=64).nodes, arrays)
    assert made.shape == (65, 4)
