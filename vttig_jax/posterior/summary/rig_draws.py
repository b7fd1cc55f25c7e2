"""Rigs drawn from a posterior, for whoever simulates them."""

import numpy as np

from ...base.errors import NoAnswerError
from ...base.units import DEG
from ...identify.fit_result import require_rig
from ...pair.eccentricities import Eccentricities
from .posterior import Posterior


def rig_draws(posterior: Posterior, draws: int = 200, seed: int = 0) -> tuple[Eccentricities, ...]:
    """Draw rigs: both eccentricities and the constant backlash, as they go together.

    An eccentricity that the log does not determine counts as zero. Orders above the first are no
    part of a rig, nor are the encoders' own errors.

    **Arguments**
    - `draws`: how many, none twice. - `seed`: which.

    **Raises** `NoAnswerError` where there is no gear geometry, no constant backlash, fewer draws.

    For `sweep(…, rigs=rig_draws(posterior, 200), believed=fit.eccentricities())`.
    """
    fit = posterior.fit
    require_rig(fit)
    there = len(posterior.flat)
    if draws > there:
        raise NoAnswerError(
            f"{draws} draws are asked for, but the posterior holds {there}; sample longer.",
            where=fit.source,
        )
    chosen = np.sort(np.random.default_rng(seed).choice(there, draws, replace=False))
    offsets = [_offset(posterior, shaft)[chosen] for shaft in ("driving", "driven")]
    gaps = posterior.values("constant_backlash")[chosen] / DEG
    return tuple(
        Eccentricities(
            abs(driving), np.angle(driving, deg=True), abs(driven), np.angle(driven, deg=True), gap
        )
        for driving, driven, gap in zip(*offsets, gaps, strict=True)
    )


def _offset(posterior: Posterior, shaft: str) -> np.ndarray:
    """e·exp(jθ) of every draw, mm."""
    if not posterior.fit.parameters[f"{shaft}_eccentricity_mm"].determined:
        return np.zeros(len(posterior.flat), complex)
    return posterior.values(f"{shaft}_x") + 1j * posterior.values(f"{shaft}_y")
