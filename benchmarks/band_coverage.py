"""Does the simultaneous 95 % band of the map hold the whole true map in 95 % of the rigs?

    python -m benchmarks.band_coverage [--rigs 400] [--draws 1000] [--step-deg 1] [--seed 0]

Rigs of the scenario `orders`, long (orders 1 to 8 of both shafts, 21 turns) and short (1 to 4, 3.56
turns), logged and fitted as `vttig calibrate` does. Points of the normal approximation of every
fit become draws of the order-complete flank model, those become the band over the hunting period,
and that is held against the true gap of the contact. The pointwise band, which promises less, is
the negative control. Writes results/band_coverage.json.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import binomtest

import vttig_jax
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.model.column_layout import OFFSET
from vttig_jax.posterior.calibration.program import Batch, Program
from vttig_jax.posterior.calibration.rigs import Rig, Sizes, encoder_readings
from vttig_jax.posterior.calibration.sampled_subset import RigEvidence, rig_target
from vttig_jax.posterior.calibration.scenarios import SCENARIOS, Scenario
from vttig_jax.posterior.density.coefficients import coefficient_draws
from vttig_jax.posterior.summary.bands import Band, streamed_band
from vttig_jax.posterior.summary.gap_draws import GapDraws

from .environment import write

PROBABILITY = 0.95
BOUNDS = (0.91, 0.98)


@dataclass(frozen=True)
class Held:
    """One rig: is the true map inside everywhere?

    **Arguments**
    - `simultaneous`, `pointwise`: the gap of the contact, inside the band at every angle.
    - `as_measured`: the simultaneous band and the gap that faultless logs of these encoders show.
    - `share`: of the angles at which the pointwise band holds.
    - `furthest`, `critical`: largest deviation in standard deviations, and how many are allowed.
    - `half_width_arcsec`: of the simultaneous band, median.
    """

    simultaneous: bool
    pointwise: bool
    as_measured: bool
    share: float
    furthest: float
    critical: float
    half_width_arcsec: float


def grid(scenario: Scenario, step_deg: float) -> Float[np.ndarray, " n"]:
    """Driving angles over one hunting period, rad."""
    count = round(float(scenario.pair.hunting_turns) * 360.0 / step_deg)
    return np.arange(count) * step_deg * DEG


def true_gap(
    program: Program, rig: Rig, angle: Float[np.ndarray, " n"], *, as_measured: bool = False
) -> Float[np.ndarray, " n"]:
    """Gap of a rig, rad: of the contact, or as its encoders show it."""
    if as_measured:
        error = np.asarray(rig.driving_encoder)
        # The true angle at which the encoder shows `angle`, to 1e-8.
        angle = angle - np.abs(error) * np.sin(angle + np.angle(error))
    else:
        zero = jnp.zeros((), complex)
        rig = rig._replace(driving_encoder=zero, driven_encoder=zero)
    driving = jnp.asarray(np.stack([angle, angle]))
    first, second = np.asarray(_clean(rig, program.scenario, program.sizes, driving))
    return second - first


@partial(jax.jit, static_argnums=1)
def _clean(rig: Rig, scenario: Scenario, sizes: Sizes, driving):
    return encoder_readings(rig, jax.random.key(0), scenario, sizes, driving).clean


def drawn_gap(program: Program, evidence: RigEvidence, draws: int, seed: int) -> GapDraws:
    """Draws of the flank model from the normal approximation of a fit."""
    order = int(np.count_nonzero(evidence.partial))
    target = rig_target(program, evidence, order)
    points = target.starts(draws, np.random.default_rng(seed))
    points = points[np.isfinite(target.log_density(points))]
    coefficients = coefficient_draws(target.density.likelihood, points, seed)
    columns = program.columns
    terms = columns.free + columns.tied
    places = np.array([columns.cosine(k) for k in range(len(terms))])
    return GapDraws(
        program.scenario.pair,
        terms,
        coefficients[:, :, columns.index(OFFSET)],
        coefficients[:, :, places],
        coefficients[:, :, places + 1],
        np.arange(len(coefficients)),
    )


def rigs_of(batch: Batch) -> Iterator[tuple[Rig, RigEvidence]]:
    """Every rig of a batch with what its fit found."""
    for place in range(len(batch.truth)):
        rig, log, found, noise = jax.tree.map(
            lambda part, k=place: np.asarray(part[k]),
            (batch.rigs, batch.logs, batch.fitted.modelled, batch.fitted.partial),
        )
        std, truth = float(found.innovation_std), np.asarray(batch.truth[place])
        yield rig, RigEvidence(log, found.values, found.covariance, std, noise, truth)


def inside(curve: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """At which angles is the curve inside?"""
    return (curve >= low) & (curve <= high)


def judged(band: Band, gap: Float[np.ndarray, " n"], measured: Float[np.ndarray, " n"]) -> Held:
    """Hold the true map against its bands."""
    whole = (band.low_simultaneous, band.high_simultaneous)
    at_each = inside(gap, band.low, band.high)
    return Held(
        simultaneous=bool(inside(gap, *whole).all()),
        pointwise=bool(at_each.all()),
        as_measured=bool(inside(measured, *whole).all()),
        share=float(at_each.mean()),
        furthest=float(np.max(np.abs(gap - band.centre) / band.std)),
        critical=band.critical,
        half_width_arcsec=float(np.median(band.critical * band.std)) / ARCSEC,
    )


def held(program: Program, rigs: int, draws: int, step_deg: float, seed: int) -> Iterator[Held]:
    """Judge so many rigs of a case."""
    angle, number = grid(program.scenario, step_deg), 0
    for batch in program.batches(rigs, seed):
        if isinstance(batch, int):
            continue
        for rig, evidence in rigs_of(batch):
            band = streamed_band(
                drawn_gap(program, evidence, draws, seed + number).chunks(angle), PROBABILITY
            )
            measured = true_gap(program, rig, angle, as_measured=True)
            yield judged(band, true_gap(program, rig, angle), measured)
            number += 1


def share(hits: Sequence[bool]) -> dict[str, float]:
    """Share with its 95 % interval of Clopper and Pearson."""
    interval = binomtest(sum(hits), len(hits)).proportion_ci(0.95, method="exact")
    low, high = float(interval.low), float(interval.high)
    return {
        "hits": sum(hits),
        "rigs": len(hits),
        "share": sum(hits) / len(hits),
        "low95": low,
        "high95": high,
    }


def summary(found: Sequence[Held]) -> dict[str, Any]:
    """Shares of one case."""
    whole = share([one.simultaneous for one in found])
    return {
        "simultaneous": whole,
        "as_measured": share([one.as_measured for one in found]),
        "pointwise_everywhere": share([one.pointwise for one in found]),
        "pointwise_at_an_angle": float(np.mean([one.share for one in found])),
        "critical": float(np.median([one.critical for one in found])),
        "half_width_arcsec": float(np.median([one.half_width_arcsec for one in found])),
        "met": BOUNDS[0] <= whole["share"] <= BOUNDS[1],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=400)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--step-deg", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    vttig_jax.enable_x64()
    cases: dict[str, Any] = {}
    for length in ("long", "short"):
        program, start = Program(SCENARIOS["orders"].of_length(length)), time.perf_counter()
        found: list[Held] = []
        for one in held(program, chosen.rigs, chosen.draws, chosen.step_deg, chosen.seed):
            found.append(one)
            if len(found) % 25 and len(found) < chosen.rigs:
                continue
            seconds = time.perf_counter() - start
            own = summary(found)
            cases[program.scenario.case] = own | {
                "seconds": seconds,
                "rigs": [asdict(one) for one in found],
            }
            write(
                "band_coverage.json",
                {"options": vars(chosen), "bounds": BOUNDS, "cases": cases},
            )
            print(program.scenario.case, len(found), f"{seconds:.0f} s", own, flush=True)


if __name__ == "__main__":
    main()
