"""Convergence of the ensembles: autocorrelation time, rank-normalised split R-hat, verdict."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import special, stats
from scipy.fft import next_fast_len

from .stop_rule import BURN_IN, Until, steps_needed

WINDOW = 5.0
"""Sums are cut at the first lag of at least so many autocorrelation times (Sokal)."""


def autocorrelation_time(
    draws: Float[np.ndarray, "steps walkers d"],
) -> Float[np.ndarray, " d"]:
    """Integrated autocorrelation time τ of each coordinate of one ensemble, in steps.

        τ = 1 + 2 Σ ρ(k),  k = 1 … M,  M the first lag ≥ 5 τ(M),

    with ρ the autocorrelation averaged over the walkers (Goodman and Weare; Sokal), taken about the
    mean of the whole ensemble. About the mean of each walker a walker that never moves away would
    look like one that mixes at once; about the common mean its correlation does not decay, and τ
    grows with the chain. A coordinate that does not move at all has τ = `steps`.

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
    found = np.take_along_axis(sums, window[:, None], axis=1)[:, 0]
    still = variance[:, 0] <= 0
    return np.where(still | ~np.isfinite(found), float(steps), found)


def _autocovariance(series: Float[np.ndarray, "steps walkers"]) -> Float[np.ndarray, " steps"]:
    """Autocovariance summed over the walkers, by FFT; zeros behind keep the ends apart."""
    steps = len(series)
    length = next_fast_len(2 * steps, real=True)
    # Transposed so that the FFT runs along contiguous memory.
    spectrum = np.fft.rfft(np.ascontiguousarray((series - series.mean()).T), n=length, axis=1)
    power = (spectrum.real**2 + spectrum.imag**2).sum(0)
    return np.fft.irfft(power, n=length)[:steps]


def r_hat(draws: Float[np.ndarray, "ensembles steps walkers d"]) -> Float[np.ndarray, " d"]:
    """R-hat of each coordinate between ensembles (Vehtari et al. 2021): larger of bulk and folded.

        R̂ = √[((n − 1)/n · W + B/n) / W]

    on normal scores of the ranks (bulk) and of |x − median| (folded); a group is one half in time
    of one ensemble with all its walkers, B/n the variance of the group means, W the mean variance
    inside a group. The walkers of an ensemble are proposed from each other, so that all of them can
    miss the same half of a posterior and still agree; only ensembles that never met can tell.

    Correlation over steps leaves W as it is and adds to B the error of a mean of n/τ draws, which
    makes R-hat larger, never smaller: at 50 τ and 64 walkers by less than 0.001, so that draws
    need no thinning by τ here. A middle step that is left over is dropped. A coordinate that is
    constant has R-hat 1 where all ensembles agree, else infinity.

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
    return np.array([_one(groups[:, :, axis]) for axis in range(draws.shape[3])])


def _one(groups: Float[np.ndarray, "groups n"]) -> float:
    folded = np.abs(groups - np.median(groups))
    return max(_split(_normal_scores(groups)), _split(_normal_scores(folded)))


def _normal_scores(values: Float[np.ndarray, "groups n"]) -> Float[np.ndarray, "groups n"]:
    """Quantiles of the normal distribution at the ranks (Blom), so that heavy tails do no harm."""
    ranks = stats.rankdata(values, method="average").reshape(values.shape)
    return special.ndtri((ranks - 0.375) / (values.size + 0.25))


def _split(groups: Float[np.ndarray, "groups n"]) -> float:
    count = groups.shape[1]
    within = groups.var(axis=1, ddof=1).mean()
    between = groups.mean(axis=1).var(ddof=1)
    if (groups == groups[:, :1]).all():  # by value: a variance of rounding errors is not zero
        return 1.0 if (groups == groups[0, 0]).all() else float("inf")
    return float(np.sqrt((count - 1) / count + between / within))


_TIME_POINTS = 4096
_RANK_POINTS = 400  # steps an ensemble: ranks are sorted, and 400 × 64 draws fix R-hat to 0.001


@dataclass(frozen=True)
class Diagnosis:
    """Convergence of several ensembles.

    **Arguments**
    - `tau`: integrated autocorrelation time of each coordinate in steps, averaged over ensembles.
    - `shortest`: steps after burn-in over the largest `tau`.
    - `r_hat`: rank-normalised split R-hat between ensembles, each coordinate.
    - `acceptance`: accepted share of all proposals.
    - `effective`: effective draws of each coordinate, all ensembles together.
    - `steps`: steps made by every ensemble; `until`: the rule that was asked for.
    """

    names: tuple[str, ...]
    tau: Float[np.ndarray, " d"]
    shortest: float
    r_hat: Float[np.ndarray, " d"]
    acceptance: float
    effective: Float[np.ndarray, " d"]
    steps: int
    until: Until

    @property
    def long_enough(self) -> bool:
        """Whether the shortest chain has the autocorrelation times asked for."""
        return self.shortest >= self.until.autocorrelation_times

    @property
    def agreed(self) -> bool:
        """Whether the ensembles agree in every coordinate."""
        return bool((self.r_hat <= self.until.r_hat).all())

    @property
    def converged(self) -> bool:
        """Whether the draws can be trusted: long chains that agree."""
        return self.long_enough and self.agreed

    @property
    def needed(self) -> int:
        """Steps, burn-in included, that make the chains long enough by what is known now."""
        return steps_needed(float(self.tau.max()), self.until)

    def __str__(self) -> str:
        slowest, apart = (self.names[int(np.argmax(x))] for x in (self.tau, self.r_hat))
        length = f"shortest chain {_down(self.shortest)} τ"
        if not self.long_enough:
            length += f" (`{slowest}`), {self.until.autocorrelation_times:g} asked for"
        agreement = f"R-hat {_up(float(self.r_hat.max()))}"
        if not self.agreed:
            agreement += f" (`{apart}`), at most {self.until.r_hat:g} asked for"
        accepted = f"acceptance {self.acceptance:.2f}"
        cure = "" if self.converged else f"; {self._cure()}"
        return f"converged: {'yes' if self.converged else 'no'}; {length}; {agreement}; " + (
            accepted + cure
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
        """The numbers by name of the coordinate; not finite ones become null when written."""

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
) -> Diagnosis:
    """Judge the stored draws of several ensembles, burn-in included (it is left out here).

    Long chains are read at no more than 4096 evenly spaced steps for τ, 400 for R-hat; a τ below
    that spacing is given as the spacing, so that no more effective draws are claimed than read.
    """
    after = draws[:, burn_in(draws.shape[1]) :]
    kept = after.shape[1]
    stride = max(1, math.ceil(kept / _TIME_POINTS))
    times = [autocorrelation_time(ensemble[::stride]) for ensemble in after]
    tau = np.maximum(np.mean(times, axis=0), 1.0) * (stride * thin)
    length = kept * thin
    return Diagnosis(
        names=names,
        tau=tau,
        shortest=float(length / tau.max()),
        r_hat=r_hat(after[:, :: max(1, kept // _RANK_POINTS)]),
        acceptance=acceptance,
        effective=draws.shape[0] * draws.shape[2] * length / tau,
        steps=steps,
        until=until,
    )


def burn_in(kept: int) -> int:
    """How many of the stored steps are discarded: the first quarter."""
    return int(BURN_IN * kept)


def _down(number: float) -> str:
    return str(math.floor(number))  # 49.9 of 50 must not read 50


def _up(number: float) -> str:
    return f"{math.ceil(round(number * 1000, 6)) / 1000:.3f}" if math.isfinite(number) else "∞"
