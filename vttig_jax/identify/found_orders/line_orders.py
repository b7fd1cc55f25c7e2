"""Spectral lines of the residual that are no order become fractional orders of the driving shaft.

A line close to an order leaks into it, and the order itself may not exist. The likelihood of the
log decides between three explanations under one noise model: the line alone, the order alone, or
both.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.threads import one_blas_thread
from ...logs.lines.comparison import Comparison
from ...pair.gear_pair import Drive, GearPair
from ..compress.block_rows import turns_of
from ..model.harmonics import SECOND_ORDER, Harmonic, TermPlan, harmonic_of
from ..report.checks import JoinedLine, ResidualLine
from ..report.residual_tests import compared
from ..solve.solved_fit import SolvedFit

_CERTAIN = 1e-6
"""Largest false-alarm probability of a line that joins the model. It is smaller than that of a line
which is only reported, because a wrong term does more harm than a wrong sentence (chosen)."""

_CERTAIN_ON_FEW_TURNS = 1e-12
"""The same on few turns, where noise with a long correlation looks more like a line (chosen)."""

_NEAR = 2.0
"""An order and a line are compared if their distance is below this many resolutions; a resolution
is 1/(revolutions of the log). Farther orders take up less than a tenth of a line (chosen)."""

_MODULATED = 0.5
"""A line within this many resolutions of a supported order is a modulation of the order (chosen).
"""


@dataclass(frozen=True)
class Joined:
    """Harmonics of a fit with lines as fractional orders, the records of these lines, and notes."""

    terms: TermPlan
    lines: tuple[JoinedLine, ...]
    notes: tuple[str, ...]


@one_blas_thread
def joined_lines(
    solved: SolvedFit, found: Sequence[ResidualLine], *, few_turns: bool
) -> Joined | None:
    """Return the plan in which certain lines are fractional orders, or None if it is unchanged.

    `found` are the lines of both flanks together.
    """
    certain = _CERTAIN_ON_FEW_TURNS if few_turns else _CERTAIN
    linear, terms = solved.linear, solved.linear.model.terms
    turns = turns_of(linear.rows)
    sure = [_Line.found(one) for one in found if one.false_alarm <= certain]
    # A first order always stays in the model; it would share its amplitude with a line close to it.
    lines = [one for one in sure if not _beside(one, terms.tied, terms, turns)]
    lines += [_Line.given(one, terms) for one in terms.fractional]
    near = {h: _near(h, lines, terms, turns) for h in terms.free if h.is_whole}
    orders = [h for h, is_near in near.items() if is_near]
    lines = [line for line in lines if not line.harmonic or _beside(line, orders, terms, turns)]
    if not lines:
        return None
    without = [*orders, *(line.harmonic for line in lines if line.harmonic)]
    cycles = [*(float(terms.frequency(h.term)) for h in orders), *(line.cycles for line in lines)]
    comparison = compared(linear.rows, solved.weights, without, cycles)
    if comparison is None:
        return None
    judge = _Judge(comparison, terms, linear.model.pair, orders, lines)
    judge.decide()
    return judge.joined()


@dataclass(frozen=True)
class _Line:
    """Line that may join the model, or a fractional order of the user, which has a `harmonic`.

    `cycles` is the frequency in cycles per driving revolution, and `std` its standard error.
    """

    cycles: float
    std: float
    false_alarm: float
    harmonic: Harmonic | None = None

    @classmethod
    def found(cls, line: ResidualLine) -> "_Line":
        return cls(line.cycles_per_rev, line.cycles_std, line.false_alarm)

    @classmethod
    def given(cls, harmonic: Harmonic, terms: TermPlan) -> "_Line":
        return cls(float(terms.frequency(harmonic.term)), 0.0, 0.0, harmonic)


def _near(harmonic: Harmonic, lines: Sequence[_Line], terms: TermPlan, turns: float) -> bool:
    frequency = float(terms.frequency(harmonic.term))
    return any(abs(frequency - line.cycles) * turns < _NEAR for line in lines)


def _beside(line: _Line, orders: Sequence[Harmonic], terms: TermPlan, turns: float) -> bool:
    return any(_near(order, [line], terms, turns) for order in orders)


class _Judge:
    """Decides line by line, the most certain first, which lines and orders explain the log."""

    def __init__(
        self,
        comparison: Comparison,
        terms: TermPlan,
        pair: GearPair | Drive,
        orders: Sequence[Harmonic],
        lines: Sequence[_Line],
    ) -> None:
        self.comparison, self.terms, self.pair = comparison, terms, pair
        self.orders, self.open = list(orders), sorted(lines, key=lambda one: one.false_alarm)
        self.certain: list[tuple[_Line, list[Harmonic]]] = []

    def decide(self) -> None:
        """Judge every line together with all other lines that are not yet refused."""
        while self.open:
            line = self.open.pop(0)
            verdict = self._judged(line)
            if verdict is not None:
                self.certain.append(verdict)
                self.orders = [h for h in self.orders if h not in verdict[1]]

    def joined(self) -> Joined | None:
        """Return the harmonics of the fit with the certain lines; None if they do not change."""
        more, fewer, records, notes = [], [], [], []
        known = {self.terms.frequency(term) for term in self.terms.terms}
        for line, replaced in self.certain:
            fewer += replaced
            harmonic = line.harmonic
            if harmonic is None:
                harmonic = harmonic_of("driving", _rounded(line.cycles, line.std))
            notes += [
                f"{one.name} is left out: the log does not support it beside {harmonic.name}"
                for one in replaced
            ]
            if line.harmonic is not None:
                continue
            if self.terms.frequency(harmonic.term) in known:
                continue
            more.append(harmonic)
            records.append(
                JoinedLine(
                    order=harmonic.order,
                    cycles_per_rev=line.cycles,
                    cycles_std=line.std,
                    false_alarm=line.false_alarm,
                    replaced=tuple(one.name for one in replaced),
                )
            )
        if not more and not fewer:
            return None
        return Joined(self.terms.exchanged(more, fewer), tuple(records), tuple(notes))

    def _judged(self, line: _Line) -> tuple[_Line, list[Harmonic]] | None:
        """Return the line at its refined frequency with the orders that it replaces, or None."""
        near = [h for h in self.orders if self._apart(h, line.cycles) < _NEAR]
        lines = [one.cycles for one in self.open] + [one.cycles for one, _ in self.certain]
        others = [self._frequency(h) for h in self.orders if h not in near]
        if not near and self._whole(line.cycles) is None:
            return line, []
        comparison = self.comparison
        alone = comparison.height([*lines, *others, *map(self._frequency, near)])
        cycles, height, kept = self._without_unsupported(line, near, others, lines)
        replaced = [h for h in near if h not in kept]
        coefficients = comparison.coefficients * (1 - len(replaced)) + (line.harmonic is None)
        if alone - height < coefficients * comparison.penalty:
            return None
        if any(self._apart(h, cycles) < _MODULATED for h in kept):
            return None
        beside = [*lines, *others, *map(self._frequency, kept)]
        whole = self._whole(cycles)
        if whole is not None and comparison.height([*beside, whole]) - height < comparison.penalty:
            return None
        std = comparison.frequency_std(cycles, beside)
        return _Line(cycles, std, line.false_alarm, line.harmonic), replaced

    def _without_unsupported(
        self,
        line: _Line,
        near: Sequence[Harmonic],
        others: Sequence[float],
        lines: Sequence[float],
    ) -> tuple[float, float, list[Harmonic]]:
        """Leave out the least supported of the orders `near` until BIC supports all that remain.

        `others` and `lines` are the frequencies of the other orders and lines of the model.

        **Returns** the frequency of the line, −2 log-likelihood there, and the orders that remain.
        """
        kept = list(near)
        cycles, height = self._best(line, [*others, *map(self._frequency, kept)], lines)
        while kept:
            trials = []
            for order in kept:
                rest = [self._frequency(h) for h in kept if h is not order]
                trials.append((*self._best(line, [*others, *rest], lines), order))
            found, lowest, order = min(trials, key=lambda trial: trial[1])
            if lowest - height >= self.comparison.coefficients * self.comparison.penalty:
                break
            kept.remove(order)
            cycles, height = found, lowest
        return cycles, height, kept

    def _best(
        self, line: _Line, beside: Sequence[float], lines: Sequence[float]
    ) -> tuple[float, float]:
        if line.harmonic is not None:
            return line.cycles, self.comparison.height([*beside, *lines, line.cycles])
        return self.comparison.refined(line.cycles, beside, lines)

    def _frequency(self, harmonic: Harmonic) -> float:
        return float(self.terms.frequency(harmonic.term))

    def _apart(self, harmonic: Harmonic, cycles: float) -> float:
        return abs(self._frequency(harmonic) - cycles) / self.comparison.resolution

    def _whole(self, cycles: float) -> float | None:
        """Return the frequency of an expected order within one resolution of `cycles`, or None.

        Expected are whole orders of both shafts and second orders of the exact relation. A
        driven shaft that turned less than once is left out: its orders are closer than the
        resolution.
        """
        ratio, resolution = float(self.terms.ratio), self.comparison.resolution
        known = [float(max(round(cycles), 1))]
        if ratio >= resolution:
            known.append(max(round(cycles / ratio), 1) * ratio)
        if isinstance(self.pair, GearPair):
            known += [float(self.terms.frequency(term)) for term in SECOND_ORDER]
        nearest = min(known, key=lambda whole: abs(whole - cycles))
        return nearest if abs(nearest - cycles) < resolution else None


def _rounded(cycles: float, std: float) -> float:
    """Return a frequency, rounded to the decimals that its standard error justifies."""
    digits = math.ceil(-math.log10(std)) if std > 0 else 9
    return round(cycles, int(np.clip(digits, 1, 9)))
