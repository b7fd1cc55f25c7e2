"""Slips of an encoder: lasting steps of the transmission error.

An encoder that slips on its shaft, lost counts or a jumped tooth leave both channels smooth; only
TE = φ₂ − i φ₁ shows them. A robust fit removes all other effects from TE: an offset of each flank
at each speed (backlash, delay, torque of the drive), drift, orders 1 to 4 of both shafts on each
flank, delay times speed, and logged torque. Then steps are searched by least squares in the medians
of the residual over short windows, together with these effects, in coloured noise with outliers.
All limits are chosen values unless they say otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.errors import LogError
from ...base.numerics.student_noise import NoiseFit, fit_student_noise
from ...base.numerics.well_conditioned import orthonormal_basis, pseudo_inverse
from ...base.units import DEG, REV
from ..channel.speed import runs
from ..encoder_log import EncoderLog
from ..lines.rows import scaled
from ..motion.segments import Segments, groups_of_speed

ORDERS = 4
"""Number of orders of each shaft in the fit."""


def effects_of(
    log: EncoderLog,
    rows: Int[np.ndarray, " m"],
    group: Int[np.ndarray, " m"],
    forward: Bool[np.ndarray, " m"],
) -> Float[np.ndarray, "m p"]:
    """Return the design matrix of all effects in TE except a slip, with columns scaled to about 1.

    The columns are the speed, the drift, an offset of every group, cosine and sine of every order
    on each flank, and the torque if it was logged.

    **Arguments**
    - `rows`: the samples of the log, with their `group` and whether flank A is in contact
      (`forward`).
    """
    time, angles = log.time[rows], (log.driving_angle[rows], log.driven_angle[rows])
    drift = (time - time.mean()) / max(float(np.ptp(time)), 1e-300)
    columns = [scaled(log.driving_speed.value[rows]), drift]
    columns += [group == number for number in range(int(group.max()) + 1)]
    flanks = [flank for flank in (forward, ~forward) if flank.any()]
    for turn in (np.exp(1j * angle) for angle in angles):
        wave = turn
        for _ in range(ORDERS):
            columns += [part * flank for part in (np.real(wave), np.imag(wave)) for flank in flanks]
            wave = wave * turn
    if log.torque is not None:
        columns.append(scaled(log.torque[rows]))
    return np.stack(columns, axis=1, dtype=np.float64)


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
    least: float,
    rival: Float[np.ndarray, " w"],
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
    series = _Series(values, columns, np.ones(len(values)), _FLOOR * least)
    if series.squares_ratio(series.places(FIRST)) < EVIDENCE / 2:
        return []
    without = series.noise([])
    places, score = series.judged(without)
    if not places or replace(series, shape=rival).judged(without)[1] > score + _BETTER:
        return []
    return series.measured(series.sharpened(places, without), least)


@dataclass(frozen=True, eq=False)
class _Series:
    """Series and its regressors `columns`; `floor` is the least standard deviation of the noise.

    The regressor of a step is 0 before its index and `shape` from its index on; ones give a step of
    the value.
    """

    values: Float[np.ndarray, " w"]
    columns: Float[np.ndarray, "w p"]
    shape: Float[np.ndarray, " w"]
    floor: float

    def steps(self, places: Sequence[int]) -> Float[np.ndarray, "w s"]:
        """Return the regressors of steps."""
        rows = np.arange(len(self.shape))[:, None]
        return self.shape[:, None] * (rows >= np.array(places, np.int64))

    def places(self, most: int) -> list[int]:
        """Return up to `most` indices at which a step reduces the sum of squares most.

        The steps are found one after the other.
        """
        places: list[int] = []
        while len(self.values) >= 4 * NEAR and len(places) < most:
            place = self._best_place(places)
            if place is None:
                break
            places.append(place)
        return places

    def fewer(self, places: list[int]) -> list[int]:
        """Return the steps without the one that is missed least, each moved to its best place."""
        inverse = np.linalg.pinv(self._beside_columns(places))
        missed = (inverse @ self.values) ** 2 / np.sum(inverse**2, axis=1)
        left = np.delete(places, np.argmin(missed)).tolist()
        found = self.squares_ratio(left)
        for k in range(len(left)):
            place = self._best_place([*left[:k], *left[k + 1 :]])
            if place is not None and place != left[k]:
                other = [*left[:k], place, *left[k + 1 :]]
                if (better := self.squares_ratio(other)) > found:
                    left, found = other, better
        return left

    def squares_ratio(self, places: list[int]) -> float:
        """Return n ln (S₀ / S₁) with the number n of values.

        S₀ is the sum of squares without steps, S₁ that with steps at `places`.
        """
        rests = [_without(self._basis(used), self.values) for used in ([], places)]
        before, after = (max(float(rest @ rest), 1e-300) for rest in rests)
        return len(self.values) * float(np.log(before / after))

    def noise(self, places: list[int], *starts: NoiseFit, **choices: Any) -> NoiseFit:
        """Return the noise model of largest likelihood, fitted together with columns and steps.

        `starts` are further fits from which the search starts.
        """
        design = np.hstack([self.columns, self.steps(places)])
        return fit_student_noise(self.values, design, *starts, floor=self.floor, **choices)

    def judged(self, without: NoiseFit) -> tuple[list[int], float]:
        """Return the places of the steps to accept, and 2 Δ ln L minus its threshold.

        `without` is the noise model without steps. If no step is accepted, the second value is 0.
        Noise whose level wanders by innovations with heavier tails than those beside the steps is
        no rival: it calls every step an outlier.
        """

        @cache
        def usual(order: int | None, tails: float) -> float:
            return self.noise([], without, order=order, least_freedom=tails).log_likelihood

        accepted, best, places = [], 0.0, self.places(MOST)
        while places:
            least = EVIDENCE + FURTHER * (len(places) - 1)
            if self.squares_ratio(places) >= least / 2:
                found = self.noise(places, without)
                beside = max(usual(order, found.freedom) for order in (None, found.order))
                score = 2 * (found.log_likelihood - beside) - least
                if score >= best:
                    accepted, best = places, score
            places = self.fewer(places)
        return sorted(accepted), best

    def sharpened(self, places: list[int], without: NoiseFit) -> list[int]:
        """Return the indices of the steps, each moved to the nearby index of largest likelihood."""
        sharp, last = list(places), len(self.values) - 1
        for k, place in enumerate(places):
            nearby = range(max(place - NEAR // 2, 1), min(place + NEAR // 2 + 1, last))
            trials = [[*sharp[:k], other, *sharp[k + 1 :]] for other in nearby]
            sharp = max(trials, key=lambda trial: self.noise(trial, without).log_likelihood)
        return sharp

    def measured(self, places: list[int], least: float) -> list[Step]:
        """Fit steps at `places` with the columns; return those of at least the size `least`."""
        values, (count, width) = self.values, self.columns.shape
        steps = self.steps(places)
        design = np.hstack([self.columns, steps])
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

    @cached_property
    def _of_columns(self) -> Float[np.ndarray, "w r"]:
        return _basis(self.columns)

    def _beside_columns(self, places: list[int]) -> Float[np.ndarray, "w s"]:
        """Return the parts of steps that are orthogonal to the columns."""
        steps = self.steps(places)
        for _ in range(2):  # the second time removes the rounding errors of the first
            steps = _without(self._of_columns, steps)
        return steps

    def _basis(self, places: list[int]) -> Float[np.ndarray, "w r"]:
        """Return an orthonormal basis of the columns and of steps, which are independent."""
        if not places:
            return self._of_columns
        return np.hstack([self._of_columns, np.linalg.qr(self._beside_columns(places))[0]])

    def _best_place(self, taken: list[int]) -> int | None:
        """Return the index at which one more step reduces the sum of squares most, or None.

        Indices near the steps at `taken` are excluded.
        """
        count, shape, basis = len(self.values), self.shape, self._basis(taken)
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


def _without(
    basis: Float[np.ndarray, "w r"], values: Float[np.ndarray, " w *k"]
) -> Float[np.ndarray, " w *k"]:
    return values - basis @ (basis.T @ values)


def _basis(columns: Float[np.ndarray, "w p"]) -> Float[np.ndarray, "w r"]:
    return orthonormal_basis(columns, 1e-6)


MOST_ROWS = 40_000
"""Largest number of rows of the fit; longer logs are thinned."""

WINDOWS = 600
LEAST = 4
"""Largest number of windows over the whole log (about), and least number of rows per window."""

LEAST_TURNS = 2.0
"""Least number of driving turns for a search; over fewer turns a part of a harmonic looks like a
step."""

SAME_SPEED = 0.1
"""Segments of one flank within this relative difference of speed share an offset."""


@dataclass(frozen=True)
class Slip:
    """Step of the transmission error by `size_deg` (degrees of the driven shaft) at `time_s`.

    `row` is the index of the first sample after the step; `std_deg` is the standard error of the
    size.
    """

    time_s: float
    row: int
    size_deg: float
    std_deg: float


def slips_text(slips: Sequence[Slip]) -> str:
    """Return a sentence that reports every slip and says what the user can do."""
    where = [f"by {one.size_deg:.3g}° at {one.time_s:.6g} s" for one in slips]
    if len(slips) == 1:
        return (
            f"the transmission error steps {where[0]} and stays: an encoder slipped on its shaft or"
            f" a tooth jumped; cut the log at {slips[0].time_s:.6g} s and fit both parts as two"
            " logs."
        )
    many = "at least " if len(slips) == MOST else ""
    return (
        f"the transmission error steps {many}{len(slips)} times and stays: {', '.join(where)}: an"
        " encoder loses counts or slips on its shaft, or teeth jump; mend this and log again, or"
        " cut the log there and fit the parts as logs of their own."
    )


def find_slips(log: EncoderLog, segments: Segments) -> tuple[Slip, ...]:
    """Return the lasting steps of the transmission error in the order of time.

    **Arguments**
    - `segments`: result of `find_segments` for `log`; samples outside the segments are not used,
      because the flank in contact is not known there.

    Steps are reported if they raise the likelihood enough, unless steps of the delay explain the
    log clearly better; see `find_steps`. One cannot be detected if the flank or the speed changes
    permanently at the same instant.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs import EncoderLog
    >>> from vttig_jax.logs import find_segments
    >>> from vttig_jax.logs import find_slips
    >>> from vttig_jax.pair import parse_pair_spec
    >>> drive = parse_pair_spec({"drive": {"ratio": "9/16"}})
    >>> time = np.arange(4000) / 200.0
    >>> wave = 0.02 * np.sin(2 * np.pi * time)
    >>> driven = 202.5 * time + wave + 0.1 * (time > 12.0)
    >>> log = EncoderLog.from_arrays(time, 360.0 * time, driven, pair=drive, unit="deg")
    >>> (slip,) = find_slips(log, find_segments(log))
    >>> slip.row, round(slip.size_deg, 2)
    (2401, 0.1)

    ```
    """
    rows, segment_of, group, forward = _rows(log, segments)
    if len(rows) < 4 * LEAST or np.ptp(log.driving_angle[rows]) < LEAST_TURNS * REV:
        return ()
    edges = _window_starts(segment_of)
    if len(edges) < 4:
        return ()
    effects = effects_of(log, rows, group, forward)
    residual = _huber_residual(effects, log.transmission_error[rows])
    size = np.diff([*edges, len(rows)])
    medians = np.array([np.median(window) for window in np.split(residual, edges[1:])])
    means = np.add.reduceat(effects, edges, axis=0) / size[:, None]
    # Least size in rad of the driven shaft: half the scatter of the residual, a multiple of the
    # rounding error, and one count of both encoders, whose rounding may differ from pass to pass.
    # The step of readings in degrees is their travel per sample.
    counts = 0.0
    for channel, ratio in ((log.driving, abs(float(log.ratio))), (log.driven, 1.0)):
        if channel is not None and channel.unit == "counts":
            counts += ratio * channel.resolution
    scatter = 0.5 * float(np.median(np.abs(residual))) / 0.6745
    least, found = max(scatter, _DIGITS * log.rounding, counts), []
    for step in find_steps(medians, means, least, rival=means[:, 0]):
        # The first sample after the step, within two windows of it: the best split of `level` has
        # the largest sum of `side` behind it.
        low, high = (int(edges[np.clip(step.window + k, 0, len(edges) - 1)]) for k in (-2, 2))
        level = (residual - effects @ step.coefficients)[low:high] - step.base
        side = np.clip(level / step.size - 0.5, -0.5, 0.5)
        after = side.sum() - np.concatenate([[0.0], np.cumsum(side)])[:-1]
        row = int(rows[low + int(np.argmax(after))])
        found.append(Slip(float(log.time[row]), row, step.size / DEG, step.std / DEG))
    return tuple(found)


def refuse_slip(log: EncoderLog, segments: Segments) -> None:
    """Raise `LogError` if `find_slips` finds slips, because a fit of the log would be wrong."""
    if slips := find_slips(log, segments):
        raise LogError(slips_text(slips), where=log.place.at(row=slips[0].row))


_HUBER_STEPS = 5  # number of reweightings; the weights hardly change after four; chosen value
_FITTED = 200  # rows of the Huber fit per column of its design matrix; chosen value
_DEPENDENT = 1e-12
"""Columns count as dependent if an eigenvalue of the normal matrix is below this share of the
largest one (chosen)."""

_DIGITS = 100.0
"""Largest step that rounding can cause, as a multiple of the rounding error of the TE."""


def _rows(
    log: EncoderLog, segments: Segments
) -> tuple[
    Int[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " m"], Bool[np.ndarray, " m"]
]:
    """Select the samples of the fit, and return four arrays with one entry per selected sample.

    A sample is selected if it belongs to a segment, where the contacting flank is known, and is not
    a spike. A long log is thinned to about `MOST_ROWS` samples.

    **Returns** the index of the sample in the log, the number of its segment in the order of time,
    the number of its group of one flank and one speed, and True if flank A is in contact.
    """
    thin = max(1, (segments.forward + segments.backward) // MOST_ROWS)
    parts = segments.segments
    kept = [np.arange(one.start, one.stop, thin) for one in parts]
    kept = [rows[~log.spikes[rows]] for rows in kept]
    lengths = [len(rows) for rows in kept]
    rows = np.concatenate([np.zeros(0, np.int64), *kept])
    segment_of = np.repeat(np.arange(len(parts), dtype=np.int64), lengths)
    group = np.repeat(np.array(groups_of_speed(parts, SAME_SPEED), np.int64), lengths)
    forward = np.repeat(np.array([one.flank == "A" for one in parts], bool), lengths)
    return rows, segment_of, group, forward


def _huber_residual(
    effects: Float[np.ndarray, "m p"], error: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Return the residual of a Huber fit of `error` by `effects`; outliers have little influence.

    The fit uses one random row of every few neighbouring rows, about `_FITTED` rows per column. The
    choice is random, so that outliers at equal distances are not taken every time. `find_steps`
    fits the coefficients again together with the steps. Every iteration solves the weighted normal
    equations for a correction of the coefficients, which removes rounding errors of earlier
    iterations.
    """
    count, columns = effects.shape
    step = max(1, count // (_FITTED * columns))
    first = np.arange(0, count - step + 1, step)
    few = first + np.random.default_rng(0).integers(step, size=len(first))
    table, left, weight = effects[few], error[few], np.ones(len(few))
    changes = []
    for _ in range(_HUBER_STEPS):
        weighted = (table * weight[:, None]).T
        changes.append(pseudo_inverse(weighted @ table, _DEPENDENT) @ (weighted @ left))
        left = left - table @ changes[-1]
        scale = 1.5 * float(np.median(np.abs(left))) / 0.6745
        weight = scale / np.maximum(np.abs(left), max(scale, 1e-300))
    return error - effects @ changes[0] - effects @ np.sum(changes[1:], axis=0)


def _window_starts(segment_of: Int[np.ndarray, " m"]) -> Int[np.ndarray, " w"]:
    """Return the first index of every window; windows have similar length, each in one segment."""
    length = max(LEAST, len(segment_of) // WINDOWS)
    edges = []
    for start, stop in runs(segment_of):
        parts = max(1, (stop - start) // length)
        edges += [start + (stop - start) * k // parts for k in range(parts)]
    return np.array(edges, np.int64)
