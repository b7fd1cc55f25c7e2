"""Rigs like a fitted one, in its motion and its noise: truths and rows drawn from its posterior."""

from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from ...model.columns import DELAY, GROUPS
from ...model.density import LAGS, whitening
from ...model.functionals import Posterior
from ...model.gears import Gears, fitted_gears
from ...model.mixed_fit import MixedFit, largest, residuals
from ...model.problem import problem_of
from ...model.rows import Rows
from ...pair.gear_pair import Drive, GearPair

OF_A_LOG = ("drift", "delay_parts")
"""Groups of coefficients that belong to a recording and not to the rig: drawn anew from their prior
at the fitted width. All others are drawn from their posterior."""

_FORGOTTEN = 2000
"""Rows after which noise has forgotten how it began (chosen)."""


@dataclass(frozen=True, eq=False)
class LikeRigs:
    """Rigs like that of a fit, with its columns, noise and coefficients.

    A rig has coefficients β ~ N(β̂, M⁻¹); those of drift and of the parts of the delay are new,
    β ~ N(0, τ²). Of gears first eccentricities and encoder errors are drawn, and the first orders
    follow through the exact relation. Its rows are y = X β + n with noise n of the fitted θ.
    """

    fit: MixedFit
    pair: GearPair | Drive
    kinds: tuple[str, ...]

    @cached_property
    def _tied(self) -> tuple[Gears, Float[np.ndarray, "p p"]] | None:
        """The fitted gears with the factor of their covariance; None without gears."""
        if not isinstance(self.pair, GearPair):
            return None
        gears = fitted_gears(self.pair, self.fit, self.kinds)
        if gears is None:
            return None
        covariance = self.fit.posterior.told(gears.rows, moved=True)[1]
        return gears, _root(covariance)

    @cached_property
    def _spread(self) -> Float[np.ndarray, "columns columns"]:
        """Factor of M⁻¹."""
        size = len(self.fit.posterior.problem.columns)
        return _root(np.asarray(self.fit.posterior.at.spread)[:size, :size])

    def drawn(self, generator: np.random.Generator) -> Float[np.ndarray, " columns"]:
        """Return the scaled coefficients β of a rig."""
        posterior, problem = self.fit.posterior, self.fit.posterior.problem
        size = len(problem.columns)
        beta = np.asarray(posterior.at.beta)[:size]
        beta = beta + self._spread @ generator.standard_normal(size)
        member = np.asarray(problem.compressed.member)[:size]
        for place, group in enumerate(GROUPS):
            own = member[:, place] > 0
            if group in OF_A_LOG and own.any():
                width = np.exp(posterior.theta[LAGS + 1 + place]) / np.sqrt(member[own, place])
                beta[own] = width * generator.standard_normal(own.sum())
        if self._tied is not None:
            gears, root = self._tied
            values = gears.values + root @ generator.standard_normal(len(root))
            places = gears.relation.tied_columns(problem.index)
            tied = np.asarray(_coefficients(gears.relation, jnp.asarray(values)))[: len(places)]
            scale = np.diag(problem.natural)[places]
            beta[places] = (tied / scale - problem.start[places]) / problem.unit
        return beta

    def truth(self, beta: Float[np.ndarray, " columns"]) -> MixedFit:
        """Return the fit as if its coefficients were those of a rig, exactly."""
        posterior = self.fit.posterior
        whole = jnp.asarray(posterior.at.beta).at[: len(beta)].set(jnp.asarray(beta))
        at = eqx.tree_at(lambda solved: solved.beta, posterior.at, whole)
        return replace(self.fit, posterior=replace(posterior, at=at))

    def refitted(
        self, beta: Float[np.ndarray, " columns"], generator: np.random.Generator
    ) -> MixedFit:
        """Return the fit of new rows of a rig in the same motion."""
        problem = self.fit.posterior.problem
        expected = problem.natural @ (problem.unit * beta + problem.start)
        left = residuals(problem.columns, self.fit.rows, expected)
        rows = tuple(
            self._noisy(one, one.table[:, -1] - off, generator)
            for one, off in zip(self.fit.rows, left, strict=True)
        )
        usual = np.asarray(problem.compressed.usual) * problem.unit
        new = problem_of(
            problem.columns,
            rows,
            None,
            centres={DELAY: self.fit.delay_s},
            usual=dict(zip(GROUPS, usual.tolist(), strict=True)),
        )
        found = largest(new.compressed)
        posterior = Posterior(new, np.asarray(found.value), found.aux)
        return replace(self.fit, rows=rows, posterior=posterior, weights=None)

    def _noisy(
        self, rows: Rows, mean: Float[np.ndarray, " n"], generator: np.random.Generator
    ) -> Rows:
        """Return rows whose readings are `mean` plus new noise, independent in every run."""
        posterior, table = self.fit.posterior, rows.table.copy()
        taps, std = np.asarray(whitening(posterior.partial)), posterior.innovation_std
        for first, last in zip(rows.first, rows.last, strict=True):
            white = std * generator.standard_normal(last - first + 1 + _FORGOTTEN)
            noise = np.asarray(lfilter([1.0], taps, white))[_FORGOTTEN:]
            table[first : last + 1, -1] = mean[first : last + 1] + noise
        return replace(rows, table=table)


@eqx.filter_jit
def _coefficients(relation, values):
    return relation.coefficients(values)


def _root(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Return a matrix whose product with its transpose is a covariance."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, axes = np.linalg.eigh(covariance / scale / scale[:, None])
    return scale[:, None] * axes * np.sqrt(np.maximum(values, 0.0))
