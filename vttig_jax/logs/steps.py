"""Lasting steps in a series that also holds known columns: least squares over every instant."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

DEVIATIONS = 8.0
"""A step is at least this many robust standard deviations of what is left."""

MOST = 3
"""Steps looked for, one after the other."""

NEAR = 6
"""Values on either side in which a step must be complete."""

EQUAL = 0.3
"""Share of the step by which levels far from it may differ from those beside it."""

SEEN = 0.02
"""A step is told from the columns when this share of its shorter side is left beside them."""


@dataclass(frozen=True, eq=False)
class Step:
    """Values from `window` on are higher by `size`, with its standard error `std`.

    `base` is the level before it once `coefficients` of the columns are taken off.
    """

    window: int
    size: float
    std: float
    base: float
    coefficients: Float[np.ndarray, " p"]


def find_steps(
    values: Float[np.ndarray, " w"], columns: Float[np.ndarray, "w p"], least: float = 0.0
) -> list[Step]:
    """Steps that are large, sharp and lasting; the columns are fitted beside them.

    **Arguments**
    - `values`: the series, shape (w,). `columns`: what else may be in it, shape (w, p).
    - `least`: smaller steps are none.
    """
    count = len(values)
    if count < 4 * NEAR:
        return []
    places: list[int] = []
    for _ in range(MOST):
        place = _best(values, np.hstack([columns, _steps(places, count)]), places)
        if place is None:
            break
        places.append(place)
    for used in range(len(places), 0, -1):
        found = _judged(values, columns, places[:used], least)
        if found:
            return found
    return []


def _steps(places: list[int], count: int) -> Float[np.ndarray, "w s"]:
    return (np.arange(count)[:, None] >= np.array(places, np.int64)[None, :]).astype(np.float64)


def _best(
    values: Float[np.ndarray, " w"], columns: Float[np.ndarray, "w p"], taken: list[int]
) -> int | None:
    """Where one more step, not beside those `taken`, takes the most of the sum of squares away."""
    count = len(values)
    basis = _basis(columns)
    rest = values - basis @ (basis.T @ values)
    # Step k is 1 from k on: sums over the tail of what the columns leave.
    tail = np.cumsum(basis[::-1], axis=0)[::-1]
    places = np.arange(count)
    left = (count - places) - np.sum(tail**2, axis=1)
    shorter = np.minimum(places, count - places)
    usable = (shorter >= NEAR // 2) & (left > SEEN * shorter)
    for place in taken:  # a step within a few values is one
        usable &= np.abs(places - place) > NEAR
    if not usable.any():
        return None
    gain = np.cumsum(rest[::-1])[::-1] ** 2 / np.where(usable, left, np.inf)
    return int(np.argmax(gain))


def _basis(columns: Float[np.ndarray, "w p"]) -> Float[np.ndarray, "w r"]:
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > 1e-6 * size[0]]


def _judged(
    values: Float[np.ndarray, " w"],
    columns: Float[np.ndarray, "w p"],
    places: list[int],
    least: float,
) -> list[Step]:
    """Those of the steps at `places`, fitted together, that pass."""
    count, wide = columns.shape
    steps = _steps(places, count)
    design = np.hstack([columns, steps])
    found = np.linalg.lstsq(design, values, rcond=1e-9)[0]
    rest = values - design @ found
    sigma = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    sigma *= np.sqrt(count / max(count - _basis(design).shape[1], 1))
    sigma = max(float(sigma), least / DEVIATIONS, 1e-12 * float(np.ptp(values)))
    correlation = np.clip(rest[1:] @ rest[:-1] / max(float(rest @ rest), 1e-300), 0.0, 0.95)
    passed = []
    for k, place in enumerate(places):
        size = float(found[wide + k])
        level = rest + size * steps[:, k]
        if abs(size) < DEVIATIONS * sigma or not _lasting(level, place, size):
            continue
        others = _basis(np.delete(design, wide + k, axis=1))
        beside = steps[:, k] - others @ (others.T @ steps[:, k])
        std = sigma * np.sqrt((1 + correlation) / (1 - correlation) / (beside @ beside))
        base = float(np.median(level[max(0, place - NEAR) : place]))
        passed.append(Step(place, size, float(std), base, found[:wide]))
    return passed


def _lasting(level: Float[np.ndarray, " w"], place: int, size: float) -> bool:
    """Whether the step is complete within a few values, and the level holds on both sides."""
    before, after = level[:place], level[place:]
    # The value beside the step may hold part of both levels.
    near = np.median(after[1 : NEAR + 1]) - np.median(before[-NEAR - 1 : -1])
    if abs(near - size) > EQUAL * abs(size):
        return False
    parts = [*np.array_split(before, 3), *np.array_split(after, 3)]
    wanted = [0.0] * 3 + [size] * 3
    levels = [float(np.median(part)) for part in parts if len(part)]
    return len(levels) == 6 and all(
        abs(seen - expected) <= EQUAL * abs(size)
        for seen, expected in zip(levels, wanted, strict=True)
    )
