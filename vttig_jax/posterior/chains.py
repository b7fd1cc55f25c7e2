"""Several independent ensembles of emcee, until their draws are enough and they agree."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from emcee.backends import Backend
from jaxtyping import Float

from ..base.errors import InputError, UsageError
from .checkpoint import Checkpoint, Header, StoredSteps, read
from .convergence import Diagnosis, after_burn_in, diagnose
from .target import BATCH
from .until import BLOCK_STEPS, Progress, Until

FEWEST_ENSEMBLES = 4
"""Fewest ensembles that R-hat compares."""

THIN = 5
"""Every fifth step is stored: neighbouring steps differ little."""

FEWEST_STEPS = 40
"""Fewest steps of a run: eight stored ones."""

_SHARE = 0.5
"""Share of the proposals around the fit; the others are differences of walkers (`DEMove`)."""


@dataclass(frozen=True)
class Chains:
    """Draws of several independent ensembles.

    **Arguments**
    - `header`: settings of the run. - `record`: every `THIN`-th step, burn-in included.
    - `until`: its stop rule.
    """

    header: Header
    record: StoredSteps
    until: Until

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """Convergence of the ensembles."""
        record, stored = self.record, self.record.draws.shape[1]
        return diagnose(
            record.draws,
            self.header.names,
            steps=stored * THIN,
            acceptance=float(record.accepted.mean()) / stored,  # of the stored steps
            until=self.until,
        )

    @property
    def draws(self) -> Float[np.ndarray, "ensembles kept walkers d"]:
        """Stored draws after the burn-in."""
        return after_burn_in(self.record.draws)

    @property
    def log_density(self) -> Float[np.ndarray, "ensembles kept walkers"]:
        """Log density of `draws`, up to a constant."""
        return after_burn_in(self.record.log_density)

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write the checkpoint file that `vttig sample --resume` continues.

        **Raises** `UsageError` for a file that exists, `InputError` for a full disk or missing
        permission.
        """
        with Checkpoint(path, self.header, resume=False, overwrite=overwrite) as file:
            file.save(self.record, self.until)

    def continues(self, path: Path) -> bool:
        """Return whether a checkpoint file holds these chains, or their first steps.

        Equal settings and seeds give equal draws, so only these and the steps are compared.

        **Raises** `InputError` for a file that is damaged or no checkpoint.
        """
        header, record, _ = read(path)
        shorter = record.draws.shape[1] <= self.record.draws.shape[1]
        return header.as_json() == self.header.as_json() and shorter

    def __str__(self) -> str:
        return str(self.diagnosis)


def run_ensembles(
    target: Any,
    *,
    ensembles: int = FEWEST_ENSEMBLES,
    walkers: int | None = None,
    steps: int | None = None,
    until: Until | None = None,
    seed: int = 0,
    checkpoint: Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> Chains:
    """Sample a log density with several independent ensembles of `emcee.EnsembleSampler`.

    Half of the proposals are drawn around the fit (`target.around`), half are differences of
    walkers. The walkers start at weighted draws around the fit.

    **Arguments**
    - `target`: density to sample. `target.log_density` maps points, shape (n, d), to n values, −inf
      outside the support, and `target.around()` is a `Proposal` with a pool of weighted draws.
      `target.names` and `target.units` are those of the coordinates, and `target.identity` holds
      JSON values that tell one density from another.
    - `ensembles`: number of ensembles, at least 4, with different starts and seeds: one ensemble
      alone does not show that all its walkers miss the same part.
    - `walkers`: walkers of each ensemble; even, at least 2 d (default: the least multiple of 32).
    - `steps`: number of steps, rounded up to a multiple of `THIN`, including those before a resume;
      not together with `until`.
    - `until`: stop rule (default `Until()`), looked at every `BLOCK_STEPS` steps.
    - `seed`: seed of the random numbers; equal seeds give equal draws.
    - `checkpoint`: HDF5 file, updated every 5 s, at the end and on an interrupt.
    - `resume`: continue the checkpoint if there is one, otherwise start a new run; the draws equal
      those of an uninterrupted run.
    - `overwrite`: replace the checkpoint. The old file stays until a new one is written.
    - `progress`: function called after each block of steps.

    **Raises** `UsageError` or `InputError` for a checkpoint that cannot be used (see `Checkpoint`),
    `NoAnswerError` for a density that has no finite value near the fit. A run that has not
    converged raises no error: see `Chains.diagnosis`.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior import run_ensembles
    >>> from vttig_jax.posterior.proposal import Proposal
    >>> class Normal:
    ...     names, units, identity = ("x", "y"), ("mm", ""), {}
    ...     def around(self):
    ...         start = Proposal.of(np.zeros(2), np.eye(2), np.zeros(2, bool))
    ...         return start.improved(self.log_density)
    ...     def log_density(self, points):
    ...         return -0.5 * (points**2).sum(axis=1)
    >>> chains = run_ensembles(Normal(), steps=500)
    >>> chains.diagnosis.converged, chains.draws.shape
    (True, (4, 80, 32, 2))

    ```
    """
    header = _header(target, ensembles, walkers, seed)
    rule = until or Until()
    last = _last_step(steps, until)
    if resume and checkpoint is None:
        raise ValueError("Argument `checkpoint` must name a file for `resume`, but is None.")
    if resume and overwrite:
        raise ValueError("Argument `overwrite` must be left out if `resume` is given.")
    file = (
        nullcontext()
        if checkpoint is None
        else Checkpoint(checkpoint, header, resume=resume, overwrite=overwrite)
    )
    with file as writer:
        run = _Run(target, header, None if writer is None else writer.begun())
        if steps is not None and run.steps > last:
            raise UsageError(
                f"the checkpoint already holds {run.steps} steps, more than the {steps} of --steps;"
                f" set --steps to at least {run.steps}.",
                where=str(checkpoint),
            )
        if run.steps and not run.is_same(target):
            raise InputError(
                "this checkpoint belongs to another density: at its last points the log density"
                " has other values; replace it with --overwrite.",
                where=str(checkpoint),
            )
        began, begun = time.monotonic(), run.steps
        try:
            while run.steps < last and (steps is not None or not run.converged(rule)):
                run.advance(min(BLOCK_STEPS - run.steps % BLOCK_STEPS, last - run.steps))
                if writer is not None:
                    writer.save(run.record, rule, if_due=True)
                if progress is not None:
                    now, rate = run.chains(rule).diagnosis, run.steps - begun
                    rate /= max(time.monotonic() - began, 1e-9)
                    goal = last if steps is not None else min(max(now.needed, run.steps), last)
                    left = (goal - run.steps) / rate
                    progress(Progress(run.steps, steps, rate, left, str(now)))
        finally:
            if writer is not None:
                writer.save(run.record, rule)
    return run.chains(rule)


def read_chains(path: Path) -> Chains:
    """Return the chains of a checkpoint, diagnosed with the stop rule of the run that wrote it.

    **Raises** `InputError` for a file that is missing, damaged or no checkpoint.
    """
    return Chains(*read(path))


class _Run:
    """Ensembles that advance together; `record` changes only when a whole block is done.

    An exception during a block, including Ctrl-C, leaves `record` unchanged.
    """

    def __init__(self, target: Any, header: Header, record: StoredSteps | None):
        self.header = header
        self.around = target.around()
        moves = [(emcee.moves.MHMove(self.around), _SHARE), (emcee.moves.DEMove(), 1 - _SHARE)]
        shape = header.walkers, len(header.names)
        density = target.log_density
        self.ensembles: list[emcee.EnsembleSampler] = []
        for number in range(header.ensembles):
            backend = Backend()
            backend.reset(*shape)
            if record is not None:
                backend.chain, backend.log_prob = record.draws[number], record.log_density[number]
                backend.accepted = record.accepted[number].astype(float)
                backend.iteration = record.draws.shape[1]
                position, has_gauss, gauss = record.rest[number].tolist()
                key = record.keys[number]
                backend.random_state = "MT19937", key, int(position), int(has_gauss), gauss
            settings: dict[str, Any] = {"vectorize": True, "moves": moves, "backend": backend}
            one = emcee.EnsembleSampler(*shape, density, **settings)
            # emcee's wrapper would print all points on Ctrl-C.
            one.log_prob_fn = density  # pyright: ignore
            self.ensembles.append(one)
        begun = () if record is None else self.ensembles
        self._states: list[Any] = [one.get_last_sample() for one in begun] or self._starts()
        self.record = self._recorded(0) if record is None else record

    def _starts(self) -> list[emcee.State]:
        """Return different points of the pool for every ensemble, with a random generator each."""
        header, pool = self.header, len(self.around.pool)
        if header.ensembles * header.walkers > pool:
            raise ValueError(
                f"Argument `walkers` must give at most {pool} walkers in all, but"
                f" {header.ensembles} ensembles of {header.walkers} are asked for."
            )
        seeds = np.random.SeedSequence(header.seed).spawn(header.ensembles + 1)
        *own, first = [np.random.RandomState(np.random.MT19937(one)) for one in seeds]
        points = self.around.starts(header.ensembles * header.walkers, first)
        return [
            emcee.State(points[number :: header.ensembles], random_state=one.get_state())
            for number, one in enumerate(own)
        ]

    @property
    def steps(self) -> int:
        """Steps made by every ensemble."""
        return self.record.draws.shape[1] * THIN

    def advance(self, steps: int) -> None:
        """Advance every ensemble by `steps` steps, a multiple of `THIN`."""
        stored, settings = steps // THIN, {"thin_by": THIN, "skip_initial_state_check": True}
        self._states = [
            one.run_mcmc(state, stored, **settings)
            for one, state in zip(self.ensembles, self._states, strict=True)
        ]
        self.record = self._recorded((self.steps + steps) // THIN)

    def _recorded(self, stored: int) -> StoredSteps:
        backends = [one.backend for one in self.ensembles]
        states: list[Any] = [state.random_state for state in self._states]
        return StoredSteps(
            np.stack([one.chain[:stored] for one in backends]),
            np.stack([one.log_prob[:stored] for one in backends]),
            np.stack([one.accepted for one in backends]).astype(int),
            np.stack([state[1] for state in states]).astype(np.uint32),
            np.array([state[2:5] for state in states], float),
        )

    def is_same(self, target: Any) -> bool:
        """Return whether the density at the last points is that of the record."""
        stored = self.record.log_density[0, -1]
        values = target.log_density(self.record.draws[0, -1])
        return bool(np.all(np.abs(values - stored) <= 1e-6 * (1 + np.abs(stored))))

    def chains(self, until: Until) -> Chains:
        """Return the steps so far."""
        return Chains(self.header, self.record, until)

    def converged(self, until: Until) -> bool:
        """Return whether the steps so far are enough."""
        return self.steps >= 2 * BLOCK_STEPS and self.chains(until).diagnosis.converged


def _header(target: Any, ensembles: int, walkers: int | None, seed: int) -> Header:
    d = len(target.names)
    if ensembles < FEWEST_ENSEMBLES:
        raise ValueError(
            f"Argument `ensembles` must be at least {FEWEST_ENSEMBLES}, but is {ensembles!r}."
        )
    if walkers is None:
        walkers = 2 * BATCH * -(-d // BATCH)
    if walkers % 2 or walkers < 2 * d:
        raise ValueError(
            f"Argument `walkers` must be even and at least {2 * d}, twice the number of"
            f" coordinates, but is {walkers!r}."
        )
    if seed < 0:
        raise ValueError(f"Argument `seed` must not be negative, but is {seed!r}.")
    names, units = tuple(target.names), tuple(target.units)
    return Header(names, units, target.identity, seed, ensembles, walkers)


def _last_step(steps: int | None, until: Until | None) -> int:
    if steps is not None and until is not None:
        raise ValueError("Argument `until` must be left out if `steps` is given.")
    if steps is None:
        return (until or Until()).most_steps
    if steps < FEWEST_STEPS:
        raise ValueError(f"Argument `steps` must be at least {FEWEST_STEPS}, but is {steps!r}.")
    return -(-steps // THIN) * THIN
