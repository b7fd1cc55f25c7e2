"""Checks of the numbers of a motion, with their error messages.

Numbers that JAX traces have no value and are not checked.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jax.core import Tracer

from ...base.units import DEG

_ROUNDING = 1e-12
"""Relative excess of the ramp angles over the reversal angle that is ignored as rounding error.

A chosen value."""

_RULES: dict[str, tuple[Callable[[float], bool], str]] = {
    "speed_rpm": (lambda value: value > 0, "be positive"),
    "reversal_deg": (lambda value: value != 0, "differ from zero"),
    "dwell_s": (lambda value: value >= 0, "not be negative"),
    "ramp_s": (lambda value: value > 0, "be positive: without a ramp the acceleration is infinite"),
    "slow_share": (lambda value: 0 < value < 1, "lie between 0 and 1, both excluded"),
    "stop_s": (lambda value: value > 0, "be positive: a sudden stop has infinite acceleration"),
}


def is_concrete(value: Any) -> bool:
    """Return whether a number has a value; it has none while JAX traces it."""
    return not isinstance(value, Tracer)


def check_numbers(**values: Any) -> None:
    """Check the numbers of a motion by the rule for each argument's name.

    **Raises** `ValueError` for an array, a number that is not finite or one outside its range.
    """
    for name, value in values.items():
        if not is_concrete(value):
            continue
        if np.ndim(value):
            raise ValueError(
                f"Argument `{name}` must be one number, but its shape is {np.shape(value)};"
                " use `jax.vmap` for a batch."
            )
        number = float(value)
        holds, rule = _RULES[name]
        if not math.isfinite(number):
            raise ValueError(f"Argument `{name}` must be finite, but is {number:g}.")
        if not holds(number):
            raise ValueError(f"Argument `{name}` must {rule}, but is {number:g}.")


def check_choice(names: tuple[str, ...], **values: str) -> None:
    """Check that every value is one of `names`.

    **Raises** `ValueError` with a list of `names`.
    """
    for name, value in values.items():
        if value not in names:
            quoted = [f'"{word}"' for word in names]
            raise ValueError(
                f"Argument `{name}` must be {', '.join(quoted[:-1])} or {quoted[-1]}, but is"
                f" {value!r}."
            )


def steady_time(reversal_deg: Any, distance: Any, ramps: Any, speed: Any, parts: str) -> Any:
    """Return the time (s) at steady speed in a pass of the motion: (distance − ramps)/speed.

    `distance` is the angle of the pass, `ramps` that of all its ramps, rad; `speed` is in rad/s.

    **Raises** `ValueError` if `ramps` exceeds `distance`. The message quotes `reversal_deg`, and
    `parts`, a description of the ramps.
    """
    time = (distance - ramps) / speed
    if not is_concrete(time) or time >= 0:
        return time
    if distance < ramps * (1 - _ROUNDING):
        raise ValueError(
            f"Argument `reversal_deg` must be at least {float(ramps) / DEG:.10g}° ({parts}) in"
            f" either direction, but is {float(reversal_deg):.10g}°; increase it, reduce the speed"
            " or shorten the ramps."
        )
    return 0.0 * time
