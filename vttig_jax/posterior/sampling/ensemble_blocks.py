"""Ensembles that advance together by moves of emcee, block by block."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt32

from ...base.errors import InputError
from .joint_moves import MOVES, Moves, Walkers, step_together
from .target import CheckedDensity, starting_points


@dataclass(frozen=True)
class Record:
    """State of several ensembles after some steps; a checkpoint holds all of it.

    `draws` and `log_density` belong to every `thin`-th step, `points` and `point_log_density` to
    the last step. `accepted` is the number of accepted proposals. `keys` and `rest` (position,
    has_gauss, cached_gaussian) are the states of the ensembles' random generators, which are
    Mersenne twisters.
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

    def __init__(self, density: CheckedDensity, record: Record, moves: Moves = MOVES):
        self.record = record
        self._density = density
        self._moves = moves
        self._buffers = record.draws, record.log_density

    def advance(self, steps: int) -> None:
        """Advance every ensemble by `steps` steps."""
        old = self.record
        draws, log_density = self._buffers_for((old.steps + steps) // old.thin)
        ensembles = [_walkers(old, index) for index in range(len(old.points))]
        accepted = old.accepted.copy()
        for step in range(old.steps + 1, old.steps + steps + 1):
            moved = step_together(ensembles, self._density, self._moves)
            accepted += [int(np.count_nonzero(own)) for own in moved]
            if step % old.thin == 0:
                for index, own in enumerate(ensembles):
                    draws[index, step // old.thin - 1] = own.points
                    log_density[index, step // old.thin - 1] = own.log_density
        last = (old.steps + steps) // old.thin
        self.record = replace(
            old,
            steps=old.steps + steps,
            draws=draws[:, :last],
            log_density=log_density[:, :last],
            accepted=accepted,
            **_end_state(ensembles),
        )

    def _buffers_for(self, kept: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the arrays of draws and log densities, with capacity for `kept` stored steps.

        If they are too small, their capacity is at least doubled, so that copying is rare.
        """
        capacity = self._buffers[0].shape[1]
        if kept > capacity:
            larger = max(kept, 2 * capacity)
            self._buffers = _enlarged(self._buffers[0], larger), _enlarged(self._buffers[1], larger)
        return self._buffers


def start(
    density: CheckedDensity, seeds: list[np.random.SeedSequence], walkers: int, thin: int
) -> Record:
    """Return the record of new ensembles before their first step.

    Each seed starts one ensemble of `walkers` points, which `starting_points` draws. The record
    will hold every `thin`-th step.
    """
    states = []
    for seed in seeds:
        placing, moving = seed.spawn(2)
        points, values = starting_points(density, walkers, np.random.default_rng(placing))
        states.append(Walkers(points, values, np.random.RandomState(np.random.MT19937(moving))))
    count, d = len(seeds), len(density.target.names)
    return Record(
        steps=0,
        thin=thin,
        draws=np.empty((count, 0, walkers, d)),
        log_density=np.empty((count, 0, walkers)),
        accepted=np.zeros(count, np.int64),
        **_end_state(states),
    )


def warm_up(density: CheckedDensity, points: Float[np.ndarray, "ensembles walkers d"]) -> None:
    """Compile the density before the first step, by one evaluation.

    The number of points is that of each evaluation in a step: half of the walkers of all ensembles.
    """
    density(points[:, ::2].reshape(-1, points.shape[-1]))


def check_same_density(density: CheckedDensity, record: Record, path: Path) -> None:
    """Check that the density of the first ensemble at its last points equals the stored values.

    They differ if the code has changed since the checkpoint `path` was written.

    **Raises** `InputError` that names the point with the largest difference.
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


def _walkers(record: Record, index: int) -> Walkers:
    """Return copies of the walkers of ensemble `index`, with a random generator in its state."""
    position, has_gauss, cached = record.rest[index].tolist()
    random = np.random.RandomState()
    random.set_state(("MT19937", record.keys[index], int(position), int(has_gauss), cached))
    return Walkers(record.points[index].copy(), record.point_log_density[index].copy(), random)


def _end_state(ensembles: list[Walkers]) -> dict[str, Any]:
    """Return the fields of a record that hold the last step and the random generators."""
    twisters: list[Any] = [own.random.get_state() for own in ensembles]
    return {
        "points": np.stack([own.points for own in ensembles]),
        "point_log_density": np.stack([own.log_density for own in ensembles]),
        "keys": np.stack([twister[1] for twister in twisters]).astype(np.uint32),
        "rest": np.array([twister[2:5] for twister in twisters], np.float64),
    }


def _enlarged(array: np.ndarray, capacity: int) -> np.ndarray:
    larger = np.empty((array.shape[0], capacity, *array.shape[2:]))
    larger[:, : array.shape[1]] = array
    return larger
