"""Lines of the residual that are no order of the model: their frequencies become columns."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float

from ..base.numerics.polar_spread import polar_spread
from ..base.units import ARCSEC, DEG
from ..logs.lines.rows import Stretch, highest_resolved
from ..logs.lines.search import Line, find_lines
from .columns import RATIO, ColumnName
from .mixed_fit import MixedFit, residuals
from .rows import Extra, RowName, Rows, Shafts, rows_of

_SETTLED, _MOST_FITS, _RESOLVED = 0.3, 3, 2.0
_HIGHEST, _FALSE_ALARM, _MOST, _APART = 12.0, 1e-6, 3, 4.0


def found_lines(fit: MixedFit) -> list[Line]:
    """Return lines of the residual that are no order of the model, their cycles to seven digits.

    Logs with zeros of their own are searched one by one: no start angle tells the phase of a line.
    """
    logs = _stretches(fit.rows, fit.residual, fit.good)
    if not any(any(one.start.spread) for one in fit.shafts):
        logs = [list(chain(*logs))]
    found = list(chain(*(_searched(runs, least=1.0, most=_HIGHEST) for runs in logs)))
    known = [wave.cycles(fit.scope.ratio) for wave in fit.waves]
    apart = _RESOLVED / fit.scope.turns["driving"] if len(logs) > 1 else 0.0
    lines: list[Line] = []
    for line in sorted(found, key=lambda one: one.false_alarm):
        cycles = line.cycles_per_rev
        new = all(abs(cycles - k) > _APART * line.cycles_std for k in known)
        if new and all(abs(cycles - one.cycles_per_rev) >= apart for one in lines):
            lines.append(replace(line, cycles_per_rev=float(f"{cycles:.7g}")))
    return lines[:_MOST]


def short_lines(fit: MixedFit) -> list[Line]:
    """Return lines of a table of one turn or two whose cycles are shorter than the search above.

    Rows of a quarter of the length show them. They are told, and not joined: an encoder has them at
    whole orders, which the user can list.
    """
    if fit.scope.turns["driving"] >= _RESOLVED:
        return []
    problem, fine = fit.posterior.problem, []
    ratio = RATIO in problem.index
    for one, rows in zip(fit.shafts, fit.rows, strict=True):
        row_s = 0.25 * rows.samples.shape[1] * one.interval_s
        fine.append(rows_of(one, fit.waves, row_s, fit.delay_s, fit.bends, ratio=ratio))
    left = np.concatenate(residuals(problem.columns, fine, fit.posterior.coefficients))
    runs = list(chain(*_stretches(fine, left, np.isfinite(left))))
    found = _searched(runs, least=_HIGHEST, most=math.inf)
    return [line for line in found if line.cycles_per_rev > _HIGHEST]


def _searched(runs: Sequence[Stretch], *, least: float, most: float) -> Sequence[Line]:
    """Return lines of up to `most` cycles a turn, none if the runs do not resolve the `least`."""
    highest = min(most, highest_resolved(runs, 3.0)) if runs else 0.0
    if highest < least:
        return []
    return find_lines(runs, highest=highest, false_alarm=_FALSE_ALARM, most=_MOST)


def _stretches(
    logs: Sequence[Rows], left: Float[np.ndarray, " n"], good: Bool[np.ndarray, " n"]
) -> list[list[Stretch]]:
    """Return the runs of every log with the residuals `left` of their `good` rows."""
    found, first = [], 0
    for rows in logs:
        found.append([])
        for a, b, flank in zip(rows.first, rows.last, rows.flanks, strict=True):
            own = np.arange(a, b + 1)
            own = own[good[first + own]]
            if len(own) > 3:
                one = np.ones((len(own), 1))
                found[-1].append(Stretch(rows.angle[own], left[first + own], one, flank))
        first += len(rows.table)
    return found


@dataclass(frozen=True, eq=False)
class Shifts(Extra):
    """Derivatives of lines by their frequencies c: φ₁ (S cos cφ₁ − C sin cφ₁).

    **Arguments**
    - `cycles`: frequencies, cycles per driving turn.
    - `waves`: S and C of every line, rad: coefficients of the sine and the cosine.
    - `alone`: whether the frequency is a parameter.
    """

    cycles: tuple[float, ...]
    waves: Float[np.ndarray, "lines 2"]
    alone: tuple[bool, ...]

    @property
    def told(self) -> tuple[str, ...]:
        """Names of the lines."""
        return tuple(f"line {place}" for place, free in enumerate(self.alone) if free)

    def with_derivatives(self, shafts: Shafts, rows: Rows, delay_s: float) -> Rows:
        """Return the rows with the derivatives as columns."""
        angle = rows.angle - np.mean(rows.angle) if len(rows.angle) else rows.angle
        own = []
        for cycles, (sine, cosine), free in zip(self.cycles, self.waves, self.alone, strict=True):
            if not free:
                continue
            cos, sin = (rows.column(RowName("line", cycles, part)) for part in ("cos", "sin"))
            own.append(angle * (sine * cos - cosine * sin))
        names = [RowName("given", name) for name in self.told]
        return rows.with_columns(dict(zip(names, own, strict=True)))


def refined(
    lines: Sequence[Line], turns: float, fit: Callable[[tuple[float, ...], Shifts], MixedFit]
) -> tuple[MixedFit, list[Line]]:
    """Return the fit with lines as orders, and the lines with the frequencies of that fit.

    The frequency is not linear: its derivative is a column, and the fit is repeated until the steps
    are small. Lines that `turns` driving turns do not resolve keep their frequencies. `fit` is a
    function of the frequencies and their derivatives.

    A line has the frequency, the amplitude and the phase (of the mean of both flanks) that it has
    in the model, so that one fit has one number for each. The last step, which is not taken, counts
    in the standard error of the frequency.
    """
    cycles = np.array([line.cycles_per_rev for line in lines])
    apart = np.abs(cycles[:, None] - cycles) + np.where(np.eye(len(lines)) > 0, np.inf, 0.0)
    alone = apart.min(axis=1) > _RESOLVED / turns
    phase = np.array([line.phase_deg for line in lines]) * DEG
    size = np.array([line.amplitude_arcsec for line in lines]) * ARCSEC
    waves = np.stack([size * np.cos(phase), size * np.sin(phase)], axis=1)
    number = 0
    while True:
        number += 1
        shifts = Shifts(tuple(map(float, cycles)), waves, tuple(map(bool, alone)))
        core = fit(shifts.cycles, shifts)
        posterior, index = core.posterior, core.posterior.problem.index
        steps = {
            place: posterior.one(posterior.row(ColumnName(RowName("given", f"line {place}"))))
            for place in np.flatnonzero(alone).tolist()
        }
        for place, step in steps.items():
            cycles[place] = float(f"{cycles[place] + step.value:.7g}")
        rows = [RowName("line", cycle, part) for cycle in shifts.cycles for part in ("sin", "cos")]
        own = [index[ColumnName(row, 0)] for row in rows]
        waves = posterior.moved[own].reshape(-1, 2)
        settled = all(abs(step.value) < _SETTLED * step.std for step in steps.values())
        if settled or number == _MOST_FITS:
            break
    spread = posterior.told(np.eye(len(posterior.problem.columns))[own], moved=True)[1]
    found = []
    for place, line in enumerate(lines):
        both = slice(2 * place, 2 * place + 2)
        size, std, phase_deg, _ = polar_spread(
            waves[place] / ARCSEC, spread[both, both] / ARCSEC**2
        )
        told = {"amplitude_arcsec": size, "amplitude_std_arcsec": std, "phase_deg": phase_deg}
        if (step := steps.get(place)) is not None:
            told["cycles_std"] = math.hypot(step.std, step.value)
        found.append(replace(line, cycles_per_rev=shifts.cycles[place], **told))
    return core, found
