"""Rounded values with the derivative of the value before rounding."""

from typing import Any

import jax
from jaxtyping import Array, Float


@jax.custom_jvp
def straight_through(
    rounded: Float[Array, "*shape"], exact: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """Return `rounded`, bit for bit, with the derivatives of `exact` (the straight-through rule).

    The derivative of a rounded value is zero almost everywhere. In a sum over many roundings that
    hides how the sum depends on its inputs (Y. Bengio, N. Léonard and A. Courville,
    arXiv:1308.3432, 2013).

    **Example**
    ```python
    >>> import jax, jax.numpy as jnp
    >>> from vttig_jax.base.numerics.straight_through import straight_through
    >>> jax.value_and_grad(lambda x: straight_through(jnp.floor(x), x))(2.75)
    (Array(2., dtype=float64, weak_type=True), Array(1., dtype=float64, weak_type=True))

    ```
    """
    return rounded


@straight_through.defjvp
def _(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
    return primals[0], tangents[1]
