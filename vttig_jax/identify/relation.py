"""From physical parameters to the harmonics a log shows: what ties the first orders together."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Numbers
from ..kinematics.exact import ExactModel
from ..pair.gears import Flank, GearPair
from .terms import SECOND_ORDER, TermPlan

_GRID = 8
"""Points a turn on the torus of both shaft angles: exact for orders below 4, e⁶ alias."""


class Relation(eqx.Module):
    """Coefficients of the tied columns (1, time, …, cosines and sines) as a function of parameters.

    Parameters are a flat vector named by `names`: lengths in mm, angles in rad, eccentricities and
    encoder errors in Cartesian form (x + jy = amplitude · exp(j phase)).
    """

    names: eqx.AbstractVar[tuple[str, ...]]

    @abstractmethod
    def coefficients(self, parameters: Float[Array, " p"]) -> Float[Array, "flanks tied"]:
        """Tied coefficients of every measured flank, rad."""


class PairRelation(Relation):
    """Two eccentric gears through the exact relation, and encoders that are off centre.

    The relation is evaluated where it is explicit, on a grid of both shaft angles, and projected on
    the tied harmonics. Encoder errors add + E₂ sin(φ₂ + ε₂) − i E₁ sin(φ₁ + ε₁) on both flanks.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    flanks: tuple[Flank, ...] = eqx.field(static=True)
    ratio: Float[Numbers, ""]
    centre_distance: Float[Numbers, ""]
    base_sum: Float[Numbers, "2"]
    basis: Float[Numbers, "tied grid"]
    encoder_columns: Float[Numbers, "4 tied"]
    drift_columns: Float[Numbers, "drift tied"]

    def coefficients(self, parameters: Float[Array, " p"]) -> Float[Array, "flanks tied"]:
        """Tied coefficients of every measured flank, rad."""
        value = dict(zip(self.names, parameters, strict=True))
        zero = jnp.zeros(())
        get = lambda name: value.get(name, zero)  # noqa: E731
        model = ExactModel(
            ratio=jnp.asarray(self.ratio),
            centre_distance=jnp.asarray(self.centre_distance),
            base_sum=self.base_sum,
            driving_offset=get("driving_x") + 1j * get("driving_y"),
            driven_offset=get("driven_x") + 1j * get("driven_y"),
            offset=jnp.zeros(2),
        )
        driving, driven = (jnp.asarray(angle) for angle in torus())
        encoders = jnp.stack(
            [
                -self.ratio * get("driving_encoder_y"),
                -self.ratio * get("driving_encoder_x"),
                get("driven_encoder_y"),
                get("driven_encoder_x"),
            ]
        )
        common = encoders @ self.encoder_columns + drift_part(value, self.drift_columns)
        sides = np.array(["AB".index(flank) for flank in self.flanks])
        senses = np.where(sides == 0, 1.0, -1.0)[:, None]
        turned = model.turned(driving, driven, self.base_sum[sides][:, None], senses)
        offset = get("offset") + sides * get("constant_backlash")
        return (turned + offset[:, None]) @ self.basis.T + common


class DriveRelation(Relation):
    """First orders of a drive without geometry: a part common to both flanks and one that differs.

    The common part is what the amplitudes of a drive state; half the difference is added on flank B
    and taken away on flank A, so that it is the variable backlash.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    flanks: tuple[Flank, ...] = eqx.field(static=True)
    first_columns: Float[Numbers, "4 tied"]
    drift_columns: Float[Numbers, "drift tied"]

    def coefficients(self, parameters: Float[Array, " p"]) -> Float[Array, "flanks tied"]:
        """Tied coefficients of every measured flank, rad."""
        value = dict(zip(self.names, parameters, strict=True))
        zero = jnp.zeros(())
        get = lambda name: value.get(name, zero)  # noqa: E731
        axes = ("driving_y", "driving_x", "driven_y", "driven_x")
        shared = jnp.stack([get(name) for name in axes])
        difference = jnp.stack([get(f"{name}_difference") for name in axes])
        constant = jnp.zeros(self.first_columns.shape[1]).at[0].set(1.0)
        drift = drift_part(value, self.drift_columns)
        offsets = {"A": get("offset"), "B": get("offset") + get("constant_backlash")}
        signs = {"A": -0.5, "B": 0.5}
        return jnp.stack(
            [
                offsets[flank] * constant
                + (shared + signs[flank] * difference) @ self.first_columns
                + drift
                for flank in self.flanks
            ]
        )


def pair_relation(
    pair: GearPair,
    terms: TermPlan,
    flanks: tuple[Flank, ...],
    drift_order: int,
    *,
    encoder_terms: bool,
) -> PairRelation:
    """Relation of a gear pair; parameters of a shaft whose first order is not tied are left out."""
    shafts = _tied_shafts(terms)
    kinds = ("", "_encoder") if encoder_terms else ("",)
    axes = [f"{shaft}{kind}_{axis}" for kind in kinds for shaft in shafts for axis in "xy"]
    return PairRelation(
        names=(*_common_names(flanks, drift_order), *axes),
        flanks=flanks,
        ratio=np.asarray(float(pair.ratio)),
        centre_distance=np.asarray(pair.centre_distance_mm),
        base_sum=np.asarray(pair.base_radii.sum(axis=0)),
        basis=_projection(terms, drift_order),
        encoder_columns=_first_order_columns(terms, drift_order),
        drift_columns=_drift_columns(terms, drift_order),
    )


def drive_relation(terms: TermPlan, flanks: tuple[Flank, ...], drift_order: int) -> DriveRelation:
    """Relation of a drive; the difference of the flanks is a parameter where both were measured."""
    shafts = _tied_shafts(terms)
    kinds = ("", "_difference") if len(flanks) == 2 else ("",)
    axes = [f"{shaft}_{axis}{kind}" for kind in kinds for shaft in shafts for axis in "xy"]
    return DriveRelation(
        names=(*_common_names(flanks, drift_order), *axes),
        flanks=flanks,
        first_columns=_first_order_columns(terms, drift_order),
        drift_columns=_drift_columns(terms, drift_order),
    )


def torus() -> tuple[Float[np.ndarray, " grid"], Float[np.ndarray, " grid"]]:
    """Driving and driven angles of the grid the exact relation is sampled on."""
    angles = 2 * np.pi * np.arange(_GRID) / _GRID
    driving, driven = np.meshgrid(angles, angles, indexing="ij")
    return driving.ravel(), driven.ravel()


def drift_part(value: dict, columns: Float[Numbers, "drift tied"]):
    """Drift coefficients in their columns."""
    if columns.shape[0] == 0:
        return jnp.zeros(columns.shape[1])
    return jnp.stack([value[f"drift_{k + 1}"] for k in range(columns.shape[0])]) @ columns


def _common_names(flanks: tuple[Flank, ...], drift_order: int) -> tuple[str, ...]:
    drift = tuple(f"drift_{power}" for power in range(1, drift_order + 1))
    return ("offset", *(("constant_backlash",) if len(flanks) == 2 else ()), *drift)


def _tied_shafts(terms: TermPlan) -> list[str]:
    return [h.shaft for h in terms.tied if h.term in ((1, 0), (0, 1))]


def _cosine_column(terms: TermPlan, drift_order: int, index: int) -> int:
    """Column of the cosine of tied harmonic `index`; its sine is the next one."""
    return 1 + drift_order + 2 * index


def _width(terms: TermPlan, drift_order: int) -> int:
    return 1 + drift_order + 2 * len(terms.tied)


def _first_order_columns(terms: TermPlan, drift_order: int) -> Float[np.ndarray, "4 tied"]:
    """Where (driving cos, driving sin, driven cos, driven sin) go among the tied columns."""
    columns = np.zeros((4, _width(terms, drift_order)))
    for index, harmonic in enumerate(terms.tied):
        for shaft, first in enumerate([(1, 0), (0, 1)]):
            if harmonic.term == first:
                place = _cosine_column(terms, drift_order, index)
                columns[2 * shaft, place] = columns[2 * shaft + 1, place + 1] = 1.0
    return columns


def _drift_columns(terms: TermPlan, drift_order: int) -> Float[np.ndarray, "drift tied"]:
    return np.eye(drift_order, _width(terms, drift_order), k=1)


def _projection(terms: TermPlan, drift_order: int) -> Float[np.ndarray, "tied grid"]:
    """Matrix from values on the torus to tied coefficients.

    A harmonic of the relation goes to the tied column of the same frequency: where the tooth counts
    let two of them coincide, the log cannot tell them apart either.
    """
    driving, driven = torus()
    points = len(driving)
    matrix = np.zeros((_width(terms, drift_order), points))
    matrix[0] = 1.0 / points
    signed = lambda term: term[0] + term[1] * terms.ratio  # noqa: E731
    for term in ((1, 0), (0, 1), *SECOND_ORDER):
        phase = term[0] * driving + term[1] * driven
        for index, harmonic in enumerate(terms.tied):
            if terms.frequency(term) == terms.frequency(harmonic.term) != 0:
                sense = 1.0 if signed(term) == signed(harmonic.term) else -1.0
                place = _cosine_column(terms, drift_order, index)
                matrix[place] += 2 / points * np.cos(phase)
                matrix[place + 1] += sense * 2 / points * np.sin(phase)
    return matrix
