"""What counting adds to a planned run: white noise as a rule, a lasting error where frozen."""

import math
from collections.abc import Sequence
from fractions import Fraction

from ..base.units import REV
from ..pair.gears import Drive, GearPair

_FEW_PHASES = 4
"""Quantisation at so few places between two counts is no noise."""

_SLOW = 10.0
"""Cycles a turn of the counting error that still look like one of the fitted orders …"""

_OFTEN = 50.0
"""… where a turn has so many samples a cycle; with fewer it is quick from sample to sample."""

_FINER = 0.0065
"""Relative step in which another rate is looked for."""


def counting_std(pair: GearPair | Drive) -> float:
    """Standard deviation of the transmission error from counting, rad: √(s₂²/12 + i² s₁²/12)."""
    steps = [0.0 if count is None else REV / count for count in _counts(pair)]
    return math.hypot(float(pair.ratio) * steps[0], steps[1]) / math.sqrt(12)


def frozen_counts(pair: GearPair | Drive, speeds_rpm: Sequence[float], rate_hz: float) -> list[str]:
    """Sentences on shafts that turn by nearly the same fraction of a count every sample.

    60 rpm, 90 000 counts and 2 kHz make 45 counts a sample: every sample then has the same error of
    counting, which wanders with the slow part of the motion instead of averaging out.
    """
    told = []
    for speed_rpm in speeds_rpm:
        for shaft, a_sample in _frozen(pair, speed_rpm, rate_hz):
            told.append(
                f"{speed_rpm:g} rpm at {rate_hz:g} Hz is {a_sample} counts of the {shaft} encoder a"
                " sample: its counting error is frozen, does not average out and biases first"
                f" orders beyond the errors planned; sample at {_better(pair, speeds_rpm, rate_hz)}"
            )
    return told


def _frozen(pair: GearPair | Drive, speed_rpm: float, rate_hz: float) -> list[tuple[str, Fraction]]:
    found = []
    ratios = (1.0, float(pair.ratio))
    for shaft, count, ratio in zip(("driving", "driven"), _counts(pair), ratios, strict=True):
        if count is None:
            continue
        turns_a_second = ratio * speed_rpm / 60
        a_sample = count * turns_a_second / rate_hz
        near = Fraction(a_sample).limit_denominator(_FEW_PHASES)
        samples = rate_hz / turns_a_second
        cycles = abs(a_sample - float(near)) * near.denominator * samples
        # Below one count a sample every count is passed at times of its own.
        if near >= 1 and cycles < min(_SLOW, samples / _OFTEN):
            found.append((shaft, near))
    return found


def _better(pair: GearPair | Drive, speeds_rpm: Sequence[float], rate_hz: float) -> str:
    for step in range(1, 40):
        other = float(f"{rate_hz * (1 - _FINER * step):.4g}")
        if not any(_frozen(pair, speed_rpm, other) for speed_rpm in speeds_rpm):
            return f"{other:g} Hz"
    return "another rate"


def _counts(pair: GearPair | Drive) -> tuple[int | None, int | None]:
    return pair.driving.encoder.counts_per_rev, pair.driven.encoder.counts_per_rev
