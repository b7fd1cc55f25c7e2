"""Table of the fitted harmonics of every flank with standard errors, and their flank model."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.units import ARCSEC
from ...kinematics.harmonic import OrderModel
from ...pair.gear_pair import Flank
from ..compress.harmonic_summary import HarmonicSummary
from ..model.column_layout import OFFSET
from ..noise.noise_model import WhitenedFlank
from ..solve.least_squares import Solution
from .parameters import polar_spread


@dataclass(frozen=True)
class Order:
    """Harmonic a sin(k φ_shaft + p) of the transmission error of one flank, at the driven gear."""

    shaft: str
    order: int
    flank: Flank
    amplitude_arcsec: float
    std_arcsec: float
    phase_deg: float

    def to_json(self) -> dict:
        """Return the fields of the order in the JSON object of a fit."""
        return dict(vars(self))


def order_table(
    summary: HarmonicSummary,
    whitened: tuple[WhitenedFlank, ...],
    solution: Solution,
    coefficients: list[Float[np.ndarray, " columns"]],
) -> tuple[Order, ...]:
    """Return amplitude, standard error and phase of all harmonics of both shafts and the mesh."""
    table = []
    harmonics = summary.terms.free + summary.terms.tied
    for index, (flank, factor) in enumerate(zip(summary.flanks, whitened, strict=True)):
        jacobian = solution.jacobian[index]
        covariance = factor.covariance(jacobian @ solution.covariance @ jacobian.T)
        values = coefficients[index]
        for position, harmonic in enumerate(harmonics):
            if harmonic.shaft == "both":
                continue
            cosine = summary.columns.cosine(position)
            # For a sin(kφ + p) the sine coefficient is a cos p, and the cosine coefficient a sin p.
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
    summary: HarmonicSummary,
    coefficients: list[Float[np.ndarray, " columns"]],
    level: float = 0.0,
) -> OrderModel:
    """Return the order-complete flank model with the offset of the first log plus `level`, rad.

    The values of a flank that was not measured are NaN.
    """
    harmonics = summary.terms.free + summary.terms.tied
    offset, cosine, sine = (
        np.full(shape, np.nan) for shape in ((2,), (2, len(harmonics)), (2, len(harmonics)))
    )
    for flank, values in zip(summary.flanks, coefficients, strict=True):
        side = "AB".index(flank.flank)
        columns = [summary.columns.cosine(position) for position in range(len(harmonics))]
        offset[side] = values[summary.columns.index(OFFSET)] + level
        cosine[side] = values[columns]
        sine[side] = values[[column + 1 for column in columns]]
    return OrderModel(
        ratio=jnp.asarray(float(summary.terms.ratio)),
        terms=tuple(h.term for h in harmonics),
        offset=jnp.asarray(offset),
        cosine=jnp.asarray(cosine),
        sine=jnp.asarray(sine),
    )
