"""When sampling ends, and how far it is."""

import math
from dataclasses import dataclass

BLOCK_STEPS = 50
"""Steps between two looks at the chains. Progress, checkpoints and interrupts come there too."""


@dataclass(frozen=True)
class Until:
    """Stop rule: sampling ends when there are enough effective draws and the ensembles agree.

    **Arguments**
    - `effective`: effective draws of every coordinate, all ensembles together. With n of them a
      mean is known to 1/√n of its standard deviation, the end of a 95 % interval to 2.7/√n.
    - `r_hat`: largest R-hat between ensembles, for every coordinate (Vehtari et al. 2021).
    - `most_steps`: number of steps at which sampling ends even without convergence.

    **Raises** `ValueError` that names the argument.
    """

    effective: float = 1000.0
    r_hat: float = 1.01
    most_steps: int = 20_000

    def __post_init__(self):
        if not 0 < self.effective < math.inf:
            raise ValueError(f"Argument `effective` must be positive, but is {self.effective!r}.")
        if not 1 < self.r_hat < math.inf:
            raise ValueError(f"Argument `r_hat` must be above 1, but is {self.r_hat!r}.")
        if self.most_steps < BLOCK_STEPS:
            raise ValueError(
                f"Argument `most_steps` must be at least {BLOCK_STEPS}, but is {self.most_steps!r}."
            )


@dataclass(frozen=True)
class Progress:
    """State of a running sampler after a block of steps.

    **Arguments**
    - `steps`: steps made by every ensemble, including those before a resume.
    - `total`: requested number of steps; None while the stop rule decides.
    - `steps_per_s`: steps of every ensemble per second, in this session.
    - `remaining_s`: time to the end, s, at the present effective draws a step.
    - `diagnosis`: diagnosis as text.
    """

    steps: int
    total: int | None
    steps_per_s: float
    remaining_s: float
    diagnosis: str
