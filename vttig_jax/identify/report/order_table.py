"""Table of the fitted harmonics of every flank, with amplitude, phase and standard error."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.special import erfc, gammaincc

from ...base.numerics.polar_spread import polar_spread
from ...base.units import ARCSEC
from ...pair.gear_pair import Flank
from ..solve.sandwich import Scatter, functional_of, standard_errors
from ..solve.solved_fit import SolvedFit
from .parameters import LARGEST, SIGNIFICANT

_LEAKAGE = 3.0  # a line leaks into orders nearer than this number of resolutions; chosen value
_MODULATION = 0.1
"""Share of the amplitude of a fractional order that leaks into neighbouring orders, because the
amplitude changes. A line of 15″ on a robot axis leaks 0.7″ into the next order (chosen)."""


@dataclass(frozen=True)
class Order:
    """Harmonic a sin(k φ_shaft + p) of the transmission error of one flank, at the driven gear.

    The phase p of a fractional order holds for the zero of the shaft angle of the log. An order is
    `significant` if its amplitude is at least three standard errors and it is no leakage of a line.
    """

    shaft: str
    order: int | float
    flank: Flank
    amplitude_arcsec: float
    std_arcsec: float
    phase_deg: float
    significant: bool = True

    def to_json(self) -> dict:
        """Return the fields of the order in the JSON object of a fit."""
        return dict(vars(self))


@runtime_checkable
class FlankLine(Protocol):
    """Spectral line of the residual of one flank, or of both flanks if `flank` is None."""

    @property
    def flank(self) -> Flank | None:
        """Return the flank of the line, or None for both flanks."""
        ...

    @property
    def cycles_per_rev(self) -> float:
        """Return the frequency, cycles per driving revolution."""
        ...

    @property
    def amplitude_arcsec(self) -> float:
        """Return the amplitude of the line, arc seconds."""
        ...


def order_table(
    solved: SolvedFit, scatter: Scatter | None = None, short: Sequence[str] = ()
) -> tuple[Order, ...]:
    """Return amplitude, standard error and phase of all harmonics of both shafts and the mesh.

    Harmonics whose standard error is larger than one revolution are left out, and those of the
    shafts `short`, which turned too little for them.

    `scatter` names the parts of the log whose scatter gives standard errors. On few turns (scatter
    "cosines" or "memory") the standard error of an amplitude is at least that from this scatter.
    """
    table = []
    summary, solution = solved.summary, solved.solution
    harmonics = summary.terms.free + summary.terms.tied
    for index, (flank, factor) in enumerate(zip(summary.flanks, solved.whitened, strict=True)):
        jacobian = solution.jacobian[index]
        covariance = factor.covariance(jacobian @ solution.covariance @ jacobian.T)
        values = solved.coefficients[index]
        for position, harmonic in enumerate(harmonics):
            if harmonic.shaft == "both" or harmonic.shaft in short:
                continue
            cosine = summary.columns.cosine(position)
            # For a sin(kφ + p) the sine coefficient is a cos p, and the cosine coefficient a sin p.
            cells = [cosine + 1, cosine]
            amplitude, std, phase_deg, _ = polar_spread(
                values[cells] / ARCSEC, covariance[np.ix_(cells, cells)] / ARCSEC**2
            )
            if scatter in ("cosines", "memory") and amplitude:
                along = np.zeros((1, len(values)))
                along[0, cells] = values[cells] / (amplitude * ARCSEC)
                of_fit = functional_of(solved, {flank.flank: along})
                own = float(standard_errors(solved, of_fit, scatter)[0]) / ARCSEC
                std = max(std, own)
            if std > LARGEST["arcsec"]:
                continue
            table.append(
                Order(
                    shaft=harmonic.shaft,
                    order=harmonic.order,
                    flank=flank.flank,
                    amplitude_arcsec=amplitude,
                    std_arcsec=std,
                    phase_deg=phase_deg,
                    significant=amplitude >= SIGNIFICANT * std,
                )
            )
    ranks = {"driving": 0, "driven": 1, "mesh": 2}
    return tuple(sorted(table, key=lambda o: (ranks[o.shaft], o.order, o.flank)))


def judged_orders(
    orders: Sequence[Order],
    lines: Sequence[FlankLine],
    ratio: float,
    turns: float,
) -> tuple[Order, ...]:
    """Return the orders; an order that is leakage of a line is marked as not significant.

    A line of the residual leaks into orders within three resolutions (1/`turns` cycles per driving
    revolution) if its amplitude is at least that of the order. A fractional order leaks because its
    amplitude changes over the log, for example with the load; a tenth of its amplitude counts.

    **Arguments**
    - `lines`: lines of the residual.
    - `ratio`: driven speed over driving speed.
    - `turns`: driving revolutions of the longest run.
    """

    def cycles_of(order: Order) -> float:
        return order.order * (ratio if order.shaft == "driven" else 1.0)

    fractional = [one for one in orders if is_fractional(one)]

    def is_leakage(order: Order) -> bool:
        beside = [(line.flank, line.cycles_per_rev, line.amplitude_arcsec) for line in lines]
        if order not in fractional:
            beside += [
                (one.flank, cycles_of(one), _MODULATION * one.amplitude_arcsec)
                for one in fractional
            ]
        return order.shaft != "mesh" and any(
            abs(cycles - cycles_of(order)) * turns < _LEAKAGE
            and amplitude >= order.amplitude_arcsec
            and flank in (None, order.flank)
            for flank, cycles, amplitude in beside
        )

    return tuple(
        replace(order, significant=order.significant and not is_leakage(order)) for order in orders
    )


def exceeds_noise(orders: Iterable[Order]) -> bool:
    """Return whether the orders of a flank are together larger than noise.

    Without an error of the gears, Σ (amplitude/std)² of K orders follows χ² with 2K degrees of
    freedom. It has to be so large that noise exceeds it as seldom as three standard errors. One
    order of many is above its own three standard errors far more often.
    """
    found = [one for one in orders if one.amplitude_arcsec > 0]
    if any(one.std_arcsec == 0 for one in found):
        return True  # a log without noise
    ratios = [one.amplitude_arcsec / one.std_arcsec for one in found]
    chance = gammaincc(len(ratios), sum(ratio**2 for ratio in ratios) / 2) if ratios else 1.0
    return bool(chance < erfc(SIGNIFICANT / math.sqrt(2)))


def is_fractional(order: Order) -> bool:
    """Return whether an order has no fixed position on its shaft, so that no map contains it."""
    return not float(order.order).is_integer()
