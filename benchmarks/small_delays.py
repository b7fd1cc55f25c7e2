"""Does the interval of the backlash hold if the delay is too small to be fitted?

    python -m benchmarks.small_delays [--rigs 60] [--seed 0]

Rigs of the paper with drawn eccentricities, speeds, lengths, rates and delays of 0.3 to 32 µs of
either sign, half of them logged at one speed and half at two speeds that differ by 10 to 50 %. Each
is fitted with the defaults and, for comparison, with `delay="off"`, which leaves the delay out.
Counted are the rigs whose delay is not significant, and of them those whose constant backlash lies
outside its 95 % interval. Writes results/small_delays.json.
"""

import argparse
import json
from dataclasses import replace

import numpy as np

from vttig_jax.base.runtime import enable_x64
from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

from .environment import write

NAME = "constant_backlash_deg"


def half_widths_off(result: Fit, truth_deg: float) -> tuple[float, float]:
    """Distance of the constant backlash from the truth in half-widths, and the half-width, °."""
    gap = result.parameters[NAME]
    assert gap.value is not None and gap.low95 is not None and gap.high95 is not None
    half = (gap.high95 - gap.low95) / 2
    return abs(gap.value - truth_deg) / half, half


def study(seed: int, *, two_speeds: bool) -> dict[str, float | bool]:
    """Fit one drawn rig twice."""
    rng = np.random.default_rng([seed, two_speeds])
    speed, turns = float(rng.uniform(20, 120)), float(rng.uniform(6, 24))
    speeds = [speed, speed * float(rng.uniform(1.1, 1.5))][: 1 + two_speeds]
    drawn = Eccentricities(
        driving_mm=float(rng.uniform(0.01, 0.03)),
        driving_phase_deg=float(rng.uniform(0, 360)),
        driven_mm=float(rng.uniform(0.01, 0.03)),
        driven_phase_deg=float(rng.uniform(0, 360)),
        constant_backlash_deg=float(rng.uniform(0.09, 0.15)),
    )
    delay_s = float(10 ** rng.uniform(-6.5, -4.5) * rng.choice([-1, 1]))
    motions = [PassMotion(speed_rpm=rpm, reversal_deg=360.0 * turns) for rpm in speeds]
    rig = replace(
        paper_rig(int(rng.integers(2**31)), motions[0]),
        eccentricities=drawn,
        delay_s=delay_s,
        rate_hz=float(rng.uniform(500, 2000)),
    )
    logs = [replace(rig, motion=one).log(int(rng.integers(2**31))) for one in motions]
    found = fit(logs, rig.pair, same_zero=two_speeds)
    off, half = half_widths_off(found, float(drawn.constant_backlash_deg))
    known = fit(logs, rig.pair, same_zero=two_speeds, delay="off")
    off_alone, half_alone = half_widths_off(known, float(drawn.constant_backlash_deg))
    return {
        "significant": found.parameters["delay_s"].significant,
        "half_widths_off": off,
        "half_width_deg": half,
        "half_widths_off_without_delay": off_alone,
        "half_width_without_delay_deg": half_alone,
    }


def counts(rigs: list[dict[str, float | bool]]) -> dict[str, float | int]:
    """Counts over the rigs whose delay is taken as zero."""
    zero = [rig for rig in rigs if not rig["significant"]]
    return {
        "rigs": len(rigs),
        "taken_as_zero": len(zero),
        "outside": sum(rig["half_widths_off"] > 1 for rig in zero),
        "outside_without_delay": sum(rig["half_widths_off_without_delay"] > 1 for rig in zero),
        "outside_twice_without_delay": sum(
            rig["half_widths_off_without_delay"] > 2 for rig in zero
        ),
        "median_half_width_deg": float(np.median([rig["half_width_deg"] for rig in zero])),
        "median_half_width_without_delay_deg": float(
            np.median([rig["half_width_without_delay_deg"] for rig in zero])
        ),
        "fitted_outside": sum(rig["half_widths_off"] > 1 for rig in rigs if rig["significant"]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    enable_x64()
    record = {"options": vars(chosen)}
    for name, two_speeds in (("one_speed", False), ("two_speeds", True)):
        seeds = range(chosen.seed, chosen.seed + chosen.rigs // 2)
        record[name] = counts([study(seed, two_speeds=two_speeds) for seed in seeds])
    print(json.dumps(record, indent=1))
    write("small_delays.json", record)


if __name__ == "__main__":
    main()
