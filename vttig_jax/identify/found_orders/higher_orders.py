"""Whole orders above the listed ones that a log shows join the model of its fit.

The search for lines of the residual does not reach them: the rows of a fit are as long as its
highest order allows. They are searched in shorter means of the transmission error itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...base.numerics.counting import whole_below
from ...base.threads import one_blas_thread
from ...base.units import ARCSEC, REV
from ...logs.lines.whole_orders import Run, whole_orders
from ...logs.motion.segments import Segment
from ...pair.schema import HarmonicOrders
from ..compress.block_means import block_means
from ..compress.block_rows import turns_of
from ..compress.regressors import Regressors, trimmed
from ..model.harmonics import RESOLVED, Harmonic, harmonic_of, names_of
from ..solve.solved_fit import SolvedFit

_USUAL = 8
"""Orders up to this one are the choice of who lists orders; a fit without a list has all of them.
"""

HIGHEST = 32  # highest order of a shaft that is searched; chosen value
_SAMPLES_PER_CYCLE = 5.0  # fewest samples per cycle of an order that is searched; chosen value
_MEANS_PER_CYCLE = 8.0  # fewest means per cycle of the highest order; chosen value

_CERTAIN, _CERTAIN_ON_FEW_TURNS = 1e-6, 1e-12
"""Largest false-alarm probability of an order that joins, as that of a line (chosen)."""

_SHARE = 0.01
"""Least share of the variance of the residual that an order must be to join; chosen value."""

_MOST = 12  # largest number of orders that join, the strongest ones; chosen value


@dataclass(frozen=True)
class Higher:
    """Orders above the listed ones that a log shows, strongest first.

    `amplitudes` are the largest of all flanks and logs, rad, and `share` is that of all of them in
    the variance of the residual, at most 1.
    """

    harmonics: tuple[Harmonic, ...]
    amplitudes: tuple[float, ...]
    false_alarm: float
    share: float

    def added(self, orders: HarmonicOrders) -> HarmonicOrders:
        """Return the listed orders with these ones."""
        more = {
            shaft: tuple(h.order for h in self.harmonics if h.shaft == shaft)
            for shaft in ("driving", "driven")
        }
        return HarmonicOrders(
            driving_orders=tuple(sorted((*orders.driving_orders, *more["driving"]))),
            driven_orders=tuple(sorted((*orders.driven_orders, *more["driven"]))),
            mesh_orders=orders.mesh_orders,
        )

    def sentence(self, *, joined: bool) -> str:
        """Return the note on these orders, which `joined` the model or are only reported."""
        names, several = names_of(self.harmonics), len(self.harmonics) > 1
        sizes = ", ".join(
            f"{a / ARCSEC:.3g}″ at {h.name}"
            for h, a in zip(self.harmonics, self.amplitudes, strict=True)
        )
        of_residual = (
            f"{100 * self.share:.0f} % of the variance that the listed orders leave, probability"
            f" {self.false_alarm:.1g} by chance"
        )
        if joined:
            return (
                f"{names} {'are' if several else 'is'} not listed, but the log shows"
                f" {'them' if several else 'it'} and {'they join' if several else 'it joins'} the"
                f" model ({of_residual}); --lines report leaves {'them' if several else 'it'} out"
            )
        return (
            f"{names} of the log {'are' if several else 'is'} not in the model: {sizes}"
            f" ({of_residual}); fit with --lines join, or list {'them' if several else 'it'} in"
            " [fit] of a pair file"
        )


@one_blas_thread
def higher_orders(solved: SolvedFit, *, few_turns: bool) -> Higher | None:
    """Return the orders above the listed ones that the logs certainly show, or None.

    An order counts if it is not noise on a flank of a log, if it is a share of the residual that
    matters, and if the logs tell its frequency from those of the model.
    """
    left = np.concatenate(solved.curves_and_residuals[1])
    variance = float(left @ left) / max(len(left), 1)
    seen: dict[Harmonic, tuple[float, float]] = {}
    tests = 0
    for shaft, runs, orders in _searched(solved):
        tests += len(orders)
        for one in whole_orders(runs, orders):
            harmonic = harmonic_of(shaft, one.order)
            amplitude, false_alarm = seen.get(harmonic, (0.0, 1.0))
            seen[harmonic] = (
                max(amplitude, one.amplitude),
                min(false_alarm, one.false_alarm),
            )
    certain = _CERTAIN_ON_FEW_TURNS if few_turns else _CERTAIN
    kept = [
        (h, amplitude, tests * false_alarm)
        for h, (amplitude, false_alarm) in seen.items()
        if tests * false_alarm <= certain and amplitude**2 > 2 * _SHARE * variance
    ]
    told = _told_apart(solved, sorted(kept, key=lambda one: -one[1]))[:_MOST]
    if not told:
        return None
    harmonics, amplitudes, chances = zip(*told, strict=True)
    share = min(sum(a**2 for a in amplitudes) / (2 * variance), 1.0) if variance else 1.0
    return Higher(harmonics, amplitudes, max(chances), share)


def _told_apart(
    solved: SolvedFit, found: Sequence[tuple[Harmonic, float, float]]
) -> list[tuple[Harmonic, float, float]]:
    """Return the orders whose frequencies differ from those of the model and of each other.

    A driven order with the frequency of a driving order is left out, whether that one was found or
    not: both are one line, and the angle of the driven shaft contains the error that is searched.
    """
    terms = solved.linear.model.terms
    turns = turns_of(solved.linear.rows)
    known = [float(terms.frequency(term)) for term in terms.terms]
    kept = []
    for one in sorted(found, key=lambda one: (one[0].shaft != "driving", one[0].order)):
        cycles = float(terms.frequency(one[0].term))
        others = [*known, round(cycles)] if one[0].shaft == "driven" else known
        if all(abs(cycles - other) * turns >= RESOLVED for other in others):
            known.append(cycles)
            kept.append(one)
    return sorted(kept, key=lambda one: -one[1])


def _searched(solved: SolvedFit) -> Iterator[tuple[str, list[Run], range]]:
    """Yield shaft, runs and orders of every search: each shaft on each flank of each log.

    A shaft none of whose orders is in the model is not searched.
    """
    linear = solved.linear
    terms = linear.model.terms.free + linear.model.terms.tied
    flanks = [flank.flank for flank in solved.summary.flanks]
    for channels, rows in zip(linear.channels, linear.rows, strict=True):
        own = [trimmed(run.segment, channels) for run in rows.runs]
        for flank in flanks:
            segments = [one for one in own if one.flank == flank]
            for shaft in ("driving", "driven"):
                listed = [h.order for h in terms if h.shaft == shaft]
                lowest = max([_USUAL, *map(int, listed)]) + 1
                per_turn = _samples_per_turn(getattr(channels, shaft), segments)
                highest = min(HIGHEST, whole_below(per_turn / _SAMPLES_PER_CYCLE))
                size = max(1, whole_below(per_turn / (_MEANS_PER_CYCLE * HIGHEST)))
                if listed and highest >= lowest:
                    runs = [_means(channels, shaft, one, size) for one in segments]
                    yield shaft, runs, range(lowest, highest + 1)


def _samples_per_turn(angle: np.ndarray, segments: Sequence[Segment]) -> float:
    """Return the samples per turn of a shaft in the fastest of the segments."""
    steps = [
        abs(angle[s.stop - 1] - angle[s.start]) / (s.stop - 1 - s.start)
        for s in segments
        if s.stop - s.start > 1
    ]
    fastest = max(steps, default=0.0)
    return float(REV / fastest) if fastest > 0 else 0.0


def _means(channels: Regressors, shaft: str, segment: Segment, size: int) -> Run:
    """Return angle and transmission error of a segment as means of `size` samples each.

    Samples that a robust loss leaves out are not read.
    """
    part = slice(segment.start, segment.stop)
    angle, error = getattr(channels, shaft)[part], channels.error[segment.flank][part]
    if channels.weight is not None and not np.all(good := channels.weight[part] > 0):
        angle, error = angle[good], error[good]
    return block_means(angle, size), block_means(error, size)
