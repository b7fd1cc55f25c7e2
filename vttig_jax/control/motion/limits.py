"""Which numbers make a motion, and sentences for those that do not. Traced values pass unseen."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jax.core import Tracer

from ...base.units import DEG

_ROUNDING = 1e-12
"""Relative to the angle of the reversal: what the sum of the ramps may exceed it by."""

_RULES: dict[str, tuple[Callable[[float], bool], str]] = {
    "speed_rpm": (lambda value: value > 0, "be positive"),
    "reversal_deg": (lambda value: value != 0, "differ from zero"),
    "dwell_s": (lambda value: value >= 0, "not be negative"),
    "ramp_s": (lambda value: value > 0, "be positive: without a ramp the acceleration is infinite"),
    "slow_share": (lambda value: 0 < value < 1, "lie between 0 and 1, both excluded"),
    "stop_s": (lambda value: value > 0, "be positive: a sudden stop has infinite acceleration"),
}


def known(value: Any) -> bool:
    """Whether a number has its value already: it has none while JAX traces through it."""
    return not isinstance(value, Tracer)


def check_numbers(**values: Any) -> None:
    """Refuse what no motion can have, by name of the argument.

    **Raises** `ValueError` for an array, a number that is not finite or one outside its range.
    """
    for name, value in values.items():
        if not known(value):
            continue
        if np.ndim(value):
            raise ValueError(
                f"Argument `{name}` must be one number, but its shape is {np.shape(value)};"
                " use `jax.vmap` for a batch."
            )
        number = float(value)
        holds, words = _RULES[name]
        if not math.isfinite(number):
            raise ValueError(f"Argument `{name}` must be finite, but is {number:g}.")
        if not holds(number):
            raise ValueError(f"Argument `{name}` must {words}, but is {number:g}.")


def one_of(names: tuple[str, ...], **values: str) -> None:
    """Refuse a word that is not among `names`.

    **Raises** `ValueError` that lists them.
    """
    for name, value in values.items():
        if value not in names:
            quoted = [f'"{word}"' for word in names]
            raise ValueError(
                f"Argument `{name}` must be {', '.join(quoted[:-1])} or {quoted[-1]}, but is"
                f" {value!r}."
            )


def steady_time(reversal_deg: Any, distance: Any, least: Any, speed: Any, what: str) -> Any:
    """Time at steady speed, s: what `least` (all ramps, rad) leaves of `distance` (rad).

    **Raises** `ValueError` where it leaves less than nothing; `what` names the parts of `least`.
    """
    time = (distance - least) / speed
    if not known(time) or time >= 0:
        return time
    if distance < least * (1 - _ROUNDING):
        raise ValueError(
            f"Argument `reversal_deg` must be at least {float(least) / DEG:.10g}° ({what}) in"
            f" either sense, but is {float(reversal_deg):.10g}°; turn farther, slower or with"
            " shorter ramps."
        )
    return 0.0 * time
