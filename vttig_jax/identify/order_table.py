"""Every fitted harmonic, flank by flank, with its standard error; and the flank model they make."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ..base.units import ARCSEC
from ..kinematics.orders import OrderModel
from ..pair.gears import Flank
from .noise import WhitenedFlank
from .parameters import polar_spread
from .solve import Solution
from .summary import HarmonicSummary


@dataclass(frozen=True)
class Order:
    """a sin(k φ_shaft + p) in the transmission error of one flank; a at the driven gear."""

    shaft: str
    order: int
    flank: Flank
    amplitude_arcsec: float
    std_arcsec: float
    phase_deg: float

    def to_json(self) -> dict:
        """Fields of the contract."""
        return dict(vars(self))


def order_table(
    summary: HarmonicSummary, whitened: tuple[WhitenedFlank, ...], solution: Solution
) -> tuple[Order, ...]:
    """Amplitude, standard error and phase of every harmonic of both shafts and of the mesh."""
    table = []
    harmonics = summary.terms.free + summary.terms.tied
    for index, (flank, factor) in enumerate(zip(summary.flanks, whitened, strict=True)):
        jacobian = solution.jacobian[index]
        covariance = factor.covariance(jacobian @ solution.covariance @ jacobian.T)
        values = np.concatenate([factor.free_given(solution.tied[index]), solution.tied[index]])
        for position, harmonic in enumerate(harmonics):
            if harmonic.shaft == "both":
                continue
            cosine = _cosine_column(summary, position)
            # a sin(kφ + p): the sine column holds a cos p, the cosine column a sin p.
            cells = [cosine + 1, cosine]
            amplitude, std, phase_deg, _ = polar_spread(
                values[cells] / ARCSEC, covariance[np.ix_(cells, cells)] / ARCSEC**2
            )
            table.append(
                Order(
                    harmonic.shaft,
                    harmonic.order,
                    flank.flank,
                    amplitude,
                    std,
                    phase_deg,
                )
            )
    ranks = {"driving": 0, "driven": 1, "mesh": 2}
    return tuple(sorted(table, key=lambda o: (ranks[o.shaft], o.order, o.flank)))


def fitted_model(
    summary: HarmonicSummary, whitened: tuple[WhitenedFlank, ...], solution: Solution
) -> OrderModel:
    """The order-complete flank model; a flank that was not measured holds NaN."""
    harmonics = summary.terms.free + summary.terms.tied
    offset, cosine, sine = (
        np.full(shape, np.nan) for shape in ((2,), (2, len(harmonics)), (2, len(harmonics)))
    )
    for index, (flank, factor) in enumerate(zip(summary.flanks, whitened, strict=True)):
        side = "AB".index(flank.flank)
        values = np.concatenate([factor.free_given(solution.tied[index]), solution.tied[index]])
        columns = [_cosine_column(summary, position) for position in range(len(harmonics))]
        offset[side] = values[2 * len(summary.terms.free)]
        cosine[side] = values[columns]
        sine[side] = values[[column + 1 for column in columns]]
    return OrderModel(
        ratio=jnp.asarray(float(summary.terms.ratio)),
        terms=tuple(h.term for h in harmonics),
        offset=jnp.asarray(offset),
        cosine=jnp.asarray(cosine),
        sine=jnp.asarray(sine),
    )


def _cosine_column(summary: HarmonicSummary, position: int) -> int:
    """Column of a harmonic's cosine among (free, 1, drift, tied)."""
    free = len(summary.terms.free)
    return 2 * position + (0 if position < free else 1 + summary.plan.drift_order)
