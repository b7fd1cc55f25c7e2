"""Abstract flank models, explicit and implicit in the driven angle.

The transmission error of an implicit model is an elementwise fixed point. It is differentiated by
the implicit function theorem.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.arrays import Numbers
from ..base.numerics.implicit import known_root
from ..pair.schema import FLANKS, Flank

Angles = Float[Array, "*shape"]
"""Angles of any shape, rad."""

AnglesLike = Real[ArrayLike, "*shape"]
"""Angles of any shape as a user may give them, rad."""

GridOrders = Iterable[tuple[int | float, int | float]]
"""Orders (n₁, n₂) of phases n₁ φ₁ + n₂ φ₂."""

FIRST_ORDERS: GridOrders = ((1, 0), (0, 1))


class FlankModel(eqx.Module):
    """Transmission error of a gear pair on each flank as a function of the driving angle.

    The driven angle is φ₂ = i φ₁ + TE_A(φ₁) in contact on flank A and i φ₁ + TE_B(φ₁) on flank B.
    The difference is the backlash j = TE_B − TE_A. All angles are absolute and in rad.
    """

    ratio: eqx.AbstractVar[Float[Numbers, ""]]

    @property
    @abstractmethod
    def grid_orders(self) -> GridOrders:
        """Orders (n₁, n₂) of the phases n₁ φ₁ + n₂ φ₂ that a grid must resolve.

        They are known also where JAX traces the numbers of the model.
        """

    @property
    def highest_order(self) -> float:
        """Highest order that a grid must resolve, in cycles per driving turn."""
        return highest_order(self, float(self.ratio))

    @abstractmethod
    def transmission_error(self, driving_angle: AnglesLike, flank: Flank) -> Angles:
        """Return TE = φ₂ − i φ₁ (23) with `flank` in contact, rad of the driven gear."""

    def backlash(self, driving_angle: AnglesLike) -> Angles:
        """Return the backlash j = TE_B − TE_A (22), rad of the driven gear."""
        lower, upper = (self.transmission_error(driving_angle, flank) for flank in FLANKS)
        return upper - lower


def highest_order(model: FlankModel, ratio: float) -> float:
    """Return the highest of the grid orders |n₁ + i n₂| of a model, but at least 1.

    `ratio` is i, which is known from the tooth counts where that of the model is traced.
    """
    return max([abs(driving + ratio * driven) for driving, driven in model.grid_orders] + [1.0])


def flank_index(flank: Flank) -> int:
    """Return the index of `flank` in arrays with a flank axis: 0 for "A", 1 for "B"."""
    if flank not in FLANKS:
        raise ValueError(f'Argument `flank` must be "A" or "B", but is {flank!r}.')
    return FLANKS.index(flank)


_MOST_ITERATIONS = 60  # a chosen limit; about five are needed, see `fixed_point`


def fixed_point(step: Callable[[Any, Any], Any], args: Any) -> Float[Array, "..."]:
    """Solve t = step(t, args) elementwise by iteration from t = 0.

    `step` must be a contraction in t. For an eccentric gear the contraction factor is e₂/R₂ (about
    1e-3), so five iterations reach machine precision. The derivative is computed from the solution,

        dt = (∂step/∂args · dargs) / (1 − ∂step/∂t),

    and not from the iterations, so it is exact in forward and reverse mode to any order.
    """
    found = _iterated(step, jax.lax.stop_gradient(args))
    return known_root(lambda value, some: value - step(value, some), found, args)


@partial(jax.jit, static_argnums=0)
def _iterated(step: Callable[[Any, Any], Any], args: Any) -> Float[Array, "..."]:
    """Return the fixed point after iteration to machine precision; compiled once per `step`."""

    def unsettled(state):
        value, previous, iteration = state
        scale = jnp.maximum(jnp.abs(value), 1.0)
        moved = jnp.abs(value - previous) > 2 * jnp.finfo(value.dtype).eps * scale
        return (iteration < _MOST_ITERATIONS) & jnp.any(moved)

    def iterate(state):
        value, _, iteration = state
        return step(value, args), value, iteration + 1

    first = jax.eval_shape(step, 0.0, args)
    zero = jnp.zeros(first.shape, first.dtype)
    return jax.lax.while_loop(unsettled, iterate, (zero, zero + jnp.inf, 0))[0]


class ImplicitModel(FlankModel):
    """Flank model given by a relation TE = f(φ₁, φ₂) in contact, where φ₂ = i φ₁ + TE."""

    @abstractmethod
    def at_both_angles(self, driving_angle: Angles, driven_angle: Angles, flank: Flank) -> Angles:
        """Return TE of `flank`, rad, for given angles of both shafts."""

    def transmission_error(self, driving_angle: AnglesLike, flank: Flank) -> Angles:
        """Return TE of `flank`, rad: the solution of TE = f(φ₁, i φ₁ + TE)."""
        angle = jnp.asarray(driving_angle, float)
        return fixed_point(_STEPS[flank_index(flank)], (self, angle))


def _step(error, args, *, flank: Flank):
    model, angle = args
    return model.at_both_angles(angle, model.ratio * angle + error, flank)


_STEPS = [partial(_step, flank=flank) for flank in FLANKS]
