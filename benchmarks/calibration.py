"""Coverage of the intervals of a fit, on logs simulated sample by sample.

    python -m benchmarks.calibration [--rigs 200] [--case ar_4ms75] [--short]

Rigs are drawn around the paper's: eccentricities in a disc of 0.03 mm; encoders, orders and gap
are new. Their contact is exact, the noise is that of single samples and both encoders count. All
logs go through `vttig_jax.fit_many`, and the intervals that hold the truth are counted. That is
more than `vttig calibrate RUN`, which draws rows from the model of a fit. Writes
results/calibration.json.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import vttig_jax
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.posterior import coverage
from vttig_jax.rig import PassMotion, paper_rig
from vttig_jax.rig.imperfections import Noise
from vttig_jax.rig.synthetic import SyntheticRig

from .environment import write

CASES = {
    "white": Noise(0.002, 0.0),
    "ar_1ms4": Noise(0.002, 0.0014),
    "ar_4ms75": Noise(0.002, 0.00475),
    "ar_25ms": Noise(0.002, 0.025),
    "counts": Noise(0.0005, 0.0),
}
TURNS = {"long": 21.0, "short": 3.6}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--case", choices=list(CASES), action="append")
    parser.add_argument("--short", action="store_true", help="3.6 turns a pass instead of 21")
    chosen = parser.parse_args()
    vttig_jax.enable_x64()
    length = "short" if chosen.short else "long"
    record = {}
    for case in chosen.case or CASES:
        start = time.perf_counter()
        rigs = list(drawn(CASES[case], TURNS[length], chosen.rigs))
        table = vttig_jax.fit_many(
            (rig.log(seed) for seed, rig in enumerate(rigs)), rigs[0].pair, lines="report"
        )
        found = {name: _held(table, name, rigs) for name in _TRUTHS}
        record[f"{case}, {length}"] = found | {"seconds": time.perf_counter() - start}
        for name, one in found.items():
            print(f"{case:9} {name:28} {100 * one['share']:5.1f} % of {one['rigs']}")
    write("calibration.json", record)


def drawn(noise: Noise, turns: float, rigs: int) -> Iterator[SyntheticRig]:
    """Rigs like the paper's with eccentricities, backlash and orders of their own."""
    motion = PassMotion(speed_rpm=57.466, reversal_deg=360.0 * turns)
    for seed in range(rigs):
        generator = np.random.default_rng([7, seed])
        sizes = 0.03 * np.sqrt(generator.uniform(size=2))
        phases = generator.uniform(0, 360, 2)
        gap = generator.uniform(0.065, 0.12)
        given = Eccentricities(sizes[0], phases[0], sizes[1], phases[1], gap)
        yield replace(paper_rig(seed, motion), eccentricities=given, noise=noise)


_TRUTHS = {
    "driving_eccentricity_mm": lambda rig: rig.eccentricities.driving_mm,
    "driven_eccentricity_mm": lambda rig: rig.eccentricities.driven_mm,
    "driving_encoder_arcsec": lambda rig: rig.driving_encoder.amplitude_arcsec,
    "driven_encoder_arcsec": lambda rig: rig.driven_encoder.amplitude_arcsec,
    "constant_backlash_deg": lambda rig: rig.eccentricities.constant_backlash_deg,
    "delay_s": lambda rig: rig.delay_s,
}


def _held(table: vttig_jax.FitTable, name: str, rigs: list[SyntheticRig]) -> dict[str, float]:
    """Coverage of a parameter over the rigs that told it."""
    true = np.array([float(_TRUTHS[name](rig)) for rig in rigs])
    low, high = (table.columns[f"{name}_{end}"] for end in ("low95", "high95"))
    told = np.isfinite(low)
    one = coverage(int(np.sum((low <= true) & (true <= high) & told)), max(int(told.sum()), 1))
    return {"share": one.share, "rigs": one.rigs, "low95": one.low, "high95": one.high}


if __name__ == "__main__":
    main()
