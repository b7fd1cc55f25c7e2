"""Harmonics of a fit: the orders of both shafts and of the mesh, each frequency once."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from ...kinematics.harmonic import Term

AnyTerm = tuple[int | Fraction, int | Fraction]
"""Term (n₁, n₂) of a fit; an order that is no whole number is an exact fraction."""

SECOND_ORDER: tuple[AnyTerm, ...] = ((2, 0), (0, 2), (1, 1), (1, -1))
"""Second-order terms that two eccentricities excite: the exact relation contains e² there."""


@dataclass(frozen=True)
class Harmonic:
    """Harmonic of the transmission error: shaft, order, and term (n₁, n₂) of its phase.

    A harmonic of fractional order has the phase k times the unwrapped angle of its shaft.
    """

    shaft: str
    order: int | float
    term: AnyTerm

    @property
    def name(self) -> str:
        """Name of the harmonic, for example "driving order 3"."""
        return f"{self.shaft} order {self.order}"

    @property
    def is_whole(self) -> bool:
        """Whether the harmonic repeats after whole turns of both shafts."""
        return all(part == int(part) for part in self.term)


def harmonic_of(shaft: str, order: int | float) -> Harmonic:
    """Return the harmonic of an order of a shaft; a fractional order becomes an exact fraction.

    `shaft` is "driving" or "driven".
    """
    number = int(order) if order == int(order) else Fraction(str(order))
    return Harmonic(shaft, order, (number, 0) if shaft == "driving" else (0, number))


@dataclass(frozen=True)
class TermPlan:
    """Harmonics of a fit, in the order of the columns of its summary.

    **Arguments**
    - `ratio`: i, driven speed divided by driving speed.
    - `free`: harmonics with independent coefficients on each flank.
    - `tied`: harmonics that follow from the physical parameters alone: both first orders, and the
      second-order terms of the exact relation that are not free.
    - `dropped`: sentences on orders left out because another order has nearly the same frequency.
    """

    ratio: Fraction
    free: tuple[Harmonic, ...]
    tied: tuple[Harmonic, ...]
    dropped: tuple[str, ...]

    @property
    def terms(self) -> tuple[AnyTerm, ...]:
        """Terms (n₁, n₂) of all harmonics, free ones first."""
        return tuple(h.term for h in self.free + self.tied)

    @property
    def locked(self) -> tuple[list[int], tuple[Term, ...]]:
        """Indices and terms (n₁, n₂) of the harmonics that the positions of both gears determine.

        These are the harmonics of whole orders. The indices count free harmonics, then tied ones.
        """
        harmonics = enumerate(self.free + self.tied)
        whole = [(place, h.term) for place, h in harmonics if h.is_whole]
        return [place for place, _ in whole], tuple((int(n), int(m)) for _, (n, m) in whole)

    @property
    def fractional(self) -> tuple[Harmonic, ...]:
        """Harmonics of fractional order; the gear positions do not determine their phases."""
        return tuple(h for h in self.free if not h.is_whole)

    def frequency(self, term: AnyTerm) -> Fraction:
        """Return the frequency |n₁ + n₂ i|, cycles per driving revolution."""
        return abs(term[0] + term[1] * self.ratio)

    def exchanged(self, more: Sequence[Harmonic], fewer: Sequence[Harmonic]) -> "TermPlan":
        """Return the plan with the free harmonics `more` added and `fewer` removed."""
        kept = tuple(h for h in self.free if h not in fewer)
        return replace(self, free=(*kept, *more))


RESOLVED = 0.99
"""Two frequencies are resolved if they differ by at least this many cycles over the log. The number
is below 1, because a table of one turn lacks its last sample."""


_FIRST: tuple[AnyTerm, ...] = ((1, 0), (0, 1))


def _unresolved(kept: Mapping[Fraction, Harmonic], turns: float) -> list[Fraction]:
    """Return the frequencies that are less than one cycle over the log from zero or a lower order.

    `turns` is the number of driving turns of the log. First orders are always resolved, and
    fractional orders are only compared with zero.
    """
    resolved = [0.0]
    close: list[Fraction] = []
    ranked = sorted(kept, key=lambda f: (kept[f].term not in _FIRST, kept[f].order))
    for frequency in ranked:
        others = resolved if kept[frequency].is_whole else resolved[:1]
        if kept[frequency].term in _FIRST or all(
            abs(float(frequency) - other) * turns >= RESOLVED for other in others
        ):
            if not kept[frequency].is_whole:
                continue
            resolved.append(float(frequency))
        else:
            close.append(frequency)
    return close


def names_of(harmonics: Sequence[Harmonic]) -> str:
    """Return the names of harmonics as text, for example "driven orders 2 and 4 to 8"."""
    parts = []
    for shaft in dict.fromkeys(h.shaft for h in harmonics):
        orders = sorted(h.order for h in harmonics if h.shaft == shaft)
        runs: list[list[int | float]] = []
        for order in orders:
            if runs and order == runs[-1][-1] + 1:
                runs[-1].append(order)
            else:
                runs.append([order])
        words = [
            text
            for run in runs
            for text in ([f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run))
        ]
        listed = " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
        parts.append(f"{shaft} order{'s' if len(orders) > 1 else ''} {listed}")
    return " and ".join(parts)


def _same_frequency(same: Sequence[tuple[Harmonic, Harmonic]]) -> str:
    """Return a sentence that lists the orders left out because they have the frequency of another.

    `same` holds pairs of a harmonic that is left out and the harmonic that is kept.
    """
    left, kept = (list(dict.fromkeys(part)) for part in zip(*same, strict=True))
    several = len(left) > 1
    return (
        f"{names_of(left)} {'have the frequencies' if several else 'has the frequency'} of"
        f" {names_of(kept)}, so that a log cannot tell them apart: the amplitudes stated for"
        f" {names_of(kept)} are those of both together"
    )


def plan_terms(
    ratio: Fraction,
    driving_orders: tuple[int | float, ...],
    driven_orders: tuple[int | float, ...],
    mesh_orders: int,
    driving_teeth: int | None,
    turns: float = math.inf,
    *,
    all_free: bool = False,
) -> TermPlan:
    """Return the harmonics of a fit, without those of the same frequency as another harmonic.

    Two frequencies are the same for a log of `turns` driving revolutions if they differ by less
    than one cycle over the log. A first order is then kept rather than any other order, and a low
    order rather than a higher one; the first orders of both shafts are both kept unless their
    frequencies are exactly equal. First orders in the lists are tied to the physical parameters. If
    tooth counts are known, the second-order terms of the exact relation are tied too.
    `driving_teeth` is None for a drive, which has no tooth-mesh order. A fractional order close to
    a whole order does not remove it. With `all_free` no harmonic is tied.
    """
    mesh = range(1, mesh_orders + 1) if driving_teeth else ()
    wanted = [harmonic_of("driving", k) for k in sorted(set(driving_orders))]
    wanted += [harmonic_of("driven", k) for k in sorted(set(driven_orders))]
    wanted += [Harmonic("mesh", k, (k * (driving_teeth or 0), 0)) for k in mesh]
    wanted.sort(key=lambda h: h.term not in _FIRST)
    kept: dict[Fraction, Harmonic] = {}
    same: list[tuple[Harmonic, Harmonic]] = []
    for harmonic in wanted:
        frequency = abs(harmonic.term[0] + harmonic.term[1] * ratio)
        if other := kept.get(frequency):
            same.append((harmonic, other))
        else:
            kept[frequency] = harmonic
    dropped = [_same_frequency(same)] if same else []
    if close := [kept.pop(frequency) for frequency in _unresolved(kept, turns)]:
        dropped.append(
            f"{names_of(close)} {'is' if len(close) == 1 else 'are'} left out: over {turns:.3g}"
            " driving revolutions the log cannot tell"
            f" {'it from a lower order' if len(close) == 1 else 'them from lower orders'}; record"
            " more turns"
        )
    if all_free:
        return TermPlan(ratio, tuple(kept.values()), (), tuple(dropped))
    free = tuple(h for h in kept.values() if h.term not in _FIRST)
    tied = tuple(h for h in kept.values() if h.term in _FIRST)
    if driving_teeth:
        shafts = {h.term for h in tied}
        absent = [k for k, tie in enumerate(_FIRST) if tie not in shafts]
        for term in SECOND_ORDER:
            frequency = abs(term[0] + term[1] * ratio)
            if frequency in kept or frequency == 0 or any(term[k] for k in absent):
                continue
            kept[frequency] = Harmonic("both", 2, term)
            tied += (kept[frequency],)
    return TermPlan(ratio, free, tied, tuple(dropped))
