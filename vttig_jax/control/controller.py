"""The interface of a controller: (state, measurement) → (state, command)."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Measurement(NamedTuple):
    """What a controller knows in one period.

    - `time`: s. - `driving`, `driven`: readings of both encoders, rad.
    - `speed`, `acceleration`: of the driving shaft as the observer sees them, rad/s and rad/s².
    """

    time: Float[Array, ""]
    driving: Float[Array, ""]
    driven: Float[Array, ""]
    speed: Float[Array, ""]
    acceleration: Float[Array, ""]


class Controller(eqx.Module):
    """Decides in every period how far gear 2 is to be shifted, in mm towards a closed gap.

    A controller of your own is one class:

    ```python
    >>> import jax.numpy as jnp
    >>> from vttig_jax.control.controller import Controller
    >>> class CloseWhileSlow(Controller):
    ...     shift_mm: float
    ...
    ...     def start(self):
    ...         return ()
    ...
    ...     def step(self, state, seen):
    ...         return state, jnp.where(abs(seen.speed) < 1.0, self.shift_mm, 0.0)

    ```
    """

    @abstractmethod
    def start(self) -> Any:
        """State before the first period: any pytree of arrays."""

    @abstractmethod
    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""]]:
        """State after this period, and the axial displacement commanded, mm."""


class NoController(Controller):
    """Leaves the gap as it is."""

    def start(self) -> tuple[()]:
        """No state."""
        return ()

    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""]]:
        """Zero."""
        return state, jnp.zeros(())
