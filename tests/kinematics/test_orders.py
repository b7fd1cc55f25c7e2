"""Order-complete and combined models against sums written out."""

import jax.numpy as jnp
import numpy as np
import pytest

from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.harmonic import CombinedModel, OrderModel
from vttig_jax.pair.schema import FLANKS

ANGLES = np.linspace(-30.0, 200.0, 501)
TERMS = ((1, 0), (3, 0), (0, 1), (0, 5), (45, 0), (2, 1))
DRAW = np.random.default_rng(4)


def model(size=1e-4, terms=TERMS):
    return OrderModel(
        ratio=jnp.asarray(0.5625, float),
        terms=terms,
        offset=jnp.array([1e-3, -2e-3]),
        cosine=jnp.asarray(size * DRAW.normal(size=(2, len(terms)))),
        sine=jnp.asarray(size * DRAW.normal(size=(2, len(terms)))),
    )


def direct(orders, driving, driven, side):
    """The sum of the class docstring, one term at a time."""
    total = np.full(np.shape(driving), float(orders.offset[side]))
    for number, (first, second) in enumerate(orders.terms):
        phase = first * driving + second * driven
        total += orders.cosine[side, number] * np.cos(phase)
        total += orders.sine[side, number] * np.sin(phase)
    return total


@pytest.mark.parametrize(("side", "flank"), [*enumerate(FLANKS)])
def test_transmission_error_stands_at_the_driven_angle_the_gear_really_has(side, flank):
    orders, driven = model(), 0.5625 * ANGLES + 0.01
    found = orders.at_both_angles(jnp.asarray(ANGLES), jnp.asarray(driven), flank)
    np.testing.assert_allclose(found, direct(orders, ANGLES, driven, side), rtol=0, atol=1e-15)
    orders = model(1e-3)
    error = np.asarray(orders.transmission_error(ANGLES, flank))
    there = direct(orders, ANGLES, 0.5625 * ANGLES + error, side)
    np.testing.assert_allclose(error, there, rtol=0, atol=1e-15)
    naive = direct(orders, ANGLES, 0.5625 * ANGLES, side)
    assert np.abs(error - naive).max() > 1e-7


def test_no_terms_leave_the_offset():
    empty = model(terms=())
    for side, flank in enumerate(FLANKS):
        found = np.asarray(empty.transmission_error(ANGLES, flank))
        np.testing.assert_array_equal(found, np.full(501, float(empty.offset[side])))


def test_combined_is_exact_plus_orders_at_one_driven_angle(paper_pair, paper_rig):
    exact, orders = exact_model(paper_pair, paper_rig), model()
    both = CombinedModel(ratio=exact.ratio, exact=exact, orders=orders)
    for side, flank in enumerate(FLANKS):
        error = np.asarray(both.transmission_error(ANGLES, flank))
        driven = 0.5625 * ANGLES + error
        parts = np.asarray(exact.at_both_angles(jnp.asarray(ANGLES), jnp.asarray(driven), flank))
        parts = parts + direct(orders, ANGLES, driven, side)
        np.testing.assert_allclose(error, parts, rtol=0, atol=1e-15)


def test_highest_order_is_what_a_grid_must_resolve(paper_pair, paper_rig):
    exact, orders = exact_model(paper_pair, paper_rig), model()
    assert closed_model(paper_pair, paper_rig).highest_order == 1.0
    assert orders.highest_order == 45.0
    assert model(terms=((1, 0), (0, 8))).highest_order == 4.5
    assert CombinedModel(ratio=exact.ratio, exact=exact, orders=orders).highest_order == 45.0
