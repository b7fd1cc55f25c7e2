"""Lines of the residual that are no order of the model: their frequencies become columns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..base.units import ARCSEC, DEG
from ..logs.lines.rows import Stretch, highest_resolved
from ..logs.lines.search import Line, find_lines
from .mixed_fit import MixedFit
from .rows import Rows, Shafts

_SETTLED, _MOST_FITS = 0.3, 3
_HIGHEST, _FALSE_ALARM, _MOST, _APART = 12.0, 1e-6, 3, 4.0


def found_lines(fit: MixedFit) -> list[Line]:
    """Return lines of the residual that are no order of the model."""
    left = fit.residual
    good = np.ones(len(left), bool) if fit.weights is None else np.concatenate(fit.weights) > 0.5
    runs, first = [], 0
    for rows in fit.rows:
        for a, b, side in zip(rows.first, rows.last, rows.side, strict=True):
            own = np.arange(a, b + 1)
            own = own[good[first + own]]
            if len(own) > 3:
                flank = "A" if side > 0 else "B"
                one = np.ones((len(own), 1))
                runs.append(Stretch(rows.angle[own], left[first + own], one, flank))
        first += len(rows.table)
    highest = min(_HIGHEST, highest_resolved(runs, 3.0))
    if highest < 1:
        return []
    known = [wave.cycles(fit.scope.ratio) for wave in fit.waves]
    lines = find_lines(runs, highest=highest, false_alarm=_FALSE_ALARM, most=_MOST)
    return [
        line
        for line in lines
        if all(abs(line.cycles_per_rev - k) > _APART * line.cycles_std for k in known)
    ]


@dataclass(frozen=True, eq=False)
class Shifts:
    """Derivatives of lines by their frequencies c: φ₁ (S cos cφ₁ − C sin cφ₁), as `Extra` columns.

    **Arguments**
    - `cycles`: frequencies, cycles per driving turn.
    - `waves`: S and C of every line, rad: coefficients of the sine and the cosine.
    """

    cycles: tuple[float, ...]
    waves: Float[np.ndarray, "lines 2"]

    @property
    def told(self) -> tuple[str, ...]:
        """Names of the lines."""
        return tuple(f"line {place}" for place in range(len(self.cycles)))

    @property
    def highest_order(self) -> float:
        """Highest frequency."""
        return max(self.cycles)

    def joined(self, shafts: Shafts, rows: Rows, delay_s: float) -> Rows:
        """Return the rows with the derivatives as columns."""
        angle = rows.angle - np.mean(rows.angle) if len(rows.angle) else rows.angle
        names = [name for name in rows.names if name != ("y",)]
        own = []
        for cycles, (sine, cosine) in zip(self.cycles, self.waves, strict=True):
            wave = [rows.table[:, rows.names["line", cycles, part]] for part in ("cos", "sin")]
            own.append(angle * (sine * wave[0] - cosine * wave[1]))
        names += [("given", name) for name in self.told]
        return replace(
            rows,
            names={name: place for place, name in enumerate((*names, ("y",)))},
            table=np.column_stack([rows.table[:, :-1], *own, rows.table[:, -1]]),
        )


def refined(
    lines: Sequence[Line], fit: Callable[[tuple[float, ...], Shifts], MixedFit]
) -> tuple[MixedFit, list[Line]]:
    """Return the fit with lines as orders, and the lines with the frequencies of that fit.

    The frequency is not linear: its derivative is a column, and the fit is repeated until the steps
    are small. `fit` is a function of the frequencies and their derivatives.
    """
    cycles = np.array([float(f"{line.cycles_per_rev:.7g}") for line in lines])
    phase = np.array([line.phase_deg for line in lines]) * DEG
    size = np.array([line.amplitude_arcsec for line in lines]) * ARCSEC
    waves = np.stack([size * np.cos(phase), size * np.sin(phase)], axis=1)
    number = 0
    while True:
        number += 1
        shifts = Shifts(tuple(map(float, cycles)), waves)
        core = fit(shifts.cycles, shifts)
        posterior, index = core.posterior, core.posterior.problem.index
        steps = [posterior.one(posterior.row(("given", name))) for name in shifts.told]
        moved = cycles + [step.value for step in steps]
        waves = np.array(
            [
                [posterior.moved[index["line", c, part, False, 0]] for part in ("sin", "cos")]
                for c in shifts.cycles
            ]
        )
        settled = all(abs(step.value) < _SETTLED * step.std for step in steps)
        if settled or number == _MOST_FITS:
            break
        cycles = np.array([float(f"{one:.7g}") for one in moved])
    return core, [
        replace(line, cycles_per_rev=float(c), cycles_std=step.std)
        for line, c, step in zip(lines, moved, steps, strict=True)
    ]
