"""Backlash readings at single driving angles: a check of a fit, or further data for it.

For a reading, gear 1 is held and gear 2 is turned from one flank to the other: r = TE_B − TE_A at
one driving angle, plus a scatter σ. As data the readings condition the coefficients b of the fit,

    K = P Cᵀ (C P Cᵀ + σ² 1)⁻¹,    b ← b + K (r − C b),    P ← P − K C P.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.errors import UsageError
from ..base.units import DEG
from ..logs.readers.backlash_readings import BacklashReadings
from ..model.mixed_fit import MixedFit
from ..model.parameters import gap_row
from .fit_settings import FitSettings
from .records import ReadingsComparison

_SPAN = 1e-9


def _rows(core: MixedFit, readings: BacklashReadings) -> Float[np.ndarray, "n columns"]:
    if ("gap",) not in core.posterior.problem.index:
        raise UsageError(
            "backlash readings compare with the gap between two flanks, but the log has one; record"
            " both directions.",
            where=readings.source,
        )
    angles = readings.driving_angle
    return np.stack([gap_row(core, angles[k : k + 1]) for k in range(len(angles))])


def compared(
    core: MixedFit, readings: BacklashReadings, settings: FitSettings
) -> ReadingsComparison:
    """Compare readings with the gap that a fit predicts at their angles."""
    rows = _rows(core, readings)
    mean = rows.mean(0)
    off = (readings.backlash - rows @ core.posterior.moved) / DEG
    worst = int(np.argmax(np.abs(off)))
    return ReadingsComparison(
        source=readings.source,
        sha256=readings.sha256,
        count=len(off),
        rms_deg=float(np.sqrt(np.mean(off**2))),
        mean_deg=float(off.mean()),
        scatter_deg=float(off.std()),
        largest_deg=float(off[worst]),
        largest_at_deg=float(readings.driving_angle[worst]) / DEG,
        expected_std_deg=core.posterior.one(mean, moved=True).std / DEG,
        used=settings.use_readings,
    )


def updated(core: MixedFit, readings: BacklashReadings) -> MixedFit:
    """Return the fit with the readings as further data; their scatter is that about the fit."""
    posterior, problem = core.posterior, core.posterior.problem
    size = len(problem.columns)
    rows = _rows(core, readings) * np.diag(problem.natural)
    off = readings.backlash - rows @ (
        problem.unit * np.asarray(posterior.at.beta)[:size] + problem.start
    )
    spread = np.asarray(posterior.at.spread)
    wide = np.zeros((len(rows), len(spread)))
    wide[:, :size] = rows
    held = spread @ wide.T
    scatter = max(float(np.var(off)), _SPAN * float(np.mean(readings.backlash**2)))
    gain = np.linalg.solve(wide @ held + scatter / problem.unit**2 * np.eye(len(rows)), held.T).T
    at = eqx.tree_at(
        lambda s: (s.beta, s.spread),
        posterior.at,
        (
            jnp.asarray(np.asarray(posterior.at.beta) + gain @ off / problem.unit),
            jnp.asarray(spread - gain @ held.T),
        ),
    )
    return replace(core, posterior=replace(posterior, at=at))
