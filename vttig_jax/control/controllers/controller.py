"""Interface of a controller: (state, measurement) → (state, command)."""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number
from ...kinematics.flank_table import Bounds
from ..fields import Part
from .retreat import Retreat


class Measurement(eqx.Module):
    """Inputs of a controller in one period.

    - `time`: time of the readings, s. - `driving`, `driven`: encoder readings of both shafts, rad.
    - `speed`, `acceleration`: estimates for the driving shaft, rad/s and rad/s².
    - `reference`, `reference_speed`: angle (rad) and speed (rad/s) of the prescribed motion of the
      driving shaft. Only a controller that is part of the motor control can use them.
    - `map`: flanks that the controller believes: `map.gap(angle)` is the backlash (rad) at a
      driving angle (rad), and `map.closed_at(gap)` the displacement (mm) that closes it.
    - `delay`: time from a reading to the resulting position of the actuator, s.
    - `retreat`: how the actuator follows teeth that pass; None for a map without such short waves.
    """

    time: Float[Array, ""]
    driving: Float[Array, ""]
    driven: Float[Array, ""]
    speed: Float[Array, ""]
    acceleration: Float[Array, ""]
    reference: Float[Array, ""]
    reference_speed: Float[Array, ""]
    map: Bounds
    delay: Float[Number, ""]
    retreat: Retreat | None = None


class Command(eqx.Module):
    """Output of a controller in one period.

    - `shift`: axial displacement of gear 2 towards a closed gap, mm.
    - `advance`: angle by which the driving shaft leads its prescribed motion at the end of the
      period, rad.
    """

    shift: Float[Array, ""] | float
    advance: Float[Array, ""] | float = 0.0


class Controller(Part):
    """Base class of controllers, which command the axial displacement of gear 2 in every period.

    The displacement is in mm, positive towards a closed gap. The argument `seen` of `step` is a
    `Measurement`: readings in rad, speeds in rad/s. To write a controller, derive a class:

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

    A controller that also moves the motor sets `advances = True` and returns a `Command`. Its
    `advance`, rad, is added to the prescribed angle of the driving shaft:

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

    - `closes`: whether the controller ever shifts gear 2. If false, the outcome of a run is never
      "missed".
    - `advances`: whether the controller moves the motor.
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

        **Raises** `ValueError` if `advance` is not 0 although the class attribute `advances` is
        false.
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
