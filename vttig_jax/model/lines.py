"""Lines of the residual that are no order of the model: their frequencies become columns."""

import numpy as np

from ..logs.lines.rows import Stretch, highest_resolved
from ..logs.lines.search import Line, find_lines
from .mixed_fit import MixedFit

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
