"""Stop rule at fixed step numbers: a resumed run stops at the same step as an uninterrupted one."""

import math
from dataclasses import dataclass

BLOCK_STEPS = 200
"""Number of steps in a block (chosen).

Progress, checkpoints and interrupts are handled between blocks."""

BURN_IN = 0.25
"""Fraction of a chain that is discarded if it did not start in the posterior (chosen)."""

_FIRST_DECISION = 1000  # steps before the first diagnosis (chosen)
_GROWTH = 1.2  # ratio of the steps of two diagnoses, each of which reads the whole chain (chosen)


@dataclass(frozen=True)
class Until:
    """Stop rule: sampling ends when the chains are long enough and the ensembles agree.

    **Arguments**
    - `autocorrelation_times`: required length of the shortest chain after burn-in, in τ.
    - `r_hat`: largest accepted R-hat between ensembles, for every coordinate.
    - `most_steps`: number of steps at which sampling ends even without convergence.

    **Raises** `ValueError` that names the argument.
    """

    autocorrelation_times: float = 50.0
    r_hat: float = 1.01
    most_steps: int = 50_000

    def __post_init__(self):
        if not 0 < self.autocorrelation_times < math.inf:
            raise ValueError(
                "Argument `autocorrelation_times` must be positive, but is"
                f" {self.autocorrelation_times!r}."
            )
        if not 1 < self.r_hat < math.inf:
            raise ValueError(f"Argument `r_hat` must be above 1, but is {self.r_hat!r}.")
        if self.most_steps < BLOCK_STEPS:
            raise ValueError(
                f"Argument `most_steps` must be at least {BLOCK_STEPS}, but is {self.most_steps!r}."
            )


def next_decision(steps: int) -> int:
    """Return the first step number after `steps` at which a run may stop.

    **Example**
    ```python
    >>> from vttig_jax.posterior.sampling.stop_rule import next_decision
    >>> [next_decision(steps) for steps in (0, 1000, 1200)]
    [1000, 1200, 1600]

    ```
    """
    decision = _FIRST_DECISION
    while decision <= steps:
        decision = math.ceil(round(_GROWTH * decision / BLOCK_STEPS, 6)) * BLOCK_STEPS
    return decision


def steps_needed(tau: float, until: Until, burn_in: float = BURN_IN) -> int:
    """Return the number of steps, burn-in included, that `until` requires.

    `tau` is the autocorrelation time in steps, and `burn_in` is the fraction of the steps that is
    discarded. Return 0 if the number is not finite.
    """
    needed = until.autocorrelation_times * tau / (1 - burn_in)
    return math.ceil(needed / BLOCK_STEPS) * BLOCK_STEPS if math.isfinite(needed) else 0
