"""Rigs drawn from a posterior, for simulations."""

import numpy as np

from ...base.errors import NoAnswerError
from ...base.units import DEG
from ...identify.fit_result import require_rig
from ...pair.eccentricities import Eccentricities
from .posterior import Posterior


def rig_draws(posterior: Posterior, draws: int = 200, seed: int = 0) -> tuple[Eccentricities, ...]:
    """Return rigs: joint posterior draws of both eccentricities and the constant backlash.

    An eccentricity that the log does not determine is zero. A rig has no orders above the first and
    no encoder errors.

    **Arguments**
    - `draws`: number of rigs, all from different draws.
    - `seed`: seed of the random selection of the draws.

    **Raises** `NoAnswerError` without gear geometry, constant backlash or enough draws.

    Use in a sweep: `sweep(…, rigs=rig_draws(posterior, 200), believed=fit.eccentricities())`.
    """
    fit = posterior.fit
    require_rig(fit)
    available = len(posterior.flat)
    if draws > available:
        raise NoAnswerError(
            f"{draws} draws are requested, but the posterior holds {available}; sample longer.",
            where=fit.source,
        )
    chosen = np.sort(np.random.default_rng(seed).choice(available, draws, replace=False))
    offsets = [_offset(posterior, shaft)[chosen] for shaft in ("driving", "driven")]
    gaps = posterior.values("constant_backlash")[chosen] / DEG
    if posterior.gap_of_delay is not None:
        gaps += posterior.gap_of_delay[chosen] / DEG
    return tuple(
        Eccentricities(
            abs(driving), np.angle(driving, deg=True), abs(driven), np.angle(driven, deg=True), gap
        )
        for driving, driven, gap in zip(*offsets, gaps, strict=True)
    )


def _offset(posterior: Posterior, shaft: str) -> np.ndarray:
    """Return the eccentricity e·exp(jθ) = x + jy of `shaft` for every posterior draw, mm."""
    if not posterior.fit.parameters[f"{shaft}_eccentricity_mm"].determined:
        return np.zeros(len(posterior.flat), complex)
    return posterior.values(f"{shaft}_x") + 1j * posterior.values(f"{shaft}_y")
