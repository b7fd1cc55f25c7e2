"""Progress of a running sampler, with the time to its likely end."""

from dataclasses import dataclass

from .convergence import Diagnosis
from .stop_rule import Until, next_decision


@dataclass(frozen=True)
class Progress:
    """State of a running sampler after a block of steps.

    **Arguments**
    - `steps`: steps made by every ensemble, including those before a resume.
    - `total`: requested number of steps; None while the stop rule decides.
    - `steps_per_s`: steps of every ensemble per second, in this session.
    - `remaining_s`: remaining time, s; if the stop rule decides, it follows from the present
      estimate of the autocorrelation time and is None before there is one.
    - `diagnosis`: latest diagnosis as text, "" before the first.
    """

    steps: int
    total: int | None
    steps_per_s: float
    remaining_s: float | None
    diagnosis: str


def progress_after(
    done: int, total: int | None, until: Until, diagnosis: Diagnosis | None, steps_per_s: float
) -> Progress:
    """Return the progress after `done` steps, with the time to `total` or to the likely stop."""
    goal = total
    if goal is None and diagnosis is not None:
        # The number of steps is unknown while the ensembles disagree.
        disagreed = diagnosis.compared and not diagnosis.agreed
        needed = until.most_steps if disagreed else diagnosis.needed
        goal = min(next_decision(max(needed, done) - 1), until.most_steps)
    return Progress(
        steps=done,
        total=total,
        steps_per_s=steps_per_s,
        remaining_s=None if goal is None else max(0.0, (goal - done) / steps_per_s),
        diagnosis="" if diagnosis is None else str(diagnosis),
    )
