"""How far a run is."""

from dataclasses import dataclass

from .diagnosis import Diagnosis
from .stopping import Until, next_decision


@dataclass(frozen=True)
class Progress:
    """State of a running sampler after a block of steps.

    **Arguments**
    - `steps`: steps made by every ensemble, those before a resume included.
    - `total`: steps asked for; None while the stop rule decides.
    - `steps_per_s`: steps every ensemble makes in a second, in this session.
    - `remaining_s`: time left; by the autocorrelation time found so far where the stop rule
      decides, None before there is one.
    - `diagnosis`: the latest diagnosis as text, "" before the first.
    """

    steps: int
    total: int | None
    steps_per_s: float
    remaining_s: float | None
    diagnosis: str


def so_far(
    done: int, total: int | None, until: Until, diagnosis: Diagnosis | None, steps_per_s: float
) -> Progress:
    """Progress after `done` steps, with the time left to `total` or to the likely stop."""
    goal = total
    if goal is None and diagnosis is not None:
        # Ensembles that disagree may need any number of steps.
        needed = diagnosis.needed if diagnosis.agreed else until.most_steps
        goal = min(next_decision(max(needed, done) - 1), until.most_steps)
    return Progress(
        steps=done,
        total=total,
        steps_per_s=steps_per_s,
        remaining_s=None if goal is None else max(0.0, (goal - done) / steps_per_s),
        diagnosis="" if diagnosis is None else str(diagnosis),
    )
