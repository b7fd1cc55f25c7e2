"""Start angles of logs whose zeros differ: their derivatives become columns."""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .columns import DELAY, GAP, GROUPS, Column, ColumnName
from .density import normal
from .functionals import Posterior
from .mixed_fit import MixedFit
from .problem import problem_of
from .rows import SHAFTS, Extra, RowName, Rows, S, Shafts, Start, Wave


@dataclass(frozen=True, eq=False)
class Turns(Extra):
    """Derivatives of logs by their start angles, whose columns belong to the model.

    The harmonic C cos ψ + S sin ψ with ψ = n₁(φ₁ + a₁) + n₂(φ₂ + a₂) has the derivatives
    n (S cos ψ − C sin ψ) by a₁ and a₂. Only harmonics that a log shares count.

    **Arguments**
    - `waves`: harmonic → S and C of both flanks (mean and difference), rad.
    """

    waves: dict[Wave, Float[np.ndarray, "2 2"]]

    @classmethod
    def of(cls, fit: MixedFit) -> "Turns":
        """Return the derivatives at the harmonics that a fit has for its first log."""
        index, found = fit.posterior.problem.index, fit.posterior.coefficients
        both = (False, True) if GAP in index else (False,)
        waves = {}
        for wave in fit.waves:
            rows = wave.row("sin"), wave.row("cos")
            places = [[index[ColumnName(row, 0, differs)] for differs in both] for row in rows]
            waves[wave] = found[np.array(places)]
        return cls(waves)

    def with_derivatives(self, shafts: Shafts, rows: Rows, delay_s: float) -> Rows:
        """Return the rows with the derivatives as columns."""
        slopes = np.zeros((2, len(rows.table)))
        s = np.where(rows.flank == "A", S["A"], S["B"])
        sides = np.stack([np.ones(len(rows.table)), s])
        for wave, series in self.waves.items():
            if shafts.start.tells(wave):
                sine, cosine = series @ sides[: series.shape[1]]
                cos, sin = (rows.column(wave.row(part)) for part in ("cos", "sin"))
                slopes += np.outer((wave.driving, wave.driven), sine * cos - cosine * sin)
        names = [RowName("start", shaft) for shaft in SHAFTS]
        return rows.with_columns(dict(zip(names, slopes, strict=True)))


def start_of(fit: MixedFit, log: int) -> Start:
    """Return the start of a log after the steps of a fit."""
    start, posterior = fit.shafts[log].start, fit.posterior
    angles, spread = list(start.angles), list(start.spread)
    for place, shaft in enumerate(SHAFTS):
        if (name := ColumnName(RowName("start", shaft), log)) in posterior.problem.index:
            step = posterior.one(posterior.row(name))
            angles[place] += step.value
            spread[place] = step.std
    return Start((angles[0], angles[1]), (spread[0], spread[1]))


def alone(fit: MixedFit) -> MixedFit:
    """Return a fit whose logs have harmonics of their own, at the noise and widths of `fit`."""
    posterior, logs = fit.posterior, range(len(fit.rows))
    columns: list[Column] = []
    for column in posterior.problem.columns:
        of_wave = column.row.part is not None
        columns += [replace(column, logs=(log,)) for log in logs] if of_wave else [column]
    old = posterior.problem.compressed
    usual = np.asarray(old.usual) * posterior.problem.unit
    problem = problem_of(
        tuple(columns),
        fit.rows,
        fit.weights,
        centres={DELAY: fit.delay_s},
        usual=dict(zip(GROUPS, usual.tolist(), strict=True)),
        memory=np.asarray(old.memory),
    )
    theta = posterior.theta.copy()
    theta[len(old.memory) :] += np.log(posterior.problem.unit / problem.unit)
    given = normal(jnp.asarray(theta), problem.compressed)
    at = replace(posterior.at, beta=given.solved(given.half), spread=given.spread)
    return replace(fit, posterior=Posterior(problem, theta, at))
