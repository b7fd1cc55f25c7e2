"""The judge of a fit of the paper's rig: errors and scores against the truth, seed by seed."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from vttig_jax.base.angles import difference_deg
from vttig_jax.base.units import DEG, REV
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

BOUNDS = {
    "driving_eccentricity_mm": 0.009 * 0.0226,
    "driven_eccentricity_mm": 0.007 * 0.0273,
    "driving_phase_deg": 0.55,
    "driven_phase_deg": 0.4,
    "constant_backlash_deg": 1e-4,
}
"""Largest rms errors over many seeds."""

MAP_BOUND_DEG = 0.0006
"""Largest rms error of the order-complete map."""

MOST_STANDARD_ERRORS = 4.0

_GRID = np.linspace(0, 16 * REV, 5761)[:-1]


@dataclass(frozen=True)
class Judgement:
    """One fit: errors in the units of the parameters and in standard errors, rms of the map."""

    errors: dict[str, float]
    scores: dict[str, float]
    map_rms_deg: float


def judged(result: Fit, rig: SyntheticRig) -> Judgement:
    """Compare a fit of two flanks with the rig that made its log.

    A parameter that is not determined, or a phase without a value, counts as infinitely wrong.
    """
    eccentricities, errors, scores = rig.eccentricities, {}, {}
    truth = {
        "driving_eccentricity_mm": eccentricities.driving_mm,
        "driven_eccentricity_mm": eccentricities.driven_mm,
        "driving_phase_deg": eccentricities.driving_phase_deg,
        "driven_phase_deg": eccentricities.driven_phase_deg,
        "constant_backlash_deg": eccentricities.constant_backlash_deg,
    }
    for name, expected in truth.items():
        parameter = result.parameters[name]
        if parameter.value is None or parameter.std is None:
            errors[name] = scores[name] = np.inf
            continue
        error = parameter.value - float(expected)
        if name.endswith("phase_deg"):
            error = float(difference_deg(parameter.value, float(expected)))
        errors[name], scores[name] = error, error / parameter.std
    true_map = BacklashMap(rig.flank_model(), None, rig.pair).over(_GRID)
    difference = backlash_map(result).over(_GRID) - true_map
    return Judgement(errors, scores, float(np.sqrt(np.mean(difference**2))) / DEG)


def study(
    seeds: Iterable[int], identify: Callable[[SyntheticRig, int], Fit] | None = None
) -> list[Judgement]:
    """Judge `identify(rig, seed)` on the paper's rig, one seed after the other."""
    judge = identify or (lambda rig, seed: fit(rig.log(seed), rig.pair))
    return [judged(judge(rig, seed), rig) for seed in seeds for rig in [paper_rig(seed)]]


def rms_errors(judgements: list[Judgement]) -> dict[str, float]:
    """Rms error of every parameter."""
    return {
        name: float(np.sqrt(np.mean([j.errors[name] ** 2 for j in judgements]))) for name in BOUNDS
    }


def complaints(
    judgements: list[Judgement], *, slack: float = 1.0, map_bound_deg: float = MAP_BOUND_DEG
) -> list[str]:
    """What exceeds its bound; empty where the fits are good.

    `slack` multiplies the bounds of the parameters, for few seeds.
    """
    found = [
        f"{name}: {rms:.3g} rms, {slack * BOUNDS[name]:.3g} allowed"
        for name, rms in rms_errors(judgements).items()
        if not rms <= slack * BOUNDS[name]
    ]
    for number, judgement in enumerate(judgements):
        found += [
            f"{name}: {score:.1f} standard errors in fit {number}"
            for name, score in judgement.scores.items()
            if not abs(score) <= MOST_STANDARD_ERRORS
        ]
        if not judgement.map_rms_deg <= map_bound_deg:
            found.append(f"map: {judgement.map_rms_deg:.5f}° rms in fit {number}")
    return found
