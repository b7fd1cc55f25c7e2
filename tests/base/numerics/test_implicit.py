"""Derivatives of roots and extremes that a search has found, against their closed forms."""

import jax
import jax.numpy as jnp
import numpy as np

from vttig_jax.base.numerics.implicit import at_extreme, known_root

VALUES = np.array([0.5, 2.0, 7.3])


def cube_root(value):
    """The root of x³ = value, found where JAX cannot see it."""
    found = jnp.asarray(np.cbrt(np.asarray(jax.lax.stop_gradient(value))))
    return known_root(lambda x, value: x**3 - value, found, value)


def test_a_root_keeps_its_bits_and_has_all_derivatives():
    first, second, third = (
        lambda x: x ** (-2 / 3) / 3,
        lambda x: -2 * x ** (-5 / 3) / 9,
        lambda x: 10 * x ** (-8 / 3) / 27,
    )
    for value in VALUES:
        assert cube_root(value) == np.cbrt(value)
        slope, bend = jax.grad(cube_root), jax.jacfwd(jax.grad(cube_root))
        np.testing.assert_allclose(slope(value), first(value), rtol=1e-13)
        np.testing.assert_allclose(bend(value), second(value), rtol=1e-13)
        np.testing.assert_allclose(jax.grad(bend)(value), third(value), rtol=1e-13)


def root_of_batch(values, known):
    return known_root(lambda x, values: x**3 - values, known, values)


def test_roots_of_a_batch_do_not_know_of_each_other():
    known = jnp.cbrt(VALUES)
    slopes = jax.jit(jax.jacrev(root_of_batch))(VALUES, known)
    np.testing.assert_allclose(slopes, np.diag(VALUES ** (-2 / 3) / 3), rtol=1e-13, atol=0)
    batch = jax.vmap(jax.grad(root_of_batch))(VALUES, known)
    np.testing.assert_allclose(batch, np.diag(slopes), rtol=1e-15)


def test_a_root_that_is_not_single_stands_still():
    slope = jax.grad(lambda a: known_root(lambda x, a: 0.0 * x * a, jnp.asarray(2.0), a))(3.0)
    assert slope == 0.0


def hill(place, args):
    """The highest value over the place is a² + b, at the place a²."""
    a, b = args
    return b + a**2 - 3.0 * (place - a**2) ** 2


def follow(place, args):
    return known_root(lambda x, args: -6.0 * (x - args[0] ** 2), place, args)


def highest(a, b, moved=follow):
    place = jax.lax.stop_gradient(jnp.asarray(a) ** 2)
    return at_extreme(hill, moved, place, (a, b))


def test_an_extreme_has_the_derivatives_of_its_value():
    assert highest(1.5, 0.25) == 2.5
    np.testing.assert_allclose(jax.grad(highest, (0, 1))(1.5, 0.25), (3.0, 1.0), rtol=1e-15)
    for hessian in (jax.hessian, lambda f, n: jax.jacrev(jax.jacrev(f, n), n)):
        found = jax.jit(hessian(highest, (0, 1)))(1.5, 0.25)
        np.testing.assert_allclose(np.asarray(found), [[2.0, 0.0], [0.0, 0.0]], atol=1e-14)


def test_a_place_that_stands_still_gives_first_derivatives_only():
    def still(a, b):
        return highest(a, b, lambda place, args: place)

    assert jax.grad(still)(1.5, 0.25) == 3.0
    assert jax.grad(jax.grad(still))(1.5, 0.25) < -50.0
