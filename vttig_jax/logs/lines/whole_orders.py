"""Whole orders of a shaft that a log shows: what repeats in every turn, in all of its turns.

A window of two turns (Hann) gives the complex amplitude c of every order, without leakage from
other whole orders. The windows are one turn apart and start at one angle of the shaft, so that an
order has the same phase in all of them, and everything else has not. With the mean m of S windows
and the scatter s of a window about it,

    P = (1 + |m|²/s²)^(1 − S)

is the probability that noise alone has a mean of this size.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from ...base.units import REV

Run = tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]
"""Shaft angle and transmission error of a stretch in one direction, rad."""

_POINTS_PER_CYCLE = 4  # points of a window per cycle of the highest order; chosen value
_LEAST_WINDOWS = 4  # fewest windows of two turns in which an order is searched; chosen value
_CHUNK = 1024  # windows that are transformed at once

_OVERLAP = 1 / 6
"""Correlation of white noise in two Hann windows that overlap by half."""

_STEADY = 0.9
"""Least ratio of |m| to the mean at the best neighbouring frequency. A line beside an order turns
its phase from window to window, so that its mean is smaller than that; chosen value."""


@dataclass(frozen=True)
class WholeOrder:
    """Order of a shaft: its amplitude in rad, and the probability that noise alone shows it."""

    order: int
    amplitude: float
    false_alarm: float


def whole_orders(runs: Sequence[Run], orders: range) -> list[WholeOrder]:
    """Return all `orders` with the probability that they are noise, in ascending order.

    The list is empty if the runs have fewer than four windows of two turns. An order beside which a
    line explains the windows better is left out.

    **Arguments**
    - `runs`: stretches of one flank of one log, whose angles have one zero.
    - `orders`: cycles per turn of this shaft, ascending.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.lines.whole_orders import whole_orders
    >>> angle = np.linspace(0.0, 2 * np.pi * 12.5, 2000)
    >>> noise = np.random.default_rng(0).normal(0.0, 1e-5, 2000)
    >>> run = angle, 1e-3 * np.sin(angle) + 1e-4 * np.sin(12 * angle) + noise
    >>> [one.order for one in whole_orders([run], range(9, 17)) if one.false_alarm < 1e-6]
    [12]

    ```
    """
    if not len(orders):
        return []
    found = [part for run in runs if len(part := _windows(run, orders))]
    if sum(map(len, found)) < _LEAST_WINDOWS:
        return []
    values = np.concatenate(found)
    mean = values.mean(axis=0)
    left = [part - mean for part in found]
    variance = np.sum(np.abs(values - mean) ** 2, axis=0) / (len(values) - 1)
    freedom = np.maximum(len(values) * _independent(left, variance) - 1, 1.0)
    size = np.abs(mean)
    height = size**2 / np.maximum(variance, 1e-300)
    false_alarm = np.exp(-np.minimum(freedom * np.log1p(height), 700.0))
    best = np.sum([len(part) * _best_mean(part) for part in found], axis=0) / len(values)
    return [
        WholeOrder(order, float(size[k]), float(false_alarm[k]))
        for k, order in enumerate(orders)
        if size[k] >= _STEADY * best[k]
    ]


def _windows(run: Run, orders: range) -> Complex[np.ndarray, "windows orders"]:
    """Return the complex amplitudes of the orders in windows of two turns, one turn apart."""
    points = _POINTS_PER_CYCLE * orders[-1]
    angle, value = run
    if len(angle) > 1 and angle[-1] < angle[0]:
        angle, value = angle[::-1], value[::-1]
    turns = np.maximum.accumulate(angle) / REV
    ahead = np.diff(turns, prepend=-np.inf) > 0
    turns, value = turns[ahead], value[ahead]
    first = np.ceil(turns[0] * points) if len(turns) else 0.0
    count = int((turns[-1] - first / points) // 1) - 1 if len(turns) > 2 else 0
    if count < 1:
        return np.zeros((0, len(orders)), complex)
    places = first + np.arange((count + 1) * points)
    even = _interpolated(places / points, turns, value)
    windows = np.lib.stride_tricks.sliding_window_view(even, 2 * points)[::points]
    hann = 0.5 - 0.5 * np.cos(np.pi * np.arange(2 * points) / points)
    slow = np.linalg.qr(np.linspace(-1.0, 1.0, 2 * points)[:, None] ** np.arange(3))[0]
    bins = 2 * np.asarray(orders)
    parts = []
    for start in range(0, count, _CHUNK):
        part = windows[start : start + _CHUNK]
        part = part - (part @ slow) @ slow.T
        parts.append(np.fft.rfft(part * hann, axis=1)[:, bins])
    phase = np.exp(-1j * np.asarray(orders) * (REV * (first / points % 1.0)))
    return np.concatenate(parts) * (phase * 2 / hann.sum())


def _interpolated(
    places: Float[np.ndarray, " m"], turns: Float[np.ndarray, " n"], value: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " m"]:
    """Return the values at `places`, by a cubic between neighbours with the slopes of chords.

    Straight lines between the rows would repeat a large low order at the distance of the
    rows, where it looks like a high order. A chord over two steps keeps its slope small where two
    rows are close.
    """
    slope = np.empty_like(value)
    slope[1:-1] = (value[2:] - value[:-2]) / (turns[2:] - turns[:-2])
    slope[[0, -1]] = slope[[1, -2]]
    left = np.clip(np.searchsorted(turns, places, "right") - 1, 0, len(turns) - 2)
    step = turns[left + 1] - turns[left]
    s = (places - turns[left]) / step
    rise = value[left + 1] - value[left]
    low, high = step * slope[left] - rise, rise - step * slope[left + 1]
    return value[left] + s * rise + s * (1 - s) * ((1 - s) * low + s * high)


def _independent(
    left: Sequence[Complex[np.ndarray, "_ orders"]], variance: Float[np.ndarray, " orders"]
) -> Float[np.ndarray, " orders"]:
    """Return the share of the windows that count as independent, from the scatter of neighbours."""
    pairs = sum(len(part) - 1 for part in left)
    product = np.sum([_products(part) for part in left], axis=0)
    correlation = product / (max(pairs, 1) * np.maximum(variance, 1e-300))
    correlation = np.clip(correlation, _OVERLAP, 0.95)
    return (1 - correlation) / (1 + correlation)


def _products(part: Complex[np.ndarray, "windows orders"]) -> Float[np.ndarray, " orders"]:
    return np.sum(np.real(part[1:] * np.conj(part[:-1])), axis=0)


def _best_mean(part: Complex[np.ndarray, "windows orders"]) -> Float[np.ndarray, " orders"]:
    """Return the largest |mean| of the windows, turned by any steady phase from one to the next."""
    length = 1 << (4 * len(part) - 1).bit_length()
    return np.abs(np.fft.fft(part, length, axis=0)).max(axis=0) / len(part)
