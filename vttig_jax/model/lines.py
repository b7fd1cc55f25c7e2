"""Lines of the residual that are no order of the model: their frequencies become columns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from jaxtyping import Float

from ..base.units import ARCSEC, DEG
from ..logs.lines.rows import Stretch, highest_resolved
from ..logs.lines.search import Line, find_lines
from .mixed_fit import MixedFit
from .rows import Rows, Shafts

_SETTLED, _MOST_FITS, _RESOLVED = 0.3, 3, 2.0
_HIGHEST, _FALSE_ALARM, _MOST, _APART = 12.0, 1e-6, 3, 4.0


def found_lines(fit: MixedFit) -> list[Line]:
    """Return lines of the residual that are no order of the model.

    Logs with zeros of their own are searched one by one: no start angle tells the phase of a line.
    """
    left = fit.residual
    good = np.ones(len(left), bool) if fit.weights is None else np.concatenate(fit.weights) > 0.5
    logs, first = [], 0
    for rows in fit.rows:
        logs.append([])
        for a, b, side in zip(rows.first, rows.last, rows.side, strict=True):
            own = np.arange(a, b + 1)
            own = own[good[first + own]]
            if len(own) > 3:
                flank = "A" if side > 0 else "B"
                one = np.ones((len(own), 1))
                logs[-1].append(Stretch(rows.angle[own], left[first + own], one, flank))
        first += len(rows.table)
    if not any(any(one.start.spread) for one in fit.shafts):
        logs = [list(chain(*logs))]
    found: list[Line] = []
    for runs in logs:
        highest = min(_HIGHEST, highest_resolved(runs, 3.0)) if runs else 0.0
        if highest >= 1:
            found += find_lines(runs, highest=highest, false_alarm=_FALSE_ALARM, most=_MOST)
    known = [wave.cycles(fit.scope.ratio) for wave in fit.waves]
    apart = _RESOLVED / fit.scope.turns["driving"] if len(logs) > 1 else 0.0
    lines: list[Line] = []
    for line in sorted(found, key=lambda one: one.false_alarm):
        cycles = line.cycles_per_rev
        new = all(abs(cycles - k) > _APART * line.cycles_std for k in known)
        if new and all(abs(cycles - one.cycles_per_rev) >= apart for one in lines):
            lines.append(line)
    return lines[:_MOST]


@dataclass(frozen=True, eq=False)
class Shifts:
    """Derivatives of lines by their frequencies c: φ₁ (S cos cφ₁ − C sin cφ₁), as `Extra` columns.

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

    @property
    def highest_order(self) -> float:
        """Highest frequency."""
        return max(self.cycles)

    def joined(self, shafts: Shafts, rows: Rows, delay_s: float) -> Rows:
        """Return the rows with the derivatives as columns."""
        angle = rows.angle - np.mean(rows.angle) if len(rows.angle) else rows.angle
        own = []
        for cycles, (sine, cosine), free in zip(self.cycles, self.waves, self.alone, strict=True):
            if not free:
                continue
            wave = [rows.table[:, rows.names["line", cycles, part]] for part in ("cos", "sin")]
            own.append(angle * (sine * wave[0] - cosine * wave[1]))
        return rows.joined(dict(zip([("given", name) for name in self.told], own, strict=True)))


def refined(
    lines: Sequence[Line],
    turns: float,
    fit: Callable[[tuple[float, ...], Shifts], MixedFit],
) -> tuple[MixedFit, list[Line]]:
    """Return the fit with lines as orders, and the lines with the frequencies of that fit.

    The frequency is not linear: its derivative is a column, and the fit is repeated until the steps
    are small. Lines that `turns` driving turns do not resolve keep their frequencies. `fit` is a
    function of the frequencies and their derivatives.
    """
    cycles = np.array([float(f"{line.cycles_per_rev:.7g}") for line in lines])
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
            place: posterior.one(posterior.row(("given", f"line {place}")))
            for place in np.flatnonzero(alone).tolist()
        }
        moved = cycles.copy()
        for place, step in steps.items():
            moved[place] += step.value
        waves = np.array(
            [
                [posterior.moved[index["line", c, part, False, 0]] for part in ("sin", "cos")]
                for c in shifts.cycles
            ]
        )
        settled = all(abs(step.value) < _SETTLED * step.std for step in steps.values())
        if settled or number == _MOST_FITS:
            break
        cycles = np.array([float(f"{one:.7g}") for one in moved])
    return core, [
        replace(
            line,
            cycles_per_rev=float(moved[place]),
            cycles_std=steps[place].std if place in steps else line.cycles_std,
        )
        for place, line in enumerate(lines)
    ]
