"""Convergence of the ensembles: autocorrelation time, rank-normalised split R-hat, diagnosis."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import special, stats
from scipy.fft import next_fast_len

from .stop_rule import BURN_IN, Until, steps_needed

WINDOW = 5.0
"""The sum of the autocorrelations ends at the first lag of at least this many τ (rule of Sokal)."""


def autocorrelation_time(
    draws: Float[np.ndarray, "steps walkers d"],
) -> Float[np.ndarray, " d"]:
    """Return the integrated autocorrelation time τ of each coordinate of one ensemble, in steps.

        τ = 1 + 2 Σ ρ(k),  k = 1 … M,  M the first lag ≥ 5 τ(M),

    Here ρ is the autocorrelation averaged over the walkers (Goodman and Weare; Sokal), about the
    mean of the whole ensemble. If each walker had a mean of its own, walkers that stay in different
    places would seem to mix at once. About the common mean their autocorrelation does not decay,
    and τ grows with the chain. A coordinate that does not move at all has τ = `steps`.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior import autocorrelation_time
    >>> noise = np.random.default_rng(0).standard_normal((4000, 64, 1))
    >>> print(np.round(autocorrelation_time(noise), 1))
    [1.]

    ```
    """
    steps = len(draws)
    covariance = np.stack([_autocovariance(draws[:, :, axis]) for axis in range(draws.shape[2])])
    variance = covariance[:, :1]
    with np.errstate(invalid="ignore", divide="ignore"):
        sums = 2 * np.cumsum(covariance / variance, axis=1) - 1
    long_enough = np.arange(steps) >= WINDOW * sums
    window = np.where(long_enough.any(1), long_enough.argmax(1), steps - 1)
    tau = np.take_along_axis(sums, window[:, None], axis=1)[:, 0]
    constant = variance[:, 0] <= 0
    return np.where(constant | ~np.isfinite(tau), float(steps), tau)


def _autocovariance(series: Float[np.ndarray, "steps walkers"]) -> Float[np.ndarray, " steps"]:
    """Return the sum over the walkers of their autocovariances, by lag, about the common mean.

    It is computed by FFT with zero padding.
    """
    steps = len(series)
    length = next_fast_len(2 * steps, real=True)
    # Transposed so that the FFT runs along contiguous memory.
    spectrum = np.fft.rfft(np.ascontiguousarray((series - series.mean()).T), n=length, axis=1)
    power = (spectrum.real**2 + spectrum.imag**2).sum(0)
    return np.fft.irfft(power, n=length)[:steps]


def r_hat(draws: Float[np.ndarray, "ensembles steps walkers d"]) -> Float[np.ndarray, " d"]:
    """Return R-hat of each coordinate between ensembles (Vehtari et al. 2021).

        R̂ = √[((n − 1)/n · W + B/n) / W]

    It is the larger of two values: one from the normal scores of the ranks of x (bulk), one from
    those of |x − median| (folded). The n draws of all walkers of one ensemble in the first or in
    the second half of the steps are one group. B/n is the variance of the group means, and W is the
    mean variance inside a group. The proposals of a walker depend on the other walkers of its
    ensemble, so all of them can miss the same half of a posterior and still agree. Only independent
    ensembles show this.

    Correlation between steps does not change W and adds to B the error of a mean of n/τ draws.
    This makes R-hat larger, never smaller: at 50 τ and 64 walkers by less than 0.001, so the draws
    are not thinned by τ here. If the number of steps is odd, the middle step is dropped. A constant
    coordinate has R-hat 1 if all ensembles agree, else infinity.

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
    return np.array([_r_hat_of_coordinate(groups[:, :, axis]) for axis in range(draws.shape[3])])


def _r_hat_of_coordinate(groups: Float[np.ndarray, "groups n"]) -> float:
    folded = np.abs(groups - np.median(groups))
    return max(_split_r_hat(_normal_scores(groups)), _split_r_hat(_normal_scores(folded)))


def _normal_scores(values: Float[np.ndarray, "groups n"]) -> Float[np.ndarray, "groups n"]:
    """Return the normal scores of the values: the normal quantiles of their ranks (Blom).

    They limit the effect of heavy tails.
    """
    ranks = stats.rankdata(values, method="average").reshape(values.shape)
    return special.ndtri((ranks - 0.375) / (values.size + 0.25))


def _split_r_hat(groups: Float[np.ndarray, "groups n"]) -> float:
    count = groups.shape[1]
    within = groups.var(axis=1, ddof=1).mean()
    between = groups.mean(axis=1).var(ddof=1)
    if (groups == groups[:, :1]).all():  # rounding can make the variance of equal values nonzero
        return 1.0 if (groups == groups[0, 0]).all() else float("inf")
    return float(np.sqrt((count - 1) / count + between / within))


_TIME_POINTS = 4096  # most steps of an ensemble from which τ is computed (chosen)
_RANK_POINTS = 400  # steps for R-hat, up to twice as many; 400 × 64 draws give it to 0.001 (chosen)


@dataclass(frozen=True)
class Diagnosis:
    """Convergence of several ensembles.

    **Arguments**
    - `tau`: integrated autocorrelation time of each coordinate in steps, mean of the ensembles.
    - `shortest`: steps after burn-in divided by the largest `tau`.
    - `r_hat`: rank-normalised split R-hat of each coordinate between ensembles; NaN if it was not
      computed, because the chains are too short anyway.
    - `acceptance`: accepted fraction of all proposals.
    - `effective`: effective number of draws of each coordinate, all ensembles together.
    - `steps`: steps made by every ensemble; `until`: stop rule of the run.
    - `burn_in`: fraction of the chain that was discarded.
    """

    names: tuple[str, ...]
    tau: Float[np.ndarray, " d"]
    shortest: float
    r_hat: Float[np.ndarray, " d"]
    acceptance: float
    effective: Float[np.ndarray, " d"]
    steps: int
    until: Until
    burn_in: float = BURN_IN

    @property
    def long_enough(self) -> bool:
        """Whether the shortest chain has the required number of autocorrelation times."""
        return self.shortest >= self.until.autocorrelation_times

    @property
    def compared(self) -> bool:
        """Whether R-hat was computed, so that the ensembles are compared with each other."""
        return not np.isnan(self.r_hat).any()

    @property
    def agreed(self) -> bool:
        """Whether the ensembles agree in every coordinate."""
        return bool((self.r_hat <= self.until.r_hat).all())

    @property
    def converged(self) -> bool:
        """Whether the chains are long enough and the ensembles agree."""
        return self.long_enough and self.agreed

    @property
    def needed(self) -> int:
        """Number of steps, burn-in included, after which the chains are long enough at this τ."""
        return steps_needed(float(self.tau.max()), self.until, self.burn_in)

    def __str__(self) -> str:
        slowest, farthest = (self.names[int(np.argmax(x))] for x in (self.tau, self.r_hat))
        length = f"shortest chain {_rounded_down(self.shortest)} τ"
        if not self.long_enough:
            length += f" (`{slowest}`), {self.until.autocorrelation_times:g} asked for"
        if not self.compared:
            return f"converged: no; {length}; acceptance {self.acceptance:.2f}"
        agreement = f"R-hat {_rounded_up(float(self.r_hat.max()))}"
        if not self.agreed:
            agreement += f" (`{farthest}`), at most {self.until.r_hat:g} asked for"
        accepted = f"acceptance {self.acceptance:.2f}"
        cure = "" if self.converged else f"; {self._cure()}"
        return f"converged: {'yes' if self.converged else 'no'}; {length}; {agreement}; " + (
            accepted + cure
        )

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
        if not self.long_enough:
            goal = max(self.needed, self.steps + 1)
            return f"go on with --resume and about --steps {goal} or a longer --until"
        return (
            "the ensembles hold different parts of the posterior: go on with --resume and"
            f" --steps {2 * self.steps} or a longer --until"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of the diagnosis, with the values of coordinates by their names.

        NaN and infinity are written as null.
        """

        def by_name(values: np.ndarray) -> dict[str, float]:
            return dict(zip(self.names, values.tolist(), strict=True))

        return {
            "converged": self.converged,
            "steps": self.steps,
            "shortest_chain_tau": self.shortest,
            "acceptance": self.acceptance,
            "autocorrelation_steps": by_name(self.tau),
            "r_hat": by_name(self.r_hat),
            "effective_draws": by_name(self.effective),
            "asked": {
                "autocorrelation_times": self.until.autocorrelation_times,
                "r_hat": self.until.r_hat,
            },
        }


def diagnose(
    draws: Float[np.ndarray, "ensembles kept walkers d"],
    names: tuple[str, ...],
    *,
    thin: int,
    steps: int,
    acceptance: float,
    until: Until,
    burn_in: float = BURN_IN,
    short_compared: bool = True,
) -> Diagnosis:
    """Return the diagnosis of the stored draws of several ensembles, without the burn-in.

    `draws` holds every `thin`-th of the `steps`. R-hat takes most of the time. If `short_compared`
    is False, it is not computed (NaN) for chains that are not long enough, because these have not
    converged anyway.

    From long chains, at most 4096 evenly spaced steps are used for τ and 400 to 800 for R-hat. A τ
    below the spacing is set to the spacing, so that the effective draws are not more than those
    used.
    """
    chains = draws[:, discarded(draws.shape[1], burn_in) :]
    kept = chains.shape[1]
    stride = max(1, math.ceil(kept / _TIME_POINTS))
    times = [autocorrelation_time(ensemble[::stride]) for ensemble in chains]
    tau = np.maximum(np.mean(times, axis=0), 1.0) * (stride * thin)
    length = kept * thin
    shortest = float(length / tau.max())
    agreement = np.full(len(tau), np.nan)
    if short_compared or shortest >= until.autocorrelation_times:
        agreement = r_hat(chains[:, :: max(1, kept // _RANK_POINTS)])
    return Diagnosis(
        names=names,
        tau=tau,
        shortest=shortest,
        r_hat=agreement,
        acceptance=acceptance,
        effective=draws.shape[0] * draws.shape[2] * length / tau,
        steps=steps,
        until=until,
        burn_in=burn_in,
    )


def discarded(kept: int, burn_in: float) -> int:
    """Return how many of `kept` stored steps are discarded: the fraction `burn_in`."""
    return int(burn_in * kept)


def _rounded_down(number: float) -> str:
    return str(math.floor(number))  # 49.9 must not be shown as the required 50


def _rounded_up(number: float) -> str:
    return f"{math.ceil(round(number * 1000, 6)) / 1000:.3f}" if math.isfinite(number) else "∞"
