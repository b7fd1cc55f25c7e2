"""A tabulated recession: the natural cubic spline, smooth, straight outside, and never folded."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from vttig_jax.base.errors import PairError
from vttig_jax.geometry.tooth import Tabulated

DRAW = np.random.default_rng(3)
KNOTS = np.sort(DRAW.uniform(-10, 10, 9))
VALUES = 0.1 * DRAW.normal(size=9)
TABLE = Tabulated(KNOTS, VALUES)
DERIVATIVES = [jax.grad(TABLE), jax.grad(jax.grad(TABLE)), jax.grad(jax.grad(jax.grad(TABLE)))]
GRID = np.linspace(KNOTS[0], KNOTS[-1], 101)


def test_it_is_the_natural_spline():
    for compiled in (False, True):
        for count in (2, 3, 9):
            table = Tabulated(KNOTS[:count], VALUES[:count])
            grid = np.linspace(KNOTS[0], KNOTS[count - 1], 101)
            wanted = CubicSpline(KNOTS[:count], VALUES[:count], bc_type="natural")(grid)
            found = jax.jit(lambda t, z: t(z))(table, grid) if compiled else table(grid)
            assert isinstance(found, jax.Array if compiled else np.ndarray)
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)
            linear = np.interp(grid, KNOTS[:count], VALUES[:count])
            assert count == 2 or np.abs(linear - wanted).max() > 1e-3


def test_it_is_straight_outside():
    slope = jax.jit(jax.vmap(jax.grad(TABLE)))
    for end, way in ((KNOTS[0], -1.0), (KNOTS[-1], 1.0)):
        out = np.array([end, end + way, end + 3 * way])
        step = TABLE(out)
        assert step[2] - step[0] == pytest.approx(3 * (step[1] - step[0]), rel=1e-12)
        np.testing.assert_allclose(slope(jnp.asarray(out)), way * (step[1] - step[0]), rtol=1e-11)


def test_it_is_twice_differentiable_at_its_knots():
    first, second, third = (jax.jit(jax.vmap(nth)) for nth in DERIVATIVES)
    for derivative in (first, second):
        before, at, after = (derivative(jnp.asarray(KNOTS + e)) for e in (-1e-9, 0.0, 1e-9))
        np.testing.assert_allclose(before, after, rtol=0, atol=1e-6)
        np.testing.assert_allclose(at, after, rtol=0, atol=1e-6)
    jump = third(jnp.asarray(KNOTS[1:-1] + 1e-9)) - third(jnp.asarray(KNOTS[1:-1] - 1e-9))
    assert np.abs(jump).max() > 1e-2  # so that the comparison sees a jump where there is one


def test_it_is_linear_in_the_table():
    """The derivative in the values is a partition of unity; batches of tables are splines each."""
    slope = jax.jit(jax.jacfwd(lambda v: Tabulated(KNOTS, v)(jnp.asarray(GRID))))(VALUES)
    np.testing.assert_allclose(slope @ VALUES, TABLE(GRID), rtol=0, atol=1e-13)
    np.testing.assert_allclose(slope.sum(axis=1), 1.0, rtol=1e-12)
    both = jax.jit(jax.vmap(lambda v: Tabulated(KNOTS, v)(GRID)))(jnp.stack([VALUES, VALUES**2]))
    np.testing.assert_allclose(both[1], Tabulated(KNOTS, VALUES**2)(GRID), rtol=0, atol=1e-13)


def test_tables_that_are_none():
    for z, values in (
        ([0.0, 2.0, 1.0], [0.0] * 3),
        ([0.0, 1.0, 1.0], [0.0] * 3),
        ([0.0, np.nan, 1.0], [0.0] * 3),
        ([0.0, 1.0, 2.0], [0.0, 0.0, np.inf]),
        ([0.0], [0.0]),
    ):
        with pytest.raises(PairError) as caught:
            Tabulated(z, values)
        assert caught.value.where == "recession"


def test_a_table_of_unequal_columns(unchecked):
    with pytest.raises(PairError, match="give as many values as heights"):
        Tabulated([0.0, 1.0], [0.0, 1.0, 2.0])
