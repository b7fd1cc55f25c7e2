"""Planned run: turns, speeds, directions and sampling rate."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ...base.errors import UsageError
from ...logs.encoder_log import EncoderLog
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import Encoder, GearTable
from ...rig.imperfections import quantised
from ...rig.motion import PassMotion

Directions = Literal["both", "forward", "backward"]

MOST_SAMPLES = 10_000_000
"""Largest number of samples of a run (chosen), so that it fits in the memory of a small machine."""

_FINE_COUNTS = 100_000_000
"""Assumed counts per turn of an encoder whose number of counts is not known (chosen)."""


def speeds_of(speed_rpm: float | Sequence[float]) -> tuple[float, ...]:
    """Return the speeds of a run that has one or several."""
    return tuple(speed_rpm) if isinstance(speed_rpm, Sequence) else (speed_rpm,)


@dataclass(frozen=True)
class PlannedRun:
    """Planned motion in one recording: passes at steady speed, each with ramps and a dwell.

    A pass is one motion over the angle `turns` in one direction, from standstill to standstill.

    **Arguments**
    - `turns`: turns of the driving shaft in every pass, ramps included.
    - `speeds_rpm`: speeds of the driving shaft; each has its own passes, one after the other.
    - `directions`: "both" (alternately forward and backward), "forward" or "backward".
    - `passes`: passes at every speed; by default 2 for both directions, 1 for one.
    - `rate_hz`: sampling rate, Hz.
    - `dwell_s`, `ramp_s`: standstill after every pass, and time from standstill to speed, s.

    **Raises** `ValueError` that names the wrong argument.
    """

    turns: float
    speeds_rpm: tuple[float, ...]
    rate_hz: float
    directions: Directions = "both"
    passes: int | None = None
    dwell_s: float = 2.0
    ramp_s: float = 0.5

    def __post_init__(self):
        if self.directions not in get_args(Directions):
            raise ValueError(
                'Argument `directions` must be "both", "forward" or "backward", but is'
                f" {self.directions!r}."
            )
        if not self.speeds_rpm:
            raise ValueError("Argument `speed_rpm` must hold at least one speed, but is empty.")
        arguments = {"turns": [self.turns], "speed_rpm": self.speeds_rpm, "rate_hz": [self.rate_hz]}
        for name, values in arguments.items():
            for value in values:
                if not 0 < value < math.inf:
                    raise ValueError(f"Argument `{name}` must be positive, but is {value!r}.")
        for name in ("dwell_s", "ramp_s"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"Argument `{name}` must not be negative, but is {value!r}.")
        both = self.directions == "both"
        if not (self.pass_count >= 2 if both else self.pass_count == 1):
            cure = "at least 2" if both else "1 in one direction (plan more turns instead)"
            raise ValueError(f"Argument `passes` must be {cure}, but is {self.passes!r}.")
        if self.turns < self.least_turns:
            raise ValueError(
                f"Argument `turns` must be at least {self.least_turns:.4g}, which the two ramps of"
                f" {self.ramp_s:g} s take at {max(self.speeds_rpm):g} rpm, but is {self.turns:g}."
            )

    @property
    def pass_count(self) -> int:
        """Number of passes at every speed; forward and backward motions are separate passes."""
        if self.passes is not None:
            return self.passes
        return 2 if self.directions == "both" else 1

    @property
    def least_turns(self) -> float:
        """Turns of the two ramps of a pass at the highest speed; a pass cannot be shorter."""
        return max(self.speeds_rpm) / 60 * self.ramp_s

    @property
    def motions(self) -> tuple[PassMotion, ...]:
        """Motion of the driving shaft for every speed; each begins at angle 0 and time 0."""
        times_s = self.dwell_s, self.ramp_s
        return tuple(
            PassMotion(speed, 360.0 * self.turns, *times_s, self.pass_count, ripple=0.0)
            for speed in self.speeds_rpm
        )

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the end of the last dwell, s."""
        return sum(motion.duration_s for motion in self.motions)

    @property
    def samples(self) -> int:
        """Number of samples of the whole recording."""
        return int(self.duration_s * self.rate_hz) + 1

    def log(self, pair: GearPair | Drive) -> EncoderLog:
        """Return the log of the motion with ideal encoders and gears: no errors, noise or gap.

        The readings are rounded to counts.

        **Raises** `UsageError` for more samples than fit in memory.
        """
        if self.samples > MOST_SAMPLES:
            raise UsageError(
                f"a run of {self.turns:g} turns has {self.samples:.3g} samples at"
                f" {self.rate_hz:g} Hz, but at most {MOST_SAMPLES:.0e} can be planned; plan fewer"
                " turns or a lower rate."
            )
        time = np.arange(self.samples) / self.rate_hz
        driving, start_s = np.zeros(len(time)), 0.0
        for motion in self.motions:
            driving += motion.driving_angle(time - start_s)
            start_s += motion.duration_s
        if self.directions == "backward":
            driving = -driving
        first, second = (
            gear.encoder.counts_per_rev or _FINE_COUNTS for gear in (pair.driving, pair.driven)
        )
        one, other = (GearTable(encoder=Encoder(counts_per_rev=count)) for count in (first, second))
        counts = quantised(driving, first), quantised(float(pair.ratio) * driving, second)
        ideal = Drive(pair.ratio, one, other)
        return EncoderLog.from_arrays(time, *counts, pair=ideal, source="planned run")

    def __str__(self) -> str:
        speeds = " and ".join(f"{speed:g}" for speed in self.speeds_rpm)
        ways = {
            "both": f"{self.pass_count} passes to and fro",
            "forward": "one pass forward",
            "backward": "one pass backward",
        }
        suffix = " each" if len(self.speeds_rpm) > 1 else ""
        return f"{self.turns:g} turns a pass, {ways[self.directions]} at {speeds} rpm{suffix}"
