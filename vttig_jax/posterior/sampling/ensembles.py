"""Sampling of a log density with several independent ensembles until they are long and agree."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import UsageError
from .checkpoint import Checkpoint, Header, read
from .convergence import Diagnosis, burn_in, diagnose
from .ensemble_blocks import Ensembles, Record, check_same_density, start, warm_up
from .stop_rule import BLOCK_STEPS, Until, next_decision
from .target import CheckedDensity, Target


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


FEWEST_ENSEMBLES = 4
FEWEST_KEPT = 8


@dataclass(frozen=True)
class Chains:
    """Draws of several independent ensembles.

    **Arguments**
    - `draws`: every `thin`-th step of every walker, burn-in included.
    - `log_density`: the log density of each of these.
    - `acceptance`: accepted share of the proposals of each ensemble.
    - `steps`: steps made by every ensemble.
    - `discarded`: burn-in in steps: the first quarter of the stored ones.
    - `identity`: that of the target.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: Float[np.ndarray, "ensembles kept walkers d"]
    log_density: Float[np.ndarray, "ensembles kept walkers"]
    acceptance: Float[np.ndarray, " ensembles"]
    steps: int
    thin: int
    discarded: int
    seed: int
    identity: dict[str, Any]
    diagnosis: Diagnosis

    @property
    def kept(self) -> Float[np.ndarray, "ensembles after walkers d"]:
        """The draws after burn-in."""
        return self.draws[:, self.discarded // self.thin :]

    def flat(self) -> Float[np.ndarray, "n d"]:
        """The draws after burn-in one below the other, ensemble by ensemble, step by step."""
        return self.kept.reshape(-1, len(self.names))

    def __str__(self) -> str:
        return str(self.diagnosis)


def run_ensembles(
    target: Target,
    *,
    ensembles: int = FEWEST_ENSEMBLES,
    walkers: int | None = None,
    steps: int | None = None,
    until: Until | None = None,
    seed: int = 0,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    overwrite: bool = False,
    thin: int = 5,
) -> Chains:
    """Sample a log density with several independent ensembles of emcee.

    **Arguments**
    - `target`: the density; see `Target`.
    - `ensembles`: at least 4, started and seeded apart: one ensemble cannot tell that all of its
      walkers miss the same part.
    - `walkers`: of each ensemble; even, at least 2 d (default 64, or 2d + 2 where that is more).
    - `steps`: make exactly so many steps, those of a resumed run included; not with `until`.
    - `until`: the stop rule (default `Until()`), looked at after 1000, 1200, 1600 … steps.
    - `seed`: equal seeds give equal draws.
    - `checkpoint`: HDF5 file that is brought up to date every 5 s, at the end and on an interrupt.
    - `resume`: continue it; the draws are those of a run that was never interrupted.
    - `overwrite`: replace it. The old file stays until there is a new one.
    - `progress`: called after each block of 200 steps.
    - `thin`: store every `thin`-th step. Neighbouring steps differ little (τ is tens of steps), so
      5 makes a fifth of the storage at a small loss.

    **Raises** `UsageError`, `InputError` for a checkpoint that cannot be used (see `Checkpoint`),
    `NoAnswerError` for a density that is NaN and for starts that cannot be used. Not to have
    converged raises nothing: ask `Chains.diagnosis`.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior import run_ensembles
    >>> class Normal:
    ...     names, units, identity = ("x", "y"), ("mm", ""), {}
    ...     def log_density(self, points):
    ...         return -0.5 * (points**2).sum(axis=1)
    ...     def starts(self, count, generator):
    ...         return generator.standard_normal((count, 2))
    >>> chains = run_ensembles(Normal(), steps=1000)
    >>> chains.diagnosis.converged, chains.flat().shape
    (True, (38400, 2))

    ```
    """
    header = _header(target, ensembles, walkers, seed, thin)
    _check_options(steps, until, checkpoint, resume, overwrite, thin)
    rule = until or Until()
    density = CheckedDensity(target)
    file = (
        nullcontext()
        if checkpoint is None
        else Checkpoint(checkpoint, header, resume=resume, overwrite=overwrite)
    )
    with file as place:
        if place is not None and resume:
            record = place.load()
            if steps is not None and steps < record.steps:
                raise UsageError(
                    f"the checkpoint holds {record.steps} steps already; ask for more than the"
                    f" {steps} of --steps.",
                    where=str(place.path),
                )
            check_same_density(density, record, place.path)
        else:
            seeds = np.random.SeedSequence(seed).spawn(ensembles)
            record = start(density, seeds, header.walkers, thin)
        warm_up(density, record.points[0])
        run = _Run(header, Ensembles(density, record), steps, rule, place, progress)
        diagnosis = run.to_the_end()
    return _chains(header, run.record, diagnosis)


def read_chains(path: Path) -> Chains:
    """Chains of a checkpoint, judged by the stop rule they were last sampled with.

    **Raises** `InputError` for a file that is missing, damaged or no checkpoint.
    """
    header, record, until = read(path)
    return _chains(header, record, _diagnosed(header, record, until))


class _Run:
    """The loop over blocks: sample, save, tell, stop."""

    def __init__(
        self,
        header: Header,
        ensembles: Ensembles,
        steps: int | None,
        until: Until,
        place: Checkpoint | None,
        progress: Callable[[Progress], None] | None,
    ):
        self.header = header
        self.ensembles = ensembles
        self.steps = steps
        self.until = until
        self.place = place
        self.progress = progress
        self.diagnosis: Diagnosis | None = None
        self._began_s = time.monotonic()
        self._began_steps = self.record.steps

    @property
    def record(self) -> Record:
        return self.ensembles.record

    def to_the_end(self) -> Diagnosis:
        """Run until it is time to stop; whatever interrupts it leaves a checkpoint."""
        try:
            while not self._done():
                self.ensembles.advance(self._block())
                if self.place is not None and self.place.due():
                    self.place.save(self.record, self.until)
                if self.progress is not None:
                    self.progress(self._so_far())
            diagnosis = self._judged()
        finally:
            if self.place is not None:
                self.place.save(self.record, self.until)
        return diagnosis

    def _end(self) -> int:
        return self.until.most_steps if self.steps is None else self.steps

    def _done(self) -> bool:
        done = self.record.steps
        if done >= self._end():
            return True
        return self.steps is None and _decides(done) and self._judged().converged

    def _block(self) -> int:
        """Steps to the next multiple of a block, or to the end."""
        done = self.record.steps
        return min(BLOCK_STEPS - done % BLOCK_STEPS, self._end() - done)

    def _judged(self) -> Diagnosis:
        if self.diagnosis is None or self.diagnosis.steps != self.record.steps:
            self.diagnosis = _diagnosed(self.header, self.record, self.until)
        return self.diagnosis

    def _so_far(self) -> Progress:
        done = self.record.steps
        if _decides(done):
            self._judged()
        rate = (done - self._began_steps) / max(time.monotonic() - self._began_s, 1e-9)
        return so_far(done, self.steps, self.until, self.diagnosis, rate)


def _decides(steps: int) -> bool:
    return steps > 0 and next_decision(steps - 1) == steps


def _header(target: Target, ensembles: int, walkers: int | None, seed: int, thin: int) -> Header:
    names, units = tuple(target.names), tuple(target.units)
    d = len(names)
    if d == 0 or len(units) != d or len(set(names)) != d:
        raise ValueError(
            "Argument `target` must have a name of its own and a unit for each coordinate, but has"
            f" {names} and {units}."
        )
    if ensembles < FEWEST_ENSEMBLES:
        raise ValueError(
            f"Argument `ensembles` must be at least {FEWEST_ENSEMBLES}, but is {ensembles!r}."
        )
    if walkers is None:
        walkers = max(64, 2 * d + 2)
    if walkers % 2 or walkers < max(4, 2 * d):
        raise ValueError(
            f"Argument `walkers` must be even and at least {max(4, 2 * d)}, twice the number of"
            f" coordinates, but is {walkers!r}."
        )
    if seed < 0:
        raise ValueError(f"Argument `seed` must not be negative, but is {seed!r}.")
    return Header(names, units, target.identity, seed, ensembles, walkers, thin)


def _check_options(
    steps: int | None,
    until: Until | None,
    checkpoint: Path | None,
    resume: bool,
    overwrite: bool,
    thin: int,
) -> None:
    if thin < 1:
        raise ValueError(f"Argument `thin` must be at least 1, but is {thin!r}.")
    if steps is not None and until is not None:
        raise ValueError("Argument `until` must be left out where `steps` is given.")
    end = until.most_steps if until is not None else steps
    if end is not None and end < FEWEST_KEPT * thin:
        raise ValueError(
            f"Argument `steps` must be at least {FEWEST_KEPT * thin}, {FEWEST_KEPT} stored steps,"
            f" but is {end!r}."
        )
    if resume and checkpoint is None:
        raise ValueError("Argument `checkpoint` must be the file to go on from with `resume`.")
    if resume and overwrite:
        raise ValueError("Argument `overwrite` must be left out with `resume`.")


def _diagnosed(header: Header, record: Record, until: Until) -> Diagnosis:
    return diagnose(
        record.draws,
        header.names,
        thin=record.thin,
        steps=record.steps,
        acceptance=float(_acceptance(header, record).mean()),
        until=until,
    )


def _acceptance(header: Header, record: Record) -> Float[np.ndarray, " ensembles"]:
    return record.accepted / (record.steps * header.walkers)


def _chains(header: Header, record: Record, diagnosis: Diagnosis) -> Chains:
    return Chains(
        names=header.names,
        units=header.units,
        draws=record.draws,
        log_density=record.log_density,
        acceptance=_acceptance(header, record),
        steps=record.steps,
        thin=record.thin,
        discarded=burn_in(record.draws.shape[1]) * record.thin,
        seed=header.seed,
        identity=header.identity,
        diagnosis=diagnosis,
    )
