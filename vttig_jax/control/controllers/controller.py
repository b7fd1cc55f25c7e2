"""Interface of a controller: (state, measurement) → (state, command)."""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Measurement(eqx.Module):
    """Inputs of a controller in one period.

    - `time`: s. - `driving`, `driven`: readings of both encoders, rad.
    - `speed`, `acceleration`: estimates for the driving shaft, rad/s and rad/s².
    - `reference`, `reference_speed`: angle and speed of the prescribed motion, which only the
      controller of the motor knows, rad and rad/s.
    """

    time: Float[Array, ""]
    driving: Float[Array, ""]
    driven: Float[Array, ""]
    speed: Float[Array, ""]
    acceleration: Float[Array, ""]
    reference: Float[Array, ""]
    reference_speed: Float[Array, ""]


class Command(eqx.Module):
    """Output of a controller in one period.

    - `shift`: axial displacement of gear 2 towards a closed gap, mm.
    - `advance`: lead of the driving shaft over its motion at the end of the period, rad.
    """

    shift: Float[Array, ""] | float
    advance: Float[Array, ""] | float = 0.0


class Controller(eqx.Module):
    """Base class of controllers, which command the axial displacement of gear 2 in every period.

    The displacement is in mm, positive towards a closed gap. A controller of your own is one class:

    ```python
    >>> import jax.numpy as jnp
    >>> from vttig_jax.control import Controller
    >>> class CloseWhileSlow(Controller):
    ...     shift_mm: float
    ...
    ...     def start(self):
    ...         return ()
    ...
    ...     def step(self, state, seen):
    ...         return state, jnp.where(abs(seen.speed) < 1.0, self.shift_mm, 0.0)

    ```

    A controller that also moves the motor sets `advances` and returns a `Command`:

    ```python
    >>> import jax.numpy as jnp
    >>> from vttig_jax.control import Command, Controller
    >>> class Ahead(Controller):
    ...     advances = True
    ...     closes = False
    ...
    ...     def start(self):
    ...         return ()
    ...
    ...     def step(self, state, seen):
    ...         back = seen.reference_speed < 0
    ...         return state, Command(shift=0.0, advance=jnp.where(back, -1e-3, 0.0))

    ```

    - `closes`: whether it ever shifts gear 2; without it, the outcome is never "missed".
    - `advances`: whether it moves the motor.
    """

    closes: ClassVar[bool] = True
    advances: ClassVar[bool] = False

    @abstractmethod
    def start(self) -> Any:
        """Return the state before the first period: any pytree of arrays."""

    @abstractmethod
    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""] | Command]:
        """Return the state after this period, and the displacement in mm or a `Command`."""

    def as_command(self, output: Any) -> Command:
        """Convert the second output of `step` to a `Command`.

        **Raises** `ValueError` for an `advance` other than 0 of a class that does not advance.
        """
        if not isinstance(output, Command):
            return Command(output)
        moves = not isinstance(output.advance, float) or output.advance != 0.0
        if moves and not self.advances:
            raise ValueError(
                f"Argument `controller` must set `advances = True` to move the motor, but"
                f" {type(self).__name__} does not."
            )
        return output


class NoController(Controller):
    """Controller that leaves the gap as it is."""

    closes: ClassVar[bool] = False

    def start(self) -> tuple[()]:
        """Return an empty state."""
        return ()

    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""]]:
        """Return a displacement of zero."""
        return state, jnp.zeros(())
