"""What explains a slope of the transmission error best: another ratio, a delay or a drift."""

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...base.numerics.student_noise import fit_student_noise
from ..encoder_log import EncoderLog

Cause = Literal["ratio", "delay", "drift", "open"]
"""Best explanation; "open" if none is clearly better than the others."""

CLEAR = 10.0
"""Least 2 Δ ln L by which an explanation must exceed the next one, as between a ratio and a delay
that changes (chosen)."""

_BLOCKS = 400  # largest number of blocks of the log, about; chosen value

_MOVES = 0.02
"""Share of the largest speed above which a direction of motion counts (chosen)."""


@dataclass(frozen=True)
class SlopeGains:
    """2 Δ ln L of three explanations of a slope, each over an explanation by noise alone."""

    ratio: float
    delay: float
    drift: float

    @property
    def cause(self) -> Cause:
        """The best explanation, if it is clearly better than the others and than noise."""
        gains: dict[Cause, float] = {
            "ratio": self.ratio,
            "delay": self.delay,
            "drift": self.drift,
        }
        best = max(gains, key=gains.__getitem__)
        others = max(0.0, *(gain for name, gain in gains.items() if name != best))
        return best if gains[best] > others + CLEAR else "open"


def slope_gains(log: EncoderLog) -> SlopeGains:
    """Compare the explanations of the slope of the transmission error of `log` by likelihood.

    Each explanation has one coefficient: of the driving angle, of its speed, or of the time. An
    offset, a gap between the two directions and first orders of the driving shaft are fitted beside
    it, in the means of blocks of rows, with autoregressive noise.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs import EncoderLog
    >>> from vttig_jax.logs.checks.slope_cause import slope_gains
    >>> from vttig_jax.pair import parse_pair_spec
    >>> drive = parse_pair_spec({"drive": {"ratio": "1"}})
    >>> time = np.arange(4000) / 200.0
    >>> driving = 720 * time + 300 * np.sin(0.7 * time)
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=4000)
    >>> late = driving - 0.005 * np.gradient(driving, time) + noise
    >>> slope_gains(EncoderLog.from_arrays(time, driving, late, pair=drive, unit="deg")).cause
    'delay'
    >>> fast = 1.001 * driving + noise
    >>> slope_gains(EncoderLog.from_arrays(time, driving, fast, pair=drive, unit="deg")).cause
    'ratio'

    ```
    """
    level, angle, speed, time, *base = _block_means(log)
    plain = fit_student_noise(level, np.stack(base, axis=1))

    def gain(column: Float[np.ndarray, " b"]) -> float:
        columns = np.stack([*base, column - column.mean()], axis=1)
        return 2 * (fit_student_noise(level, columns, plain).log_likelihood - plain.log_likelihood)

    return SlopeGains(ratio=gain(angle), delay=gain(speed), drift=gain(time))


def _block_means(log: EncoderLog) -> Float[np.ndarray, "8 b"]:
    """Return means over blocks of rows: transmission error, angle, speed, time, and the base.

    The base is ones, direction of motion, cosine and sine of the driving angle.
    """
    angle, speed = log.driving_angle, log.driving_speed.value
    driven = log.driven_angle
    slow = _MOVES * float(np.abs(speed).max())
    edges = np.linspace(0, len(angle), min(_BLOCKS, len(angle)) + 1).astype(np.int64).tolist()
    rows = []
    for start, stop in itertools.pairwise(edges):
        x, w = angle[start:stop], speed[start:stop]
        way = np.sign(np.where(np.abs(w) > slow, w, 0.0))
        error = driven[start:stop] - float(log.ratio) * x
        columns = (error, x, w, log.time[start:stop], np.ones(len(x)), way, np.cos(x), np.sin(x))
        rows.append([float(np.mean(one)) for one in columns])
    return np.array(rows).T
