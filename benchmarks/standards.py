"""Do intervals of the numbers of ISO 1328-1 and ISO 230-2 hold the truth?

    python -m benchmarks.standards [--rigs 320] [--seed 0]

Half of the rigs are gear pairs that run: the paper's rig with drawn orders, for half of them an
error of every pitch, encoders and noise, on four to nine turns each way at 500 to 1200 Hz. The
truth is the range of the true transmission error, read by the true encoders without noise, over the
hunting period at 64 points in a pitch: of its mean over the turns of each shaft, and of the sum of
both. The other rigs are tables of readings at standstill of an axis with drawn orders, gap and
scatter, 8 to 36 targets and 5 to 10 approaches from each side.

Counted are intervals that contain the truth. Writes results/standards.json.
"""

import argparse
import json
from collections import defaultdict
from dataclasses import replace
from fractions import Fraction

import numpy as np

from vttig_jax import fit
from vttig_jax.base.runtime import enable_x64
from vttig_jax.base.units import ARCSEC, REV
from vttig_jax.identify.result import Fit
from vttig_jax.kinematics.flank_error import errors_at
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Drive, Flank
from vttig_jax.rig.imperfections import Noise, OrderError, Shaft
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

from .environment import write

POINTS = 64
Held = dict[str, list[tuple[bool, float, float]]]
"""Number → whether the interval holds the truth, and by how much the number as read and its value
are too large, in parts of the truth."""


def drawn(rng: np.random.Generator) -> SyntheticRig:
    """Draw a gear pair in its run."""
    turns = float(rng.uniform(4, 9))
    rig = paper_rig(int(rng.integers(2**31)), PassMotion(reversal_deg=360 * turns, dwell_s=0.5))
    if rng.uniform() < 0.5:  # every pitch has an error of its own
        size = 3e-4 * float(rng.uniform(0.3, 3))
        teeth: tuple[tuple[Shaft, int], ...] = (
            ("driving", rig.pair.driving.teeth),
            ("driven", rig.pair.driven.teeth),
        )
        flanks: tuple[Flank, ...] = ("A", "B")
        pitch = tuple(
            OrderError(shaft, k, flank, size * float(rng.rayleigh()), float(rng.uniform(0, 360)))
            for shaft, count in teeth
            for k in range(9, count)
            for flank in flanks
        )
        wide = replace(rig.eccentricities, constant_backlash_deg=0.12)
        rig = replace(rig, orders=(*rig.orders, *pitch), eccentricities=wide)
    noise = Noise(0.002 * 2 ** float(rng.uniform(-2, 0.5)), 0.00475)
    return replace(rig, rate_hz=float(rng.uniform(500, 1200)), noise=noise)


def mean_of_turns(values: np.ndarray, turns: int) -> np.ndarray:
    """Mean over the turns of a shaft, for all of them."""
    return np.tile(values.reshape(turns, -1).mean(axis=0), turns)


def within(curve: np.ndarray, size: int) -> float:
    """Largest range of a curve that repeats within `size` steps."""
    whole = np.concatenate([curve, curve[:size]])
    seen = np.lib.stride_tricks.sliding_window_view(whole, size + 1)
    return float(np.ptp(seen, axis=1).max())


def terms(curve: np.ndarray, pitches: int) -> dict[str, float]:
    """The four numbers of a curve over a period of so many pitches."""
    waves = np.fft.rfft(curve)
    waves[np.arange(len(waves)) >= pitches / 2] = 0
    long, size = np.fft.irfft(waves, len(curve)), len(curve) // pitches
    return {
        "F_is": float(np.ptp(curve)),
        "f_is_1995": within(curve, size),
        "f_is_2013": within(curve - long, size),
        "f_l": float(np.ptp(long)),
    }


def single_flank_truth(
    rig: SyntheticRig, flank: Flank, points: int = POINTS
) -> dict[str, dict[str, float]]:
    """The numbers of the true transmission error of a flank as the encoders show it, ″.

    It is computed at so many `points` in a pitch.
    """
    pair, hunting = rig.pair, rig.pair.hunting_turns
    count, teeth = points * hunting * pair.driving.teeth, (pair.driving.teeth, pair.driven.teeth)
    angle = np.arange(count) / count * hunting * REV
    true = angle.copy()
    for _ in range(3):  # the true angle at which the encoder reads `angle`
        true -= rig.driving_encoder.reading(true) - angle
    driven = float(pair.ratio) * true + errors_at(rig.flank_model(), flank, true)
    error = (rig.driven_encoder.reading(driven) - float(pair.ratio) * angle) / ARCSEC
    error -= error.mean()
    driving, other = (mean_of_turns(error, n) for n in (hunting, hunting * teeth[0] // teeth[1]))
    both = mean_of_turns(other, hunting)  # orders that both shafts repeat
    return {
        "driving shaft": terms(driving[: count // hunting], teeth[0]),
        "driven shaft": terms(other[: points * teeth[1]], teeth[1]),
        "pair": terms(driving + other - both, teeth[0] * hunting),
    }


def add(held: Held, name: str, found: dict[str, float], truth: float) -> None:
    inside = found["low95_arcsec"] <= truth <= found["high95_arcsec"]
    read, value = (found[key] / truth - 1 for key in ("read_arcsec", "value_arcsec"))
    held[name].append((bool(inside), read, value))


def single_flank(held: Held, rng: np.random.Generator) -> None:
    """Count the numbers of one rig that runs."""
    rig = drawn(rng)
    found: Fit = fit(rig.log(int(rng.integers(2**31))), rig.pair)
    sides: tuple[Flank, ...] = ("A", "B")
    truths = {flank: single_flank_truth(rig, flank) for flank in sides}
    for row in found.accuracy.to_json()["single_flank"]:
        for name, truth in truths[row["flank"]][row["period"]].items():
            add(held, f"{row['period']}, {name}", row[name], truth)


def axis(held: Held, rng: np.random.Generator) -> None:
    """Count the numbers of one table of an axis."""
    targets, passes = int(rng.choice([8, 12, 18, 36])), int(rng.integers(5, 11))
    angle = np.arange(targets) * REV / targets
    scatter = float(10 ** rng.uniform(-0.3, 0.7))
    orders = np.arange(1, 4)
    size = rng.normal(size=(2, 3)) * 10 ** rng.uniform(0, 1.5) / orders
    middle = (np.cos(np.outer(angle, orders)) @ size[0]) + (
        np.sin(np.outer(angle, orders)) @ size[1]
    )
    gap = rng.uniform(0, 10) + rng.uniform(0, 3) * np.cos(angle + rng.uniform(0, REV))
    mean = np.stack([middle - gap / 2, middle + gap / 2])
    std = scatter * np.exp(rng.choice([0.0, 0.3]) * rng.normal(size=mean.shape))
    each = [mean[k] + std[k] * rng.normal(size=(passes, targets)) for k in (0, 1)]
    order = np.append(np.arange(targets), np.arange(targets)[::-1])
    way = np.repeat([0, 1], targets)
    error = np.stack([both[:, t] for both, t in zip([each[w] for w in way], order, strict=True)], 1)
    driving = np.tile(np.degrees(angle[order]), passes)
    driven = driving + error.ravel() / 3600
    drive = Drive(Fraction(1), name="axis")
    direction = np.tile(1 - 2 * way, passes)
    time = np.arange(len(driving), dtype=float)
    log = EncoderLog.from_arrays(time, driving, driven, pair=drive, unit="deg", direction=direction)
    record = fit(log, drive, standstill=True, perfect_gears=True).accuracy.to_json()["axis"]
    half = np.abs(mean[0] - mean[1])
    truth = {
        "B": half.max(),
        "M": np.ptp(mean.mean(axis=0)),
        "E": np.ptp(mean),
        "R": np.maximum(2 * std.sum(axis=0) + half, 4 * std.max(axis=0)).max(),
        "A": np.max(mean + 2 * std) - np.min(mean - 2 * std),
    }
    for name, value in truth.items():
        add(held, f"axis, {name}", record["numbers"][name], float(value))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=640)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    enable_x64()
    held: Held = defaultdict(list)
    for number in range(options.rigs):
        (single_flank, axis)[number % 2](held, np.random.default_rng([options.seed, number]))
    record = {
        "options": vars(options),
        "numbers": {
            name: {
                "intervals": len(rows),
                "coverage": round(float(np.mean([row[0] for row in rows])), 3),
                "read_too_large": round(float(np.median([row[1] for row in rows])), 4),
                "value_too_large": round(float(np.median([row[2] for row in rows])), 4),
            }
            for name, rows in held.items()
        },
    }
    write("standards.json", record)
    print(json.dumps(record, indent=1))


if __name__ == "__main__":
    main()
