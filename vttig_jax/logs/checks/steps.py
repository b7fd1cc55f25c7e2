"""Detection of steps in a series, fitted together with regressors, in coloured noise with outliers.

All limits below are chosen values unless they say otherwise.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.numerics.student_noise import NoiseFit, fit_student_noise
from ...base.numerics.well_conditioned import orthonormal_basis

EVIDENCE, FURTHER = 100.0, 30.0
"""Least 2 Δ ln L of a step, in 100 simulated rigs without a step the largest value was 86, and of
every further one."""

FIRST, MOST = 3, 24
"""Number of steps that are searched at first, and the largest number of them: the search goes on if
the first ones reduce the sum of squares."""

NEAR = 6
"""Two steps at most this many values apart are the same step."""

_FLOOR = 0.01
"""Least standard deviation of the noise, as a fraction of the least step size; smaller noise adds
no evidence."""

_BETTER = 20.0
"""Least 2 Δ ln L by which steps of the coefficient of `rival` are preferred. At one speed a step of
the delay and a step of the angle are equally likely."""

LEAST_REMAINDER = 0.02
"""Least squared norm of the part of a step orthogonal to the columns, relative to the sum of
squares on the shorter side of the step."""


@dataclass(frozen=True, eq=False)
class Step:
    """Step of the values by `size` from index `window` on, with its standard error `std`.

    `base` is the level before the step after subtraction of columns · `coefficients`.
    """

    window: int
    size: float
    std: float
    base: float
    coefficients: Float[np.ndarray, " p"]


def find_steps(
    values: Float[np.ndarray, " w"],
    columns: Float[np.ndarray, "w p"],
    least: float = 0.0,
    rival: Float[np.ndarray, " w"] | None = None,
) -> list[Step]:
    """Return the steps that raise the likelihood enough, in a fit together with other regressors.

    Steps are accepted together if they raise 2 ln L by at least `EVIDENCE` and `FURTHER` for each
    one but the first, and if steps of the coefficient of `rival` are not clearly better. The noise
    is autoregressive with innovations of Student's distribution. Its order, its coefficients and
    the degrees of freedom are fitted with and without the steps. Some steps hide others, in the
    noise and by their places; so more of them are searched than are accepted, and the least of them
    is left out in turn.

    **Arguments**
    - `values`: the series, shape (w,). `columns`: regressors of other effects, shape (w, p).
    - `least`: least size of a step, in the unit of `values`.
    - `rival`: regressor of an effect whose size may step instead, shape (w,).
    """
    series = _Series(values, columns, _FLOOR * least)
    constant = np.ones(len(values))
    if series.squares_ratio(constant, series.places(constant, FIRST)) < EVIDENCE / 2:
        return []
    without = series.noise(columns)
    places, score = series.judged(constant, without)
    if not places:
        return []
    if rival is not None and series.judged(rival, without)[1] > score + _BETTER:
        return []
    return _measured(values, columns, series.sharpened(places, without), least)


@dataclass(frozen=True, eq=False)
class _Series:
    """Series and its regressors `columns`; `floor` is the least standard deviation of the noise."""

    values: Float[np.ndarray, " w"]
    columns: Float[np.ndarray, "w p"]
    floor: float

    def places(self, shape: Float[np.ndarray, " w"], most: int) -> list[int]:
        """Return up to `most` indices at which a step reduces the sum of squares most.

        The regressor of a step is 0 before its index and `shape` from its index on; ones give a
        step of the value. The steps are found one after the other.
        """
        places: list[int] = []
        while len(self.values) >= 4 * NEAR and len(places) < most:
            place = self._best_place(shape, places)
            if place is None:
                break
            places.append(place)
        return places

    def fewer(self, shape: Float[np.ndarray, " w"], places: list[int]) -> list[int]:
        """Return the steps without the one that is missed least, each moved to its best place."""
        base = self._of_columns
        steps = _without(base, _without(base, shape[:, None] * _steps(places, len(shape))))
        inverse = np.linalg.pinv(steps)
        missed = (inverse @ self.values) ** 2 / np.sum(inverse**2, axis=1)
        left = np.delete(places, np.argmin(missed)).tolist()
        found = self.squares_ratio(shape, left)
        for k in range(len(left)):
            place = self._best_place(shape, [*left[:k], *left[k + 1 :]])
            if place is not None and place != left[k]:
                other = [*left[:k], place, *left[k + 1 :]]
                if (better := self.squares_ratio(shape, other)) > found:
                    left, found = other, better
        return left

    def squares_ratio(self, shape: Float[np.ndarray, " w"], places: list[int]) -> float:
        """Return n ln (S₀ / S₁) with the number n of values.

        S₀ is the sum of squares without steps, S₁ that with steps at `places`; see `places` for
        `shape`.
        """
        squares = []
        for used in ([], places):
            residual = _without(self._basis(shape, used), self.values)
            squares.append(max(float(residual @ residual), 1e-300))
        return len(self.values) * float(np.log(squares[0] / squares[1]))

    def noise(
        self, design: Float[np.ndarray, "w q"], *starts: NoiseFit, **choices: Any
    ) -> NoiseFit:
        """Return the noise model with the largest likelihood, fitted together with `design`.

        `starts` are further fits from which the search starts.
        """
        return fit_student_noise(self.values, design, *starts, floor=self.floor, **choices)

    def judged(self, shape: Float[np.ndarray, " w"], without: NoiseFit) -> tuple[list[int], float]:
        """Return the places of the steps to accept, and 2 Δ ln L minus its threshold.

        `without` is the noise model without steps. If no step is accepted, the second value is 0.
        Noise whose level wanders by innovations with heavier tails than those beside the steps is
        no rival: it calls every step an outlier.
        """
        accepted, best = [], 0.0
        places, usual = self.places(shape, MOST), {}
        while places:
            least = EVIDENCE + FURTHER * (len(places) - 1)
            if self.squares_ratio(shape, places) >= least / 2:
                found = self.noise(self._design(shape, places), without)
                kinds = [(order, found.freedom) for order in (None, found.order)]
                for order, tails in kinds:
                    if (order, tails) not in usual:
                        usual[order, tails] = self.noise(
                            self.columns, without, order=order, least_freedom=tails
                        ).log_likelihood
                beside = max(usual[kind] for kind in kinds)
                score = 2 * (found.log_likelihood - beside) - least
                if score >= best:
                    accepted, best = places, score
            places = self.fewer(shape, places)
        return sorted(accepted), best

    def sharpened(self, places: list[int], without: NoiseFit) -> list[int]:
        """Return the indices of the steps, each moved to the nearby index of largest likelihood."""
        sharp, constant, last = list(places), np.ones(len(self.values)), len(self.values) - 1
        for k, place in enumerate(places):
            nearby = range(max(place - NEAR // 2, 1), min(place + NEAR // 2 + 1, last))
            trials = [[*sharp[:k], other, *sharp[k + 1 :]] for other in nearby]
            found = [
                self.noise(self._design(constant, trial), without).log_likelihood
                for trial in trials
            ]
            sharp = trials[int(np.argmax(found))]
        return sharp

    def _design(
        self, shape: Float[np.ndarray, " w"], places: list[int]
    ) -> Float[np.ndarray, "w q"]:
        return np.hstack([self.columns, shape[:, None] * _steps(places, len(shape))])

    @cached_property
    def _of_columns(self) -> Float[np.ndarray, "w r"]:
        return _basis(self.columns)

    def _basis(self, shape: Float[np.ndarray, " w"], places: list[int]) -> Float[np.ndarray, "w r"]:
        """Return an orthonormal basis of the columns and of steps, which are independent."""
        basis = self._of_columns
        if not places:
            return basis
        steps = shape[:, None] * _steps(places, len(shape))
        for _ in range(2):  # the second time removes the rounding errors of the first
            steps = _without(basis, steps)
        return np.hstack([basis, np.linalg.qr(steps)[0]])

    def _best_place(self, shape: Float[np.ndarray, " w"], taken: list[int]) -> int | None:
        """Return the index at which one more step reduces the sum of squares most, or None.

        Indices near the steps at `taken` are excluded.
        """
        count = len(self.values)
        basis = self._basis(shape, taken)
        residual = _without(basis, self.values)
        # The column of step k is `shape` from row k on, so its products are sums over the tail.
        tail = np.cumsum((shape[:, None] * basis)[::-1], axis=0)[::-1]
        places, after = np.arange(count), np.cumsum(shape[::-1] ** 2)[::-1]
        remainder = after - np.sum(tail**2, axis=1)
        usable = np.minimum(places, count - places) >= NEAR // 2
        usable &= remainder > LEAST_REMAINDER * np.minimum(after[0] - after, after)
        for place in taken:  # steps within a few values are the same step
            usable &= np.abs(places - place) > NEAR
        if not usable.any():
            return None
        drop = np.cumsum((shape * residual)[::-1])[::-1] ** 2
        return int(np.argmax(drop / np.where(usable, remainder, np.inf)))


def _steps(places: list[int], count: int) -> Float[np.ndarray, "w s"]:
    return (np.arange(count)[:, None] >= np.array(places, np.int64)[None, :]).astype(np.float64)


def _without(
    basis: Float[np.ndarray, "w r"], values: Float[np.ndarray, " w *k"]
) -> Float[np.ndarray, " w *k"]:
    return values - basis @ (basis.T @ values)


def _basis(columns: Float[np.ndarray, "w p"]) -> Float[np.ndarray, "w r"]:
    return orthonormal_basis(columns, 1e-6)


def _measured(
    values: Float[np.ndarray, " w"],
    columns: Float[np.ndarray, "w p"],
    places: list[int],
    least: float,
) -> list[Step]:
    """Fit steps at `places` together with `columns`; return those of at least the size `least`."""
    count, width = columns.shape
    steps = _steps(places, count)
    design = np.hstack([columns, steps])
    solution = np.linalg.lstsq(design, values, rcond=1e-9)[0]
    residual = values - design @ solution
    sigma = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    sigma *= np.sqrt(count / max(count - _basis(design).shape[1], 1))
    power = max(float(residual @ residual), 1e-300)
    correlation = np.clip(residual[1:] @ residual[:-1] / power, 0.0, 0.95)
    found = []
    for k, place in enumerate(places):
        size = float(solution[width + k])
        if abs(size) < max(least, 1e-12 * float(np.ptp(values))):
            continue
        level = residual + size * steps[:, k]
        others = _basis(np.delete(design, width + k, axis=1))
        remainder = _without(others, steps[:, k])
        std = sigma * np.sqrt((1 + correlation) / (1 - correlation) / (remainder @ remainder))
        base = float(np.median(level[max(0, place - NEAR) : place]))
        found.append(Step(place, size, float(std), base, solution[:width]))
    return found
