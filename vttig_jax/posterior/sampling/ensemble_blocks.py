"""Ensembles of emcee that advance together, block by block."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from emcee.moves import DEMove, StretchMove
from jaxtyping import Float, Int, UInt32

from ...base.errors import InputError
from .target import CheckedDensity, starting_points

MOVES = ((DEMove(), 0.8), (StretchMove(), 0.2))
"""Moves and their weights: differential evolution, and stretch moves for non-elliptic posteriors.

Measured on a Gaussian of 20 coordinates, condition 1e4, 64 walkers, in effective draws per second:
4600 by differential evolution, 4000 by this mixture, 770 by stretch moves alone. `DESnookerMove`
of emcee 3.1.6 violates detailed balance (it divides its unit vector by √norm): with weight 0.2 in
the mixture, the variance of that Gaussian comes out 22 % too small."""


@dataclass(frozen=True)
class Record:
    """State of several ensembles after some steps; a checkpoint holds all of it.

    `draws` and `log_density` belong to every `thin`-th step, `points` and `point_log_density` to
    the last one. `keys` and `rest` (position, has_gauss, cached_gaussian) are the states of the
    ensembles' Mersenne twisters.
    """

    steps: int
    thin: int
    draws: Float[np.ndarray, "ensembles kept walkers d"]
    log_density: Float[np.ndarray, "ensembles kept walkers"]
    accepted: Int[np.ndarray, " ensembles"]
    points: Float[np.ndarray, "ensembles walkers d"]
    point_log_density: Float[np.ndarray, "ensembles walkers"]
    keys: UInt32[np.ndarray, "ensembles 624"]
    rest: Float[np.ndarray, "ensembles 3"]


class Ensembles:
    """Ensembles that advance together; `record` changes only when a whole block is done.

    An exception during a block, including Ctrl-C, leaves `record` unchanged.
    """

    def __init__(self, density: CheckedDensity, record: Record):
        count, _, walkers, d = record.draws.shape
        self.record = record
        self._buffers = record.draws, record.log_density
        self._samplers = [_Sampler(walkers, d, density, record.thin) for _ in range(count)]

    def advance(self, steps: int) -> None:
        """Advance every ensemble by `steps` steps."""
        old = self.record
        first, last = old.steps // old.thin, (old.steps + steps) // old.thin
        draws, log_density = self._buffers_for(last)
        states, accepted = [], []
        for index, sampler in enumerate(self._samplers):
            into = draws[index, first:last], log_density[index, first:last]
            states.append(sampler.advance(_emcee_state(old, index), steps, old.steps, into))
            accepted.append(sampler.backend.total)
        self.record = replace(
            old,
            steps=old.steps + steps,
            draws=draws[:, :last],
            log_density=log_density[:, :last],
            accepted=old.accepted + np.array(accepted, np.int64),
            **_end_state(states),
        )

    def _buffers_for(self, kept: int) -> tuple[np.ndarray, np.ndarray]:
        """Return arrays with capacity for `kept` steps; it doubles, so that growing is rare."""
        capacity = self._buffers[0].shape[1]
        if kept > capacity:
            larger = max(kept, 2 * capacity)
            self._buffers = _enlarged(self._buffers[0], larger), _enlarged(self._buffers[1], larger)
        return self._buffers


def start(
    density: CheckedDensity, seeds: list[np.random.SeedSequence], walkers: int, thin: int
) -> Record:
    """Return the record of new ensembles, which have made no step yet.

    Every seed starts one ensemble of `walkers` points, drawn by `starting_points`. The record will
    hold every `thin`-th step.
    """
    states = []
    for seed in seeds:
        placing, moving = seed.spawn(2)
        points, values = starting_points(density, walkers, np.random.default_rng(placing))
        twister = np.random.RandomState(np.random.MT19937(moving))
        states.append(emcee.State(points, log_prob=values, random_state=twister.get_state()))
    count, d = len(seeds), len(density.target.names)
    return Record(
        steps=0,
        thin=thin,
        draws=np.empty((count, 0, walkers, d)),
        log_density=np.empty((count, 0, walkers)),
        accepted=np.zeros(count, np.int64),
        **_end_state(states),
    )


def warm_up(density: CheckedDensity, points: Float[np.ndarray, "walkers d"]) -> None:
    """Evaluate the density once for every batch size of the moves, so that it compiles now."""
    sizes = {len(points[part :: move.nsplits]) for move, _ in MOVES for part in range(move.nsplits)}
    for size in sorted(sizes):
        density(points[:size].copy())


def check_same_density(density: CheckedDensity, record: Record, path: Path) -> None:
    """Check that the density has the values stored in the record; the code may have changed.

    **Raises** `InputError` that names a point.
    """
    stored = record.point_log_density[0]
    values = density(record.points[0].copy())
    different = np.abs(values - stored) > 1e-6 * (1 + np.abs(stored))
    if different.any():
        worst = int(np.argmax(different))
        raise InputError(
            "this checkpoint belongs to another density: at"
            f" {density.describe(record.points[0, worst])} it has the log density"
            f" {stored[worst]:.9g}, {values[worst]:.9g} expected; replace it with --overwrite.",
            where=str(path),
        )


class _ArrayBackend(emcee.backends.Backend):
    """Backend that writes every `thin`-th step into given arrays and counts accepted proposals."""

    def __init__(self, thin: int):
        super().__init__()
        self.thin = thin

    def begin(self, steps: int, into: tuple[np.ndarray, np.ndarray]) -> None:
        self.steps, self.into, self.stored, self.total = steps, into, 0, 0

    def grow(self, ngrow: int, blobs: None) -> None:
        """Do nothing: `begin` receives arrays of the right size."""

    def save_step(self, state: emcee.State, accepted: np.ndarray) -> None:
        self.steps += 1
        self.total += int(np.count_nonzero(accepted))
        if self.steps % self.thin == 0:
            draws, log_density = self.into
            draws[self.stored] = state.coords
            log_density[self.stored] = state.log_prob
            self.stored += 1


class _Sampler(emcee.EnsembleSampler):
    """Sampler of emcee on a checked, vectorised density."""

    backend: _ArrayBackend

    def __init__(self, walkers: int, d: int, density: CheckedDensity, thin: int):
        super().__init__(
            walkers, d, density, moves=list(MOVES), backend=_ArrayBackend(thin), vectorize=True
        )
        self._density = density

    def compute_log_prob(self, coords: np.ndarray) -> tuple[np.ndarray, None]:
        """Return the density directly; emcee's own method makes a list and prints exceptions."""
        return self._density(coords), None

    def advance(
        self, state: emcee.State, steps: int, before: int, into: tuple[np.ndarray, np.ndarray]
    ) -> emcee.State:
        """Return the state after `steps` steps; `before` is the number of steps already made."""
        self.backend.begin(before, into)
        *_, last = self.sample(state, iterations=steps, skip_initial_state_check=True)
        return last


def _emcee_state(record: Record, index: int) -> emcee.State:
    """Return the state of one ensemble as emcee needs it; emcee copies it."""
    position, has_gauss, cached = record.rest[index].tolist()
    return emcee.State(
        record.points[index],
        log_prob=record.point_log_density[index],
        random_state=("MT19937", record.keys[index], int(position), int(has_gauss), cached),
    )


def _end_state(states: list[Any]) -> dict[str, Any]:
    """Return the fields of a record that hold the last step and the random generators."""
    twisters = [state.random_state for state in states]
    return {
        "points": np.stack([state.coords for state in states]),
        "point_log_density": np.stack([state.log_prob for state in states]),
        "keys": np.stack([twister[1] for twister in twisters]).astype(np.uint32),
        "rest": np.array([twister[2:5] for twister in twisters], np.float64),
    }


def _enlarged(array: np.ndarray, capacity: int) -> np.ndarray:
    larger = np.empty((array.shape[0], capacity, *array.shape[2:]))
    larger[:, : array.shape[1]] = array
    return larger
