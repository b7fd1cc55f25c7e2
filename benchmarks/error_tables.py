"""Does an error table make any axis better, and does it leave what is predicted?

    python -m benchmarks.error_tables [--rigs 200] [--seed 0]

Every rig is a drive of `benchmarks.verified`, whose noisy log is fitted. The axis is drawn: its
shaft, sense, zero, travel, step, a travel beyond the table, and whether the control knows the turn.
The table is applied to the *drawn* error: its rms and largest magnitude over the stated travel with
the table and without it, and whether the rms lies in the predicted 95 % band. Refusals are counted.
Writes results/error_tables.json.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from vttig_jax.base.errors import VttigError
from vttig_jax.base.runtime import enable_x64
from vttig_jax.base.units import DEG, REV
from vttig_jax.control.compensation.correction import AxisError, Curve, left_over, size
from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Flank, pair_from_spec
from vttig_jax.pair.pair_file import parse_pair_spec
from vttig_jax.runs.axis_table import AxisSetting, axis_table

from .environment import write
from .verified import Rig, there_and_back


def setting(rig: Rig, rng: np.random.Generator) -> tuple[AxisSetting, float | None]:
    """Draw an axis and the step of its table, °."""
    shaft = "driven" if rng.random() < 0.7 else "driving"
    turns = rig.ratio.numerator if shaft == "driven" else rig.ratio.denominator
    known = turns == 1 or rng.random() < 0.8
    start, span = rng.uniform(-360, 360), rng.uniform(60, 360 * (turns if known else 1))
    travel = start, start + span
    over = None
    if known and rng.random() < 0.3:
        over = start - rng.uniform(0, 60), start + span + rng.uniform(0, 60)
    zero, back = rng.uniform(-180, 180), bool(rng.random() < 0.5)
    step = span / rng.integers(60, 256) if rng.random() < 0.5 else None
    return AxisSetting(shaft, zero, back, travel, over, known), step


def truth(rig: Rig, axis: AxisSetting) -> AxisError:
    """Return the drawn error of an axis, whose flank A has the mean zero."""
    ratio = float(rig.ratio)
    angle = np.arange(2**14) * (rig.ratio.denominator * REV / 2**14)
    level = rig.errors["A"](angle).mean()

    def less(flank: Flank) -> Curve:
        return lambda angle: rig.errors[flank](angle) - level

    gain = (ratio if axis.shaft == "driven" else 1.0) * (-1 if axis.reversed else 1)
    turns = rig.ratio.numerator if axis.shaft == "driven" else rig.ratio.denominator
    places = (0,) if axis.place_known else tuple(range(turns))
    return AxisError({"A": less("A"), "B": less("B")}, ratio, gain, axis.zero_deg * DEG, places)


def answers(seed: int) -> Iterator[dict[str, Any]]:
    """Yield what a table leaves in each direction of one rig, or the refusal."""
    rig, rng = Rig.drawn(seed), np.random.default_rng(20_000 + seed)
    spec = parse_pair_spec(
        {
            "drive": {"ratio": str(rig.ratio)},
            "log": {"zero": "reading"},
            "fit": {"driving_orders": [1, 2, 3], "driven_orders": [1, 2]},
        }
    )
    time, driving, sign = there_and_back(4 * rig.ratio.denominator, 1)
    te = np.where(sign >= 0, *(rig.errors[flank](driving) for flank in "AB"))
    driven = float(rig.ratio) * driving + te + rig.noisy(len(time), rng)
    log = EncoderLog.from_arrays(time, driving, driven, pair=spec, unit="rad")
    found = fit(log, pair_from_spec(spec), orders=spec.fit, delay="off", ratio_within=0.0)
    axis, step = setting(rig, rng)
    try:
        table = axis_table(found, None, axis, step)
    except VttigError as error:
        yield {"refused": error.message.split(";")[0].split(",")[0][:40]}
        return
    exact = truth(rig, axis)
    first, last = (DEG * end for end in table.over_deg)
    where = np.linspace(first, last, 20_001)
    for name, (low, high) in table.after95.items():
        before = size(left_over(exact, None, name, where))
        after = size(left_over(exact, table.table, name, where))
        yield {
            "share": after.rms / before.rms,
            "peak": after.peak / before.peak,
            "held": low <= after.rms <= high,
        }


def main() -> None:
    """Run the study and write its result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    enable_x64()
    every = [one for k in range(asked.seed, asked.seed + asked.rigs) for one in answers(k)]
    tables = [one for one in every if "share" in one]
    refused = Counter(one["refused"] for one in every if "refused" in one)
    share = np.array([one["share"] for one in tables])
    result = {
        "rigs": asked.rigs,
        "directions": len(tables),
        "rms_raised": int(np.sum(share >= 1)),
        "peak_raised": int(np.sum([one["peak"] > 1 for one in tables])),
        "share_median": float(np.median(share)),
        "share_largest": float(share.max()),
        "in_predicted_95": float(np.mean([one["held"] for one in tables])),
        "refused": dict(refused),
    }
    for name, value in result.items():
        print(f"{name:16} {value}")
    write("error_tables.json", result)


if __name__ == "__main__":
    main()
