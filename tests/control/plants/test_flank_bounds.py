"""The harmonics of a flank model against the model itself and against formulas in plain Python."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vttig_jax.control.plants.flank_bounds import Bounds, bounds_of

from tests.oracles import flank_formulas
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.harmonic import OrderModel
from vttig_jax.pair.eccentricities import Eccentricities
from vttig_jax.rig.paper import paper_pair

CLOSING = np.array([7e-4, 6e-4])
ANGLES = jnp.asarray(np.random.default_rng(0).uniform(-140.0, 140.0, 256))
values = eqx.filter_jit(lambda bounds, angle: bounds.at(angle))


@eqx.filter_jit
def expected(model, angles):
    """TE of both flanks, then their slopes."""

    def one(flank):
        return lambda angle: model.transmission_error(angle, flank)

    slopes = [jax.vmap(jax.grad(one(flank)))(angles) for flank in ("A", "B")]
    return [one("A")(angles), one("B")(angles), *slopes]


def deviation(bounds: Bounds, model, angles=ANGLES) -> tuple[float, float]:
    """Largest difference in TE and in its slope from a flank model, rad and rad/rad."""
    both = zip(jax.tree.leaves(values(bounds, angles)), expected(model, angles), strict=True)
    found = [float(jnp.abs(one - other).max()) for one, other in both]
    return max(found[:2]), max(found[2:])


@pytest.fixture(scope="module")
def exact(paper_rig):
    return exact_model(paper_pair(), paper_rig)


LEFT = 5e-10
"""rad that the harmonics left out by default may add up to; orders of both shafts below three."""


def test_the_exact_relation_and_its_slope(exact):
    value, slope = deviation(bounds_of(exact, CLOSING), exact)
    assert 1e-12 < value < LEFT and slope < 3 * LEFT
    value, slope = deviation(bounds_of(exact, CLOSING, highest=(4, 4)), exact)
    assert value < 1e-11 and slope < 1e-11


def test_the_closed_form_and_its_slope(paper_rig):
    model = closed_model(paper_pair(), paper_rig)
    value, slope = deviation(bounds_of(model, CLOSING), model)
    assert value < 1e-15 and slope < 1e-15


def test_first_orders_alone_are_not_the_exact_relation(exact, paper_rig):
    closed = bounds_of(closed_model(paper_pair(), paper_rig), CLOSING)
    assert deviation(closed, exact)[0] > 1e-8
    assert deviation(bounds_of(exact, CLOSING, highest=(1, 1)), exact)[0] > 1e-12


@given(
    sizes=st.tuples(st.floats(0.0, 0.1), st.floats(0.0, 0.1)),
    phases=st.tuples(st.floats(0.0, 360.0), st.floats(0.0, 360.0)),
    gap=st.floats(0.0, 0.5),
)
def test_any_eccentricities(sizes, phases, gap):
    rig = Eccentricities(sizes[0], phases[0], sizes[1], phases[1], gap)
    model = exact_model(paper_pair(), rig)
    bounds = bounds_of(model, CLOSING)
    value, slope = deviation(bounds, model)
    highest = max(abs(first) + abs(second) for first, second in bounds.terms)
    assert value < LEFT and slope < 3 * (highest + 1) * LEFT


@pytest.mark.parametrize(("size", "highest"), [(0.0, 1), (0.02, 2), (0.1, 3)])
def test_larger_eccentricities_take_more_harmonics(size, highest):
    model = exact_model(paper_pair(), Eccentricities(size, 40.0, size, 80.0, 0.05))
    terms = bounds_of(model, CLOSING).terms
    assert max(abs(first) + abs(second) for first, second in terms) == highest


@pytest.mark.parametrize("form", ["exact", "closed"])
def test_formulas_in_plain_python(form, paper_rig):
    build = {"exact": exact_model, "closed": closed_model}[form]
    bounds = bounds_of(build(paper_pair(), paper_rig), CLOSING)
    oracle = getattr(flank_formulas, form)()
    shifted = getattr(flank_formulas, form)(
        dataclasses.replace(flank_formulas.PAPER, driving=(0.0226, math.radians(49.6)))
    )
    found = values(bounds, ANGLES)
    atol = {"exact": LEFT, "closed": 2e-13}[form]
    errors, slopes = (found.lower, found.upper), (found.lower_slope, found.upper_slope)
    for wall, other, error, slope in zip(oracle, shifted, errors, slopes, strict=True):
        expected = np.array([wall(float(angle)) for angle in ANGLES])
        np.testing.assert_allclose(error, expected[:, 0], rtol=0, atol=atol)
        np.testing.assert_allclose(slope, expected[:, 1], rtol=0, atol=2e-9)
        wrong = np.array([other(float(angle))[0] for angle in ANGLES])
        assert np.abs(error - wrong).max() > 1e-7


def test_harmonics_of_any_order():
    """An order model with a steep and a mixed order, beyond the default."""
    model = OrderModel(
        ratio=jnp.asarray(0.5625),
        terms=((1, 0), (0, 1), (0, 2), (7, 0), (1, -1)),
        offset=jnp.array([1e-4, 7e-4]),
        cosine=1e-5 * jnp.arange(1.0, 11.0).reshape(2, 5),
        sine=-2e-5 * jnp.arange(1.0, 11.0).reshape(2, 5),
    )
    value, slope = deviation(bounds_of(model, CLOSING, highest=(16, 4)), model)
    assert value < 1e-10 and slope < 1e-9
    assert deviation(bounds_of(model, CLOSING), model)[0] > 1e-5


def test_the_gap_is_the_backlash_and_closes(exact):
    bounds = bounds_of(exact, CLOSING)
    np.testing.assert_allclose(bounds.gap(ANGLES), exact.backlash(ANGLES), rtol=0, atol=LEFT)
    assert float(bounds.closing_sum) == pytest.approx(CLOSING.sum())


def test_centred_gears_have_constant_flanks():
    bounds = bounds_of(
        exact_model(paper_pair(), Eccentricities(constant_backlash_deg=0.04)), CLOSING
    )
    found = values(bounds, ANGLES)
    assert np.ptp(found.lower) < 1e-15 and np.abs(found.upper_slope).max() < 1e-15
    np.testing.assert_allclose(found.upper - found.lower, np.radians(0.04), atol=1e-15)


@pytest.mark.usefixtures("unchecked")
def test_another_model_is_refused():
    with pytest.raises(ValueError, match="closed or implicit flank model"):
        bounds_of(None, CLOSING)  # pyright: ignore[reportArgumentType]
