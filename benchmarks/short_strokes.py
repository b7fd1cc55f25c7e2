"""Does the interval of the gap hold in strokes to and fro of a fraction of a turn?

    python -m benchmarks.short_strokes [--rigs 250] [--seed 1000]

Each rig is a drive of 1:100 to 16:9 whose teeth cross the gap by the play operator: after every
reversal the driven shaft stands still while the driving shaft turns by 1 to 40 degrees. It makes 2
to 8 strokes of 1.2 to 30 such crossings, of at least 54 degrees. Drawn are speed, sampling rate,
encoder steps, eccentricities of a tenth of the gap at most, a delay of 0, 0.3 or 0.9 sampling
intervals, and for half of the rigs speeds that differ by 2 percent from stroke to stroke. Each log
is fitted with the defaults.

Counted are intervals of the gap without the truth, gaps farther off than twice the half-width, logs
whose gap is undetermined, and refusals by their reason. Writes results/short_strokes.json.
"""

import argparse
import json
from collections import Counter
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from vttig_jax.base.errors import VttigError
from vttig_jax.base.runtime import enable_x64
from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.pair.schema import HarmonicOrders

from .environment import write

FINE = 5  # points of the motion in a sampling interval
MOST_SAMPLES = 40_000
LEAST_SAMPLES = 40  # of a stroke
RAMP_S, RAMP = 0.1, 1 / 8  # duration of a ramp, and its largest share of a stroke


class Rig(NamedTuple):
    """What is drawn: angles in rad, times in s."""

    ratio: Fraction
    gap: float
    stroke: float
    strokes: int
    speed: float
    interval_s: float
    delay_s: float
    unequal: float


def drawn(rng: np.random.Generator) -> Rig:
    """Draw a rig."""
    ratio = Fraction(str(rng.choice(["1/100", "1/30", "1/7", "1/3", "9/16"])))
    crossing = np.radians(10 ** rng.uniform(0, 1.6))
    stroke = max(crossing * rng.uniform(1.2, 30), np.radians(54))
    speed, strokes = 2 * np.pi * 10 ** rng.uniform(-1, 0.6), int(rng.integers(2, 9))
    duration = stroke / speed
    rate = min(float(rng.choice([100, 500, 1000])), MOST_SAMPLES / (duration * strokes))
    interval_s = 1 / max(rate, LEAST_SAMPLES / duration)
    return Rig(
        ratio=ratio,
        gap=float(ratio) * crossing,
        stroke=stroke,
        strokes=strokes,
        speed=speed,
        interval_s=interval_s,
        delay_s=float(rng.choice([0.0, 0.3, 0.9])) * interval_s,
        unequal=float(rng.choice([0.0, 0.02])),
    )


def played(lower: np.ndarray, gap: float) -> np.ndarray:
    """Driven angle that is held between `lower` and `lower` + `gap`."""
    found, here = np.empty_like(lower), 0.0
    for k, low in enumerate(lower):
        here = found[k] = min(max(here, low), low + gap)
    return found


def logged(rig: Rig, rng: np.random.Generator) -> EncoderLog:
    """Simulate the log of a rig."""
    ratio, duration = float(rig.ratio), rig.stroke / rig.speed
    time = np.arange(0, duration * rig.strokes, rig.interval_s / FINE)
    stroke, phase = np.divmod(time, duration)
    ramp = rig.speed / min(RAMP_S, RAMP * duration)
    speed = np.minimum(ramp * np.minimum(phase, duration - phase), rig.speed)
    each = 1 + rig.unequal * rng.standard_normal(rig.strokes + 1)
    speed *= np.where(stroke % 2 == 0, 1, -1) * each[stroke.astype(int)]
    steps = (speed[1:] + speed[:-1]) / 2 * np.diff(time)
    driving = np.concatenate([[0.0], np.cumsum(steps)])
    first, second = rng.uniform(0, 0.1, 2) * rig.gap
    error = first * np.sin(driving + rng.uniform(0, 6))
    error += second * np.sin(ratio * driving + rng.uniform(0, 6))
    driven = played(ratio * driving, rig.gap) + error
    step = min(2 * np.pi / float(rng.choice([4096, 65536])), rig.gap / 4)
    seen = np.interp(time[::FINE] - rig.delay_s, time, driven)
    angles = [
        part + 0.3 * step * rng.standard_normal(len(part)) for part in (driving[::FINE], seen)
    ]
    counted = [np.degrees(np.round(angle / step) * step) for angle in angles]
    return EncoderLog.from_arrays(time[::FINE], *counted, pair=_drive(rig), unit="deg")


def _drive(rig: Rig) -> Drive:
    return Drive(rig.ratio, fit=HarmonicOrders((1,), (1,), 0), name="short strokes")


def outcome(seed: int) -> tuple[str, float | None]:
    """What the fit of a rig says, and how far off its gap is in half-widths of its interval."""
    rng = np.random.default_rng(seed)
    rig = drawn(rng)
    try:
        gap = fit(logged(rig, rng), _drive(rig)).checks.gap_over_angles_covered
    except VttigError as error:
        return f"refused: {str(error).partition(': ')[2][:60]}", None
    if gap.value is None or gap.low95 is None or gap.high95 is None:
        return "undetermined", None
    half = (gap.high95 - gap.low95) / 2
    beyond = max(gap.low95 - np.degrees(rig.gap), np.degrees(rig.gap) - gap.high95)
    return "stated", 1 + beyond / half


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=250)
    parser.add_argument("--seed", type=int, default=1000)
    options = parser.parse_args()
    enable_x64()
    found = [outcome(options.seed + number) for number in range(options.rigs)]
    off = np.array([half_widths for _, half_widths in found if half_widths is not None])
    record = {
        "options": vars(options),
        "said": dict(Counter(said for said, _ in found).most_common()),
        "outside": int(np.sum(off > 1)),
        "outside_twice": int(np.sum(off > 2)),
        "farthest_half_widths": round(float(off.max()), 2),
    }
    write("short_strokes.json", record)
    print(json.dumps(record, indent=1))


if __name__ == "__main__":
    main()
