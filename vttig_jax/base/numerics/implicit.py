"""Derivatives of solutions and of extremes, from their equations and not from their search."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@eqx.filter_custom_jvp
def known_root(
    function: Callable[[Any, Any], Array], root: Float[Array, "*shape"], args: Any
) -> Float[Array, "*shape"]:
    """Return `root`, bit for bit, with the derivatives of the root of function(root, args) = 0.

    `function` works elementwise on the root. By the implicit function theorem

        droot = −(∂f/∂args · dargs) / (∂f/∂root),

    to any order and in both modes. Where ∂f/∂root is zero, no single root moves with `args`, and
    the derivative is zero. The search for the root is not differentiated; `root` is a constant.

    **Example**
    ```python
    >>> import jax, jax.numpy as jnp
    >>> from vttig_jax.base.numerics.implicit import known_root
    >>> square_root = lambda a: known_root(lambda x, a: x**2 - a, jnp.asarray(3.0), a)
    >>> float(jax.grad(square_root)(9.0)), float(jax.grad(jax.grad(square_root))(9.0))
    (0.16666666666666666, -0.009259259259259259)

    ```
    """
    return root


@known_root.def_jvp
def _(primals, tangents):
    function, root, args = primals
    root = known_root(function, jax.lax.stop_gradient(root), args)
    _, forced = eqx.filter_jvp(lambda some: function(root, some), (args,), (tangents[2],))
    _, slope = jax.jvp(lambda some: function(some, args), (root,), (jnp.ones_like(root),))
    still = slope == 0
    return root, jnp.where(still, 0.0, -forced / jnp.where(still, 1.0, slope))


@eqx.filter_custom_jvp
def at_extreme(
    function: Callable[[Any, Any], Array], moved: Callable[[Any, Any], Any], place: Any, args: Any
) -> Any:
    """Return function(place, args) at a place where its derivative by the place is zero.

    The derivative by `args` is that at the constant place (envelope theorem). Only derivatives of
    second and higher order need the motion of the place: moved(place, args) returns the same place
    with its derivatives, e.g. by `known_root`.

    **Example**
    ```python
    >>> import jax, jax.numpy as jnp
    >>> from vttig_jax.base.numerics.implicit import at_extreme, known_root
    >>> gap = lambda x, a: (x - a) ** 2 + a**2
    >>> moved = lambda x, a: known_root(lambda x, a: x - a, x, a)
    >>> smallest = lambda a: at_extreme(gap, moved, jnp.asarray(3.0), a)
    >>> float(jax.grad(smallest)(3.0)), float(jax.grad(jax.grad(smallest))(3.0))
    (6.0, 2.0)

    ```
    """
    return function(place, args)


@at_extreme.def_jvp
def _(primals, tangents):
    function, moved, place, args = primals
    place = jax.lax.stop_gradient(place)
    value = at_extreme(function, moved, place, args)
    here = moved(place, args)
    _, change = eqx.filter_jvp(lambda some: function(here, some), (args,), (tangents[3],))
    return value, change
