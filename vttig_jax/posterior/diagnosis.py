"""Whether the ensembles have converged, in numbers and in one line."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from .autocorrelation import autocorrelation_time
from .r_hat import r_hat
from .stopping import BURN_IN, Until, steps_needed

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
