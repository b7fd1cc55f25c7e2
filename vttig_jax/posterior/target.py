"""The density that emcee samples: the one log density of a fit, at its free coordinates.

θ are the noise and the prior scales; all linear coefficients are integrated out. Where a relation
ties coefficients, c_T = h(p), its parameters p are sampled too. With β̂ and V the mean and the
covariance of c_T given θ, exactly

    ln p(θ, p | log) = ln p(θ | log) + ln N(h(p); β̂, V)

since the density of the tied coefficients given θ is that normal.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.columns import GROUPS
from ..model.density import LAGS, Compressed, Normal, log_density, normal
from ..model.functionals import Posterior
from ..model.gears import Relation
from ..model.parameters import Quantities
from .proposal import Proposal

NOISE = (*(f"atanh_partial_{k}" for k in range(1, LAGS + 1)), "log_innovation_std")
"""Names of the coordinates of the noise."""

WIDTHS = tuple(f"log_width_{group}" for group in GROUPS)
"""Names of the coordinates of the prior scales."""

BATCH = 16
"""Points of one call of the compiled density: half of the walkers, so that one program serves."""


class Tie(eqx.Module):
    """Relation c_T = h(p) that ties coefficients.

    **Arguments**
    - `relation`: its `coefficients` are h(p), rad; further values of it are ignored.
    - `rows`: matrix from the scaled coefficients β to c_T. - `start`: c_T at β = 0.
    - `values`, `spread`: p of the fit and its covariance. - `units`: of p.
    """

    relation: Relation
    rows: Float[Array, "t columns"]
    start: Float[Array, " t"]
    values: Float[Array, " p"]
    spread: Float[Array, "p p"]
    units: tuple[str, ...] = eqx.field(static=True)

    def tied(self, parameters: Float[Array, " p"]) -> Float[Array, " t"]:
        """Return c_T of these parameters."""
        return self.relation.coefficients(parameters)[: len(self.start)]

    def given(self, one: Normal) -> tuple[Float[Array, " t"], Float[Array, "columns t"]]:
        """Return the mean of c_T given θ, and L⁻¹ S `rows`ᵀ, whose Gram matrix is V."""
        half = jax.scipy.linalg.solve_triangular(
            one.factor, one.scale[:, None] * self.rows.T, lower=True
        )
        return self.start + half.T @ one.half, half


def joint_density(
    point: Float[Array, " d"],
    logs: Compressed,
    fill: Float[Array, " theta"],
    free: tuple[int, ...],
    tie: Tie | None,
) -> Float[Array, ""]:
    """Return ln p(θ, p | log) up to a constant; `fill` holds θ that is not `free`."""
    theta = fill.at[np.array(free)].set(point[: len(free)])
    one = normal(theta, logs)
    value = log_density(theta, logs, one)
    if tie is None:
        return value
    mean, half = tie.given(one)
    scale = jnp.sqrt(jnp.sum(half**2, axis=0))
    factor = jnp.linalg.cholesky(
        (half / scale[None]).T @ (half / scale[None]) + 1e-12 * jnp.eye(len(scale))
    )
    off = (tie.tied(point[len(free) :]) - mean) / scale
    white = jax.scipy.linalg.solve_triangular(factor, off, lower=True)
    logdet = jnp.sum(jnp.log(jnp.diag(factor))) + jnp.sum(jnp.log(scale))
    return value - 0.5 * white @ white - logdet


def batched(function: Callable, *parts: np.ndarray) -> Any:
    """Return what a compiled function gives for all rows of `parts`, `BATCH` rows in a call.

    The last row is repeated to fill the last batch.
    """
    count = len(parts[0])
    places = np.minimum(np.arange(count + -count % BATCH), count - 1).reshape(-1, BATCH)
    found = [function(*(part[own] for part in parts)) for own in places]
    return jax.tree.map(lambda *pieces: np.concatenate(pieces)[:count], *found)


@eqx.filter_jit
def _values(points, logs, fill, free, tie):
    return jax.vmap(partial(joint_density, logs=logs, fill=fill, free=free, tie=tie))(points)


@dataclass(frozen=True, eq=False)
class FitTarget:
    """Density of a fit for `run_ensembles`: θ of the groups in the model, then p of a `tie`.

    **Arguments**
    - `posterior`: largest density of the fit and its Hessian. - `told`: quantities of the fit.
    - `data`: digest of the logs. - `tie`: relation whose parameters are sampled, or None.
    """

    posterior: Posterior
    told: Quantities
    data: str
    tie: Tie | None = None

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Places of the sampled coordinates in θ."""
        on = np.asarray(self.posterior.problem.compressed.on) > 0
        return (*range(LAGS + 1), *(LAGS + 1 + np.flatnonzero(on)).tolist())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        noise = (*NOISE, *WIDTHS)
        return (*(noise[k] for k in self.free), *(self.tie.relation.names if self.tie else ()))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates."""
        kinds = ("1",) * LAGS + ("log rad",) * (1 + len(GROUPS))
        return (*(kinds[k] for k in self.free), *(self.tie.units if self.tie else ()))

    @property
    def identity(self) -> dict:
        """What tells this density from another one."""
        columns = self.posterior.problem.columns
        return {
            "data": self.data,
            "columns": [str(column.name) for column in columns],
            "priors": [f"{column.prior} {column.width:.6g}" for column in columns],
        }

    @cached_property
    def logs(self) -> Compressed:
        """The compressed logs without padding: a batch of small matrices is dear by its size."""
        logs, size = self.posterior.problem.compressed, len(self.posterior.problem.columns)
        kept = np.append(np.arange(size), len(logs.precision))
        return replace(
            logs,
            windows=jnp.asarray(np.asarray(logs.windows)[:, kept[:, None], kept]),
            member=logs.member[:size],
            precision=logs.precision[:size],
            centre=logs.centre[:size],
        )

    def thetas(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n p"]:
        """Return the whole θ of points; a group that is not in the model has that of the fit."""
        thetas = np.repeat(self.posterior.theta[None], len(points), axis=0)
        thetas[:, self.free] = points[:, : len(self.free)]
        return thetas

    def log_density(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Return the log density of points, −inf where the matrix of the log is not positive."""
        fill = jnp.asarray(self.posterior.theta)
        values = batched(lambda part: _values(part, self.logs, fill, self.free, self.tie), points)
        return np.where(np.isnan(values), -np.inf, values)

    def around(self) -> Proposal:
        """Return the proposal around the fit (Laplace), improved by weighted draws."""
        posterior, size = self.posterior, len(self.free)
        mean, spread = posterior.theta[list(self.free)], np.zeros((len(self.names),) * 2)
        spread[:size, :size] = posterior.theta_spread[np.ix_(self.free, self.free)]
        if self.tie is not None:
            mean = np.concatenate([mean, self.tie.values])
            spread[size:, size:] = self.tie.spread
        heavy = [name in WIDTHS for name in self.names]
        return Proposal.of(mean, spread, np.array(heavy)).improved(self.log_density)
