"""Convergence of the ensembles: autocorrelation time, rank-normalised split R-hat, diagnosis."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import special, stats

from .until import BLOCK_STEPS, Until

BURN_IN = 0.2
"""Share of every chain that is discarded: the walkers start at weighted draws, not exact ones."""

_WINDOW = 5.0
"""The sum of the autocorrelations ends at the first lag of at least this many τ (rule of Sokal)."""

_POINTS = 800
"""Most stored steps of an ensemble that a diagnosis reads."""


def autocorrelation_time(
    draws: Float[np.ndarray, "steps walkers d"],
) -> Float[np.ndarray, " d"]:
    """Return the integrated autocorrelation time τ of each coordinate of one ensemble, in steps.

        τ = 1 + 2 Σ ρ(k),  k = 1 … M,  M the first lag ≥ 5 τ(M),

    Here ρ is the autocorrelation averaged over the walkers (Goodman and Weare; Sokal), about the
    mean of the whole ensemble. `emcee.autocorr` takes the mean of each walker, so that walkers that
    stay in different places seem to mix at once. About the common mean their autocorrelation does
    not decay, and τ grows with the chain. A coordinate that does not move has τ = `steps`.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior import autocorrelation_time
    >>> noise = np.random.default_rng(0).standard_normal((4000, 64, 1))
    >>> print(np.round(autocorrelation_time(noise), 1))
    [1.]

    ```
    """
    steps, _, size = draws.shape
    found = np.full(size, float(steps))
    for axis in range(size):
        series = draws[:, :, axis] - draws[:, :, axis].mean()
        length = 2 ** int(np.ceil(np.log2(2 * steps)))
        power = np.sum(np.abs(np.fft.rfft(series.T, length, axis=1)) ** 2, axis=0)
        covariance = np.fft.irfft(power, length)[:steps]
        if covariance[0] > 0:
            sums = 2 * np.cumsum(covariance / covariance[0]) - 1
            enough = np.arange(steps) >= _WINDOW * sums
            found[axis] = sums[enough.argmax() if enough.any() else -1]
    return found


def r_hat(draws: Float[np.ndarray, "ensembles steps walkers d"]) -> Float[np.ndarray, " d"]:
    """Return R-hat of each coordinate between ensembles (Vehtari et al. 2021).

        R̂ = √[((n − 1)/n · W + B/n) / W]

    It is the larger of two values: one from the normal scores of the ranks of x (bulk), one from
    those of |x − median| (folded). The n draws of all walkers of one ensemble in the first or in
    the second half of the steps are one group. B/n is the variance of the group means, and W is the
    mean variance inside a group. The proposals of a walker depend on the other walkers of its
    ensemble, so all of them can miss the same half of a posterior and still agree. Only independent
    ensembles show this. A constant coordinate has R-hat 1 if all ensembles agree, else infinity.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior import r_hat
    >>> draws = np.random.default_rng(0).standard_normal((4, 100, 64, 1))
    >>> print(np.round(r_hat(draws), 2))
    [1.]
    >>> draws[0] += 1.0  # an ensemble elsewhere
    >>> print(np.round(r_hat(draws), 1))
    [1.1]

    ```
    """
    half = draws.shape[1] // 2
    halves = np.concatenate([draws[:, :half], draws[:, draws.shape[1] - half :]])
    groups = halves.reshape(len(halves), -1, draws.shape[3])
    found = []
    for values in np.moveaxis(groups, 2, 0):
        folded = np.abs(values - np.median(values))
        found.append(max(_split_r_hat(_scores(x)) for x in (values, folded)))
    return np.array(found)


def _scores(values: Float[np.ndarray, "groups n"]) -> Float[np.ndarray, "groups n"]:
    """Return the normal quantiles of the ranks (Blom), which limit the effect of heavy tails."""
    ranks = stats.rankdata(values, method="average").reshape(values.shape)
    return special.ndtri((ranks - 0.375) / (values.size + 0.25))


def _split_r_hat(groups: Float[np.ndarray, "groups n"]) -> float:
    if (groups == groups[:, :1]).all():  # rounding can make the variance of equal values nonzero
        return 1.0 if (groups == groups[0, 0]).all() else math.inf
    count = groups.shape[1]
    within, between = groups.var(axis=1, ddof=1).mean(), groups.mean(axis=1).var(ddof=1)
    return float(np.sqrt((count - 1) / count + between / within))


@dataclass(frozen=True)
class Diagnosis:
    """Convergence of several ensembles.

    **Arguments**
    - `tau`: integrated autocorrelation time of each coordinate in steps, mean of the ensembles.
    - `r_hat`: rank-normalised split R-hat of each coordinate between ensembles.
    - `effective`: effective number of draws of each coordinate, all ensembles together.
    - `acceptance`: accepted share of all proposals.
    - `steps`: steps made by every ensemble; `until`: stop rule of the run.
    """

    names: tuple[str, ...]
    tau: Float[np.ndarray, " d"]
    r_hat: Float[np.ndarray, " d"]
    effective: Float[np.ndarray, " d"]
    acceptance: float
    steps: int
    until: Until

    @property
    def long_enough(self) -> bool:
        """Whether every coordinate has the required number of effective draws."""
        return bool(self.effective.min() >= self.until.effective)

    @property
    def agreed(self) -> bool:
        """Whether the ensembles agree in every coordinate."""
        return bool((self.r_hat <= self.until.r_hat).all())

    @property
    def converged(self) -> bool:
        """Whether there are enough effective draws and the ensembles agree."""
        return self.long_enough and self.agreed

    @property
    def needed(self) -> int:
        """Number of steps at which there are enough effective draws, at the present rate.

        A chain that has not seen its slowest parts often states a rate that is too high.
        """
        share = self.until.effective / self.effective.min()
        return math.ceil(self.steps * share / BLOCK_STEPS) * BLOCK_STEPS

    def __str__(self) -> str:
        slowest, farthest = (self.names[int(np.argmax(x))] for x in (self.tau, self.r_hat))
        length = f"{self.effective.min():.0f} effective draws"
        if not self.long_enough:
            length += f" (`{slowest}`), {self.until.effective:g} asked for"
        apart = float(self.r_hat.max())
        shown = f"{math.ceil(round(apart * 1000, 6)) / 1000:.3f}" if math.isfinite(apart) else "∞"
        agreement = f"R-hat {shown}"
        if not self.agreed:
            agreement += f" (`{farthest}`), at most {self.until.r_hat:g} asked for"
        accepted = f"acceptance {self.acceptance:.2f}"
        cure = "" if self.converged else f"; {self._cure()}"
        verdict = "yes" if self.converged else "no"
        return f"converged: {verdict}; {length}; {agreement}; {accepted}{cure}"

    @property
    def warning(self) -> str:
        """Sentence on what draws that have not converged mean for a user; "" for converged ones."""
        if self.converged:
            return ""
        return (
            "not converged: these draws do not represent the posterior yet, so their means and"
            " intervals may be wrong; the fit that they start from does not depend on them;"
            f" {self._cure()}"
        )

    def _cure(self) -> str:
        goal = 2 * self.steps if self.long_enough else max(self.needed, self.steps + BLOCK_STEPS)
        reason = "the ensembles hold different parts of the posterior: " * self.long_enough
        return f"{reason}go on with --resume and at least --steps {goal}"

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of the diagnosis, with the values of coordinates by their names.

        NaN and infinity are written as null.
        """

        def by_name(values: np.ndarray) -> dict[str, float]:
            return dict(zip(self.names, values.tolist(), strict=True))

        return {
            "converged": self.converged,
            "steps": self.steps,
            "shortest_chain_tau": float(self.steps * (1 - BURN_IN) / self.tau.max()),
            "acceptance": self.acceptance,
            "autocorrelation_steps": by_name(self.tau),
            "r_hat": by_name(self.r_hat),
            "effective_draws": by_name(self.effective),
            "asked": {"effective_draws": self.until.effective, "r_hat": self.until.r_hat},
        }


def after_burn_in(draws: np.ndarray) -> np.ndarray:
    """Return the stored steps (second axis) after the burn-in."""
    return draws[:, int(BURN_IN * draws.shape[1]) :]


def diagnose(
    draws: Float[np.ndarray, "ensembles stored walkers d"],
    names: tuple[str, ...],
    *,
    steps: int,
    acceptance: float,
    until: Until,
) -> Diagnosis:
    """Return the diagnosis of the stored draws of several ensembles, which made `steps` steps.

    From long chains evenly spaced steps are read. A τ below the spacing is set to the spacing, so
    that the effective draws are not more than those read.
    """
    chains = after_burn_in(draws)
    stride = -(-chains.shape[1] // _POINTS)
    chains = chains[:, ::stride]
    spacing = stride * steps / draws.shape[1]
    times = np.mean([autocorrelation_time(one) for one in chains], axis=0)
    tau = np.maximum(times, 1.0)
    count = chains.shape[0] * chains.shape[1] * chains.shape[2]
    return Diagnosis(names, tau * spacing, r_hat(chains), count / tau, acceptance, steps, until)
