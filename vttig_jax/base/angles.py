"""Angles in degrees, their signed differences, and amplitude and phase; imports NumPy only."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .units import DEG

Values = float | int | np.number | np.ndarray | Sequence[Any]
"""Input values: a number, a (nested) list of numbers or an array."""

Numbers = np.ndarray | np.float64
"""Result values: a float64 array of any shape, or a NumPy scalar for a plain number."""


def wrap_deg(angle_deg: Values) -> Numbers:
    """Wrap angles in degrees into [0, 360).

    **Example**
    ```python
    >>> from vttig_jax.base.angles import wrap_deg
    >>> wrap_deg([-90, 360, 765]).tolist()
    [270.0, 0.0, 45.0]

    ```
    """
    wrapped = np.mod(np.asarray(angle_deg, np.float64), 360.0)
    # `np.mod` rounds a tiny negative angle up to exactly 360.
    return np.where(wrapped == 360.0, 0.0, wrapped)[()]


def difference_deg(angle_deg: Values, other_deg: Values) -> Numbers:
    """Return the signed difference `angle_deg` − `other_deg` in degrees, in [−180, 180).

    **Example**
    ```python
    >>> from vttig_jax.base.angles import difference_deg
    >>> difference_deg(1.0, 359.0).item(), difference_deg(359.0, 1.0).item()
    (2.0, -2.0)

    ```
    """
    difference = np.asarray(angle_deg, np.float64) - np.asarray(other_deg, np.float64)
    return wrap_deg(difference + 180.0) - 180.0


def angles_over_turns_deg(step_deg: float, turns: float) -> np.ndarray:
    """Return the angles 0, `step_deg`, … below so many turns, in degrees.

    **Example**
    ```python
    >>> from vttig_jax.base.angles import angles_over_turns_deg
    >>> angles_over_turns_deg(90.0, 1.0).tolist()
    [0.0, 90.0, 180.0, 270.0]

    ```
    """
    return np.arange(math.ceil(turns * 360.0 / step_deg - 1e-9)) * step_deg


def amplitude_phase(cosine: Values, sine: Values) -> tuple[Numbers, Numbers]:
    """Convert the cosine and sine coefficients of an order to amplitude and phase.

        cosine · cos(kφ) + sine · sin(kφ) = a sin(kφ + p)

    **Returns** a ≥ 0 in the unit of the coefficients and p in degrees, in [0, 360); p is 0 where
    a is 0.

    **Example**
    ```python
    >>> from vttig_jax.base.angles import amplitude_phase
    >>> amplitude, phase_deg = amplitude_phase(3.0, 0.0)
    >>> amplitude.item(), phase_deg.item()
    (3.0, 90.0)

    ```
    """
    c, s = np.asarray(cosine, np.float64), np.asarray(sine, np.float64)
    amplitude = np.hypot(c, s)
    phase_deg = np.where(amplitude == 0.0, 0.0, np.arctan2(c, s) / DEG)
    return amplitude, wrap_deg(phase_deg)
