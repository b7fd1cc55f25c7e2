"""Comparisons of the closing controllers, which can be smoothed for derivatives.

A comparison such as "the deceleration exceeds the threshold" jumps from 0 to 1, so its derivative
is zero wherever it exists. Smoothed, it rises from 0 to 1 for x from −w to w:

    step(x) = p³ (10 − 15 p + 6 p²),   p = (x/w + 1)/2 clipped to 0 … 1

x is the compared quantity minus its threshold, divided by a scale such as the threshold, and w the
relative width. The step is exactly 0 for x ≤ −w, exactly 1 for x ≥ w and twice differentiable. A
logistic function is unsuitable: it is never exactly 0, and its small values would close the gap
when they add up over a thousand periods. For w → 0 the comparison becomes the original one.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import float64
from .controller import Controller


def exceeds(value: Any, threshold: Any, scale: Any, width: Any) -> Float[Array, ""]:
    """Return whether a value exceeds a threshold, as a number 0 … 1.

    `width` (w) is relative to `scale`; None for the original comparison, which is 0 or 1.
    """
    if width is None:
        return jnp.where(value > threshold, 1.0, 0.0)
    share = jnp.clip(0.5 * ((value - threshold) / (scale * width) + 1.0), 0.0, 1.0)
    return share**3 * (10 + share * (6 * share - 15))


def smoothed(controller: Controller, width: Float[Array, ""] | float) -> Controller:
    """Return a closing controller with smoothed comparisons of a relative width.

    **Raises** `ValueError` for a controller without the field `width`.
    """
    if not hasattr(controller, "width"):
        raise ValueError(
            "Argument `controller` must be the acceleration or the predictive controller, because"
            f" only these can be smoothed (`smooth_width`), but is a {type(controller).__name__}."
        )
    return replace(controller, width=float64(width))  # type: ignore[call-arg]
