"""The interface of a controller: (state, measurement) → (state, command)."""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Measurement(NamedTuple):
    """What a controller knows in one period.

    - `time`: s. - `driving`, `driven`: readings of both encoders, rad.
    - `speed`, `acceleration`: of the driving shaft as the observer sees them, rad/s and rad/s².
    - `reference`, `reference_speed`: where its motion has it, as only the controller of the motor
      knows, rad and rad/s.
    """

    time: Float[Array, ""]
    driving: Float[Array, ""]
    driven: Float[Array, ""]
    speed: Float[Array, ""]
    acceleration: Float[Array, ""]
    reference: Float[Array, ""]
    reference_speed: Float[Array, ""]


class Command(NamedTuple):
    """What a controller asks for.

    - `shift`: axial displacement of gear 2 towards a closed gap, mm.
    - `advance`: angle by which the driving shaft is to run ahead of its motion, reached at the end
      of the period, rad.
    """

    shift: Float[Array, ""] | float
    advance: Float[Array, ""] | float = 0.0


class Controller(eqx.Module):
    """Decides in every period how far gear 2 is to be shifted, in mm towards a closed gap.

    A controller of your own is one class:

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

    One that moves the motor too says so and returns a `Command`:

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

    - `closes`: whether it ever shifts gear 2; one that never does cannot miss a turn.
    - `advances`: whether it moves the motor.
    """

    closes: ClassVar[bool] = True
    advances: ClassVar[bool] = False

    @abstractmethod
    def start(self) -> Any:
        """State before the first period: any pytree of arrays."""

    @abstractmethod
    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""] | Command]:
        """State after this period, and what is commanded: mm, or a `Command`."""

    def ordered(self, found: Any) -> Command:
        """What `step` commanded, as a `Command`.

        **Raises** `ValueError` for an `advance` that the class does not announce.
        """
        if not isinstance(found, Command):
            return Command(found)
        moves = not isinstance(found.advance, float) or found.advance != 0.0
        if moves and not self.advances:
            raise ValueError(
                f"Argument `controller` must set `advances = True` to move the motor, but"
                f" {type(self).__name__} does not."
            )
        return found


class NoController(Controller):
    """Leaves the gap as it is."""

    closes: ClassVar[bool] = False

    def start(self) -> tuple[()]:
        """No state."""
        return ()

    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""]]:
        """Zero."""
        return state, jnp.zeros(())
