"""Logs of a drive made by plain trigonometry, with a gap, a delay and harmonics of any form."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from vttig_jax.logs import EncoderLog
from vttig_jax.pair import Drive, GearPair, HarmonicOrders

Curve = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Driving angle in rad and driving speed in rpm → arcsec of the driven shaft."""


def known(number: float | None) -> float:
    """The number of a parameter that is determined."""
    assert number is not None
    return number


def near(one: Any, truth: float, *, stds: float = 4.0) -> bool:
    """Whether a number with a standard error is as near to the truth as it says."""
    return abs(known(one.value) - truth) < stds * known(one.std)


def level(arcsec: float) -> Curve:
    """The same value at every angle and speed."""
    return lambda angle, speed: np.full_like(angle, arcsec)


def drive(ratio: str, *, orders: tuple[int, ...] = (1,)) -> Drive:
    """A drive whose fit has these orders of both shafts."""
    return Drive(Fraction(ratio), fit=HarmonicOrders(orders, orders, 0), name="drive")


def there_and_back(
    rpms: Sequence[float], seconds: float, ramp_s: float = 0.2
) -> tuple[list[float], list[float]]:
    """Durations in s and speeds in rpm at their ends: `seconds` forward and back at each speed."""
    pieces = [(0.3, 0.0)]
    for rpm in rpms:
        for sign in (1.0, -1.0):
            pieces += [(ramp_s, sign * rpm), (seconds, sign * rpm), (ramp_s, 0.0), (0.3, 0.0)]
    return [duration for duration, _ in pieces], [rpm for _, rpm in pieces]


def drive_log(
    pair: Drive | GearPair,
    motion: tuple[Sequence[float], Sequence[float]],
    *,
    gap: Curve,
    error: Curve = level(0.0),
    delay_s: Curve = level(0.0),
    noise_arcsec: float = 0.5,
    rate_hz: float = 100.0,
    start_turns: float = 0.0,
    seed: int = 0,
    ratio: float | None = None,
) -> EncoderLog:
    """The log of a motion that `there_and_back` describes.

    `gap` is TE_B − TE_A and `error` is TE_A. `delay_s` takes the time in s in place of the angle.
    The shafts turn at `ratio`, which is that of the pair unless given.
    """
    durations, rpms = motion
    knots = np.cumsum([0.0, *durations])
    fine = np.linspace(0.0, knots[-1], 200_000)
    rpm = np.interp(fine, knots, [0.0, *rpms])
    step = np.diff(fine) * (rpm[1:] + rpm[:-1]) * np.pi / 60
    turned = np.concatenate([[0.0], np.cumsum(step)]) + 2 * np.pi * start_turns
    time = np.arange(0.05, knots[-1] - 0.05, 1 / rate_hz)
    driving = np.interp(time, fine, turned)
    seen = time - delay_s(time, time)
    late, speed = np.interp(seen, fine, turned), np.interp(seen, fine, rpm)
    arcsec = error(late, np.abs(speed)) + np.where(speed < 0, gap(late, np.abs(speed)), 0.0)
    arcsec = arcsec + noise_arcsec * np.random.default_rng(seed).standard_normal(len(time))
    driven = late * (float(pair.ratio) if ratio is None else ratio) + np.radians(arcsec / 3600)
    return EncoderLog.from_arrays(
        time,
        np.degrees(driving - driving[0]),
        np.degrees(driven - driven[0]),
        pair=pair,
        unit="deg",
        source=f"drive {seed}",
    )
