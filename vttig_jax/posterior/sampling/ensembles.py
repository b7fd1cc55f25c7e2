"""Sampling of a log density with independent ensembles, until they are long enough and agree."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import UsageError
from .checkpoint import Checkpoint, Header, read
from .convergence import Diagnosis, diagnose, discarded
from .ensemble_blocks import Ensembles, Record, check_same_density, start, warm_up
from .importance import importance_diagnosis
from .laplace_move import moves_with
from .progress import Progress, progress_after
from .stop_rule import BLOCK_STEPS, BURN_IN, Until, next_decision
from .target import CheckedDensity, Target

FEWEST_ENSEMBLES = 4  # fewest ensembles that R-hat compares (chosen)
FEWEST_KEPT = 8  # fewest stored steps of a run (chosen)


@dataclass(frozen=True)
class Chains:
    """Draws of several independent ensembles.

    **Arguments**
    - `draws`: every `thin`-th step of every walker, burn-in included.
    - `log_density`: log density of each draw.
    - `acceptance`: accepted fraction of the proposals of each ensemble.
    - `steps`: steps made by every ensemble.
    - `discarded`: burn-in in steps, 0 if the walkers started in the posterior.
    - `identity`: JSON values that identify the density, see `Target`.
    - `state`: state of the sampler for a checkpoint; None for NUTS, which has no checkpoints.
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
    state: tuple[Header, Record, Until] | None = None

    @property
    def kept(self) -> Float[np.ndarray, "ensembles after walkers d"]:
        """Stored draws after the burn-in."""
        return self.draws[:, self.discarded // self.thin :]

    def flat(self) -> Float[np.ndarray, "n d"]:
        """Return the draws after burn-in as rows, ensemble by ensemble, step by step."""
        return self.kept.reshape(-1, len(self.names))

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write the checkpoint file that `vttig sample --resume` continues.

        **Raises** `UsageError` for draws without the state of the sampler and for a file that
        exists, `InputError` for a full disk or missing permission.
        """
        if self.state is None:
            raise UsageError(
                "these draws do not hold the state of an ensemble sampler; draw them with"
                " `vttig_jax.sample`.",
                where=str(path),
            )
        header, record, until = self.state
        with Checkpoint(path, header, resume=False, overwrite=overwrite) as file:
            file.save(record, until)

    def continues(self, path: Path) -> bool:
        """Return whether a checkpoint file holds these chains, or only their first steps.

        Equal settings and seeds give equal draws, so only the settings, the seeds and the numbers
        of steps are compared.

        **Raises** `InputError` for a file that is damaged or no checkpoint.
        """
        if self.state is None:
            return False
        header, record, _ = read(path)
        same = header.as_json() == self.state[0].as_json()
        return same and record.steps <= self.steps

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
    burn_in: float = BURN_IN,
    laplace_share: float = 0.0,
) -> Chains:
    """Sample a log density with several independent ensembles of emcee.

    **Arguments**
    - `target`: density to sample, see `Target`.
    - `ensembles`: number of ensembles, at least 4, with different starts and seeds: one ensemble
      alone does not show that all its walkers miss the same part.
    - `walkers`: walkers of each ensemble; even, at least 2 d (default 64, or 2 d + 2 if larger).
    - `steps`: exact number of steps, including those before a resume; not together with `until`.
    - `until`: stop rule (default `Until()`), evaluated after 1000, 1200, 1600 … steps.
    - `seed`: seed of the random numbers; equal seeds give equal draws.
    - `checkpoint`: HDF5 file, updated every 5 s, at the end and on an interrupt.
    - `resume`: continue the checkpoint if there is one, otherwise start a new run; the draws equal
      those of an uninterrupted run.
    - `overwrite`: replace the checkpoint. The old file stays until a new one is written.
    - `progress`: function called after each block of 200 steps.
    - `thin`: store every `thin`-th step. Neighbouring steps differ little (τ is tens of steps), so
      5 needs a fifth of the storage at a small loss.
    - `burn_in`: fraction of the chains that is discarded; 0 for starts that are draws of the
      density. A continued run uses the fraction of its checkpoint.
    - `laplace_share`: share of the proposals that are made around the fit, see `LaplaceMove`; a
      continued run uses that of its checkpoint.

    **Raises** `UsageError` or `InputError` for a checkpoint that cannot be used (see `Checkpoint`),
    `NoAnswerError` for a density that is NaN and for starts that cannot be used. A run that has not
    converged raises no error: see `Chains.diagnosis`.

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
    header = replace(
        _header(target, ensembles, walkers, seed, thin),
        burn_in=burn_in,
        laplace_share=laplace_share,
    )
    _check_options(
        steps, until=until, checkpoint=checkpoint, resume=resume, overwrite=overwrite, thin=thin
    )
    rule = until or Until()
    density = CheckedDensity(target)
    file = (
        nullcontext()
        if checkpoint is None
        else Checkpoint(checkpoint, header, resume=resume, overwrite=overwrite)
    )
    with file as writer:
        if writer is not None and writer.is_begun:
            record = writer.load()
            header = writer.header
            if steps is not None and steps < record.steps:
                raise UsageError(
                    f"the checkpoint already holds {record.steps} steps, more than the {steps} of"
                    f" --steps; set --steps to at least {record.steps}.",
                    where=str(writer.path),
                )
            check_same_density(density, record, writer.path)
        else:
            seeds = np.random.SeedSequence(seed).spawn(ensembles)
            record = start(density, seeds, header.walkers, thin)
        warm_up(density, record.points)
        run = _SamplingRun(
            header=header,
            ensembles=Ensembles(density, record, moves_with(target, header.laplace_share)),
            steps=steps,
            until=rule,
            checkpoint=writer,
            progress=progress,
        )
        diagnosis = run.sample()
    return chains_of(header, run.record, rule, diagnosis)


def read_chains(path: Path) -> Chains:
    """Return the chains of a checkpoint, diagnosed with the stop rule of the run that wrote it.

    **Raises** `InputError` for a file that is missing, damaged or no checkpoint.
    """
    header, record, until = read(path)
    return chains_of(header, record, until, diagnosis_of(header, record, until))


class _SamplingRun:
    """Loop over blocks of steps: sample, save, report the progress, stop."""

    def __init__(
        self,
        header: Header,
        ensembles: Ensembles,
        steps: int | None,
        until: Until,
        checkpoint: Checkpoint | None,
        progress: Callable[[Progress], None] | None,
    ):
        self.header = header
        self.ensembles = ensembles
        self.steps = steps
        self.until = until
        self.checkpoint = checkpoint
        self.progress = progress
        self.diagnosis: Diagnosis | None = None
        self._began_s = time.monotonic()
        self._began_steps = self.record.steps

    @property
    def record(self) -> Record:
        return self.ensembles.record

    def sample(self) -> Diagnosis:
        """Sample until the run may stop; an interrupt leaves a checkpoint."""
        try:
            while not self._done():
                self.ensembles.advance(self._block())
                if self.checkpoint is not None and self.checkpoint.due():
                    self.checkpoint.save(self.record, self.until)
                if self.progress is not None:
                    self.progress(self._progress_now())
            diagnosis = self._diagnosis()
        finally:
            if self.checkpoint is not None:
                self.checkpoint.save(self.record, self.until)
        return diagnosis

    def _last_step(self) -> int:
        return self.until.most_steps if self.steps is None else self.steps

    def _done(self) -> bool:
        done = self.record.steps
        if done >= self._last_step():
            return True
        return self.steps is None and _is_decision_step(done) and self._running().converged

    def _block(self) -> int:
        """Return the number of steps to the next multiple of a block, or to the end."""
        done = self.record.steps
        return min(BLOCK_STEPS - done % BLOCK_STEPS, self._last_step() - done)

    def _diagnosis(self) -> Diagnosis:
        known = self.diagnosis
        if known is None or known.steps != self.record.steps or not known.compared:
            self.diagnosis = diagnosis_of(self.header, self.record, self.until)
        assert self.diagnosis is not None
        return self.diagnosis

    def _running(self) -> Diagnosis:
        """Return the diagnosis that decides whether to go on; it has no R-hat of short chains."""
        if self.diagnosis is None or self.diagnosis.steps != self.record.steps:
            self.diagnosis = diagnosis_of(
                self.header, self.record, self.until, short_compared=False
            )
        return self.diagnosis

    def _progress_now(self) -> Progress:
        done = self.record.steps
        if _is_decision_step(done):
            self._running()
        rate = (done - self._began_steps) / max(time.monotonic() - self._began_s, 1e-9)
        return progress_after(done, self.steps, self.until, self.diagnosis, rate)


def _is_decision_step(steps: int) -> bool:
    return steps > 0 and next_decision(steps - 1) == steps


def _header(target: Target, ensembles: int, walkers: int | None, seed: int, thin: int) -> Header:
    names, units = tuple(target.names), tuple(target.units)
    d = len(names)
    if d == 0 or len(units) != d or len(set(names)) != d:
        raise ValueError(
            "Argument `target` must have a different name and a unit for each coordinate, but has"
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
    return Header(
        names=names,
        units=units,
        identity=target.identity,
        seed=seed,
        ensembles=ensembles,
        walkers=walkers,
        thin=thin,
    )


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
        raise ValueError("Argument `until` must be left out if `steps` is given.")
    end = until.most_steps if until is not None else steps
    if end is not None and end < FEWEST_KEPT * thin:
        raise ValueError(
            f"Argument `steps` must be at least {FEWEST_KEPT * thin} ({FEWEST_KEPT} stored steps),"
            f" but is {end!r}."
        )
    if resume and checkpoint is None:
        raise ValueError("Argument `checkpoint` must name a file for `resume`, but is None.")
    if resume and overwrite:
        raise ValueError("Argument `overwrite` must be left out if `resume` is given.")


def diagnosis_of(
    header: Header, record: Record, until: Until, *, short_compared: bool = True
) -> Diagnosis:
    """Return the diagnosis of the draws of a record, as `header.method` requires.

    `short_compared` is that of `diagnose`, which is used for emcee.
    """
    if header.method == "importance":
        return importance_diagnosis(header, record.draws, until)
    return diagnose(
        record.draws,
        header.names,
        thin=record.thin,
        steps=record.steps,
        acceptance=float(_acceptance(header, record).mean()),
        until=until,
        burn_in=header.burn_in,
        short_compared=short_compared,
    )


def _acceptance(header: Header, record: Record) -> Float[np.ndarray, " ensembles"]:
    return record.accepted / (record.steps * header.walkers)


def chains_of(header: Header, record: Record, until: Until, diagnosis: Diagnosis) -> Chains:
    """Return the draws of a record, burn-in included, as `Chains` with their diagnosis."""
    return Chains(
        names=header.names,
        units=header.units,
        draws=record.draws,
        log_density=record.log_density,
        acceptance=_acceptance(header, record),
        steps=record.steps,
        thin=record.thin,
        discarded=discarded(record.draws.shape[1], header.burn_in) * record.thin,
        seed=header.seed,
        identity=header.identity,
        diagnosis=diagnosis,
        state=(header, record, until),
    )
