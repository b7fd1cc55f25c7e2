"""What sampling costs, and its intervals and bands beside those of the fit and the truth.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.sampler [--rigs 20]

Writes results/sampler.json; times are process times. The logs are those of `paper_rig`, short ones
of five turns there and back for intervals and bands.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from vttig_jax.base.runtime import enable_x64
from vttig_jax.identify.identification import fit
from vttig_jax.posterior.chains import FEWEST_ENSEMBLES
from vttig_jax.posterior.rig_draws import target_of
from vttig_jax.posterior.sampler import sample
from vttig_jax.posterior.summary.bands import band_map
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

from .environment import write

enable_x64()

STEP_DEG = 7.3
"""Step of the maps: it walks through the tooth mesh."""


def spent(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the process time of a piece of work, s, and its result."""
    began = time.process_time()
    result = work()
    return time.process_time() - began, result


def costs() -> dict[str, float]:
    """Return what the density and a whole run cost on the paper's log."""
    rig = paper_rig(0)
    result = fit(rig.log(0), rig.pair)
    target = target_of(result)
    around = target.around()
    weights = around.weights / around.weights.sum()
    points = around.starts(512, np.random.RandomState(0))
    target.log_density(points)
    density_s = min(spent(lambda: target.log_density(points))[0] for _ in range(5))
    sample(result, steps=50)
    whole_s, found = spent(lambda: sample(result))
    diagnosis = found.diagnosis
    moves = FEWEST_ENSEMBLES * found.chains.header.walkers * diagnosis.steps
    return {
        "coordinates": len(target.names),
        "density_us": 1e6 * density_s / len(points),
        "efficiency_of_weighted_draws": 1 / float(np.sum(weights**2)) / len(weights),
        "steps": diagnosis.steps,
        "effective_draws": float(diagnosis.effective.min()),
        "whole_s": whole_s,
        "share_of_density": moves * density_s / len(points) / whole_s,
    }


def beside(seed: int) -> dict[str, Any]:
    """Return widths of intervals over those of the fit, and whether bands hold the true map."""
    rig = replace(paper_rig(seed, PassMotion(reversal_deg=1800.0, dwell_s=0.5)), rate_hz=700.0)
    result = fit(rig.log(seed), rig.pair)
    found = sample(result)
    ratios = {}
    for name, known in result.parameters.items():
        drawn = found.parameters[name]
        ends: list[Any] = [known.low95, known.high95, drawn.low95, drawn.high95]
        if None not in ends:
            ratios[name] = (ends[3] - ends[2]) / (ends[1] - ends[0])
    banded = band_map(found, STEP_DEG)
    gap, band = np.asarray(rig.flank_model().backlash(banded.driving_angle)), banded.band
    inside = lambda low, high: (gap >= low) & (gap <= high)  # noqa: E731
    return {
        "seed": seed,
        "width_over_fit": ratios,
        "converged": found.diagnosis.converged,
        "whole_map_inside": bool(inside(band.low_simultaneous, band.high_simultaneous).all()),
        "share_inside_pointwise": float(inside(band.low, band.high).mean()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=20)
    rigs = [beside(seed) for seed in range(parser.parse_args().rigs)]
    widths = np.array([ratio for one in rigs for ratio in one["width_over_fit"].values()])
    summary = {
        "width_over_fit": np.quantile(widths, [0.0, 0.05, 0.5, 0.95, 1.0]).tolist(),
        "whole_map_inside": sum(one["whole_map_inside"] for one in rigs),
        "share_inside_pointwise": float(np.mean([one["share_inside_pointwise"] for one in rigs])),
        "converged": sum(one["converged"] for one in rigs),
    }
    record = {"cost": costs(), "summary": summary, "rigs": rigs}
    write("sampler.json", record)
    print(record["cost"], summary, sep="\n")


if __name__ == "__main__":
    main()
