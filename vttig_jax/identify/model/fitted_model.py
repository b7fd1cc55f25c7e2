"""Flank model of a fit with a flank model of the user, and its placeholder in a run folder."""

from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Numbers
from ...base.errors import UsageError
from ...kinematics.flank_error import FlankError
from ...kinematics.flank_model import FlankModel, GridOrders, ImplicitModel
from ...kinematics.harmonic import OrderModel
from ...pair.gear_pair import Flank
from .given_model import GivenModel


class FittedModel(ImplicitModel):
    """Sum of a given flank model with its fitted parameters, and of the free orders and offsets.

    The given model is a function of the driving angle, and the orders are functions of both shaft
    angles.
    """

    ratio: Float[Numbers, ""]
    orders: OrderModel
    arrays: Any
    constants: Any = eqx.field(static=True)
    given_order: float = eqx.field(static=True)

    @property
    def name(self) -> str:
        """Name of the class of the given model."""
        return type(self.fitted).__name__

    @property
    def fitted(self) -> Any:
        """The model of the user with its fitted parameters."""
        return eqx.combine(self.arrays, self.constants)

    @property
    def grid_orders(self) -> GridOrders:
        """Orders of both parts."""
        return (self.given_order, 0), *self.orders.grid_orders

    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """Return TE of `flank`, rad, for given angles of both shafts."""
        flat = jnp.ravel(driving_angle)
        given = jnp.reshape(self.fitted.transmission_error(flat, flank), jnp.shape(driving_angle))
        return given + self.orders.at_both_angles(driving_angle, driven_angle, flank)


def fitted_model(given: GivenModel, orders: OrderModel) -> FittedModel:
    """Return the flank model of a fit from the given model at the solution and the free orders."""
    arrays, constants = eqx.partition(jax.tree.map(_array, given.fitted), eqx.is_array)
    return FittedModel(orders.ratio, orders, arrays, constants, given.highest_order)


def _array(leaf: Any) -> Any:
    return jnp.asarray(leaf) if hasattr(leaf, "dtype") else leaf


class StoredModel(FlankModel):
    """Placeholder for a given flank model, because a run folder does not store its code.

    Every use of it raises an error. `errors` are the sizes of the transmission error that the fit
    has stored.

    **Raises** `UsageError` with the name of the class and the cure.
    """

    ratio: Float[Numbers, ""]
    name: str = eqx.field(static=True)
    errors: tuple[tuple[Flank, FlankError], ...] = eqx.field(static=True, default=())

    @property
    def grid_orders(self) -> GridOrders:
        """Raise `UsageError`, because the model is not known."""
        self.refuse()

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """Raise `UsageError`, because the model is not known."""
        self.refuse()

    def refuse(self, where: str = "model") -> NoReturn:
        """Raise `UsageError` with the name of the model and the cure."""
        raise UsageError(
            f"this fit is of the flank model {self.name}, whose code a run folder does not hold;"
            " repeat the fit in Python with `vttig_jax.fit(…, model=…)` and use its result.",
            where=where,
        )
