"""Eccentric gears and encoders: the harmonics that they cause, and the way back by least squares.

The exact relation of a pair is explicit if both shaft angles are given, and periodic in both. Its
projection on a grid of both angles gives the coefficients of the first orders, of the terms
(1, ±1) of second order, and of the constants. Encoder errors add + E₂ sin(φ₂ + ε₂) −
i E₁ sin(φ₁ + ε₁) on both flanks. With flat priors the coefficients of the log are normal given θ,
so that the physical parameters p minimise (h(p) − b̂)ᵀ V⁻¹ (h(p) − b̂).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ..base.arrays import Numbers
from ..kinematics.exact import ExactModel, exact_model
from ..kinematics.flank_model import flank_index
from ..pair.gear_pair import Eccentricities, GearPair
from ..pair.schema import Flank
from .columns import GAP, ColumnName
from .mixed_fit import MixedFit
from .rows import RowName, S, Wave

POINTS = 8
"""Points per turn of each shaft. Orders below 4 are exact; only terms of order e⁶ alias to them."""

KINDS = ("", "_encoder")
"""Endings of a shaft in the names of the errors of its gear and of its encoder."""

GEARS = ("driving_x", "driving_y", "driven_x", "driven_y")
ENCODERS = ("driving_encoder_x", "driving_encoder_y", "driven_encoder_x", "driven_encoder_y")
_TERMS = {("driving", 1): (1, 0), ("driven", 1): (0, 1), ("both", 1): (1, 1), ("both", -1): (1, -1)}


class Relation(eqx.Module):
    """Coefficients of the columns that follow from the parameters.

    `model` is the exact model of the pair without errors, lengths in mm.
    `names` are the parameters: eccentricities (mm) and encoder errors (rad) in Cartesian form.
    `waves` are shaft and order of the tied harmonics of the model, `both` whether both flanks were
    measured, and `flank` that of a fit of one flank. The columns take the driven gear at
    one nominal angle for both flanks. Flank A is half the mean `gap` (rad) behind it and flank B
    half ahead.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    waves: tuple[tuple[str, int], ...] = eqx.field(static=True)
    both: bool = eqx.field(static=True)
    flank: Flank = eqx.field(static=True)
    model: ExactModel
    gap: Float[Numbers, ""]

    def tied_columns(self, index: Mapping[ColumnName, int]) -> list[int]:
        """Return the places of the tied coefficients in a model, in the order of `coefficients`."""
        return [
            index[ColumnName(RowName(*wave, part), 0, differs)]
            for wave in self.waves
            for differs in ((False, True) if self.both else (False,))
            for part in ("cos", "sin")
        ]

    def coefficients(self, parameters: Float[Array, " p"]) -> Float[Array, " c"]:
        """Return mean (cos, sin) and difference (cos, sin) of every wave, then the constants.

        The constants are the mean and the difference of both flanks, rad. With one flank there
        are no differences.
        """
        value = dict(zip(self.names, parameters, strict=True))
        gears = [value.get(name, jnp.zeros(())) for name in GEARS]
        angles = 2 * np.pi * np.arange(POINTS) / POINTS
        grid = np.stack([x.ravel() for x in np.meshgrid(angles, angles, indexing="ij")])
        offsets = {"driving_offset": gears[0] + 1j * gears[1]}
        offsets["driven_offset"] = gears[2] + 1j * gears[3]
        model = replace(self.model, **offsets)
        flanks: list[Flank] = [*S] if self.both else [self.flank]
        senses = np.array([[-2 * S[flank]] for flank in flanks])
        sums = model.base_sum[np.array([flank_index(flank) for flank in flanks])][:, None]
        driving = jnp.asarray(grid[:1])
        driven = jnp.asarray(grid[1:]) - 0.5 * self.gap * senses
        error = jnp.asarray(model.turned(driving, driven, sums, senses))
        for shaft, angle, gain in (("driving", driving, -model.ratio), ("driven", driven, 1.0)):
            if (x := value.get(f"{shaft}_encoder_x")) is not None:
                y = value[f"{shaft}_encoder_y"]
                error = error + gain * (x * jnp.sin(angle) + y * jnp.cos(angle))
        mean = error.mean(0, keepdims=True)
        kinds = jnp.concatenate([mean, error[1:] - error[:1]])  # the second one if both are there
        phases = np.array([_TERMS[wave] for wave in self.waves]) @ grid
        basis = 2 * np.stack([np.cos(phases), np.sin(phases)], axis=1) / POINTS**2
        found = jnp.einsum("wpn,kn->wkp", basis, kinds)
        return jnp.concatenate([found.ravel(), kinds.mean(1)])


@dataclass(frozen=True, eq=False)
class Gears:
    """Fitted eccentricities and encoder errors.

    `values` are those of `relation.names`, and change with the coefficients of the model by
    `rows`, shape (parameters, columns). `constants` are the mean and the difference of the
    transmission error that the gears cause, rad.
    """

    relation: Relation
    values: Float[np.ndarray, " p"]
    rows: Float[np.ndarray, "p columns"]
    constants: Float[np.ndarray, " c"]


def relation_of(
    pair: GearPair,
    waves: Sequence[Wave],
    *,
    both: bool,
    flank: Flank,
    kinds: Sequence[str] = KINDS,
    gap: float = 0.0,
) -> Relation | None:
    """Return the relation of a model with these waves, or None if no first order is among them.

    A shaft whose first order is not in the model has no parameters. Of several `kinds` of
    parameters one flank alone tells the first; the others are taken as zero. `gap` is the mean
    backlash, rad, which one flank alone has not.
    """
    present = [(w.shaft, int(w.order)) for w in waves if (w.shaft, w.order) in _TERMS]
    shafts = [shaft for shaft in ("driving", "driven") if (shaft, 1) in present]
    if not shafts:
        return None
    kinds = kinds if both else kinds[:1]
    return Relation(
        names=tuple(f"{s}{kind}_{a}" for kind in kinds for s in shafts for a in "xy"),
        waves=tuple(present),
        both=both,
        flank=flank,
        model=exact_model(pair, Eccentricities()),
        gap=np.asarray(gap),
    )


def fitted_gears(pair: GearPair, fit: MixedFit, kinds: Sequence[str] = KINDS) -> Gears | None:
    """Return the parameters of the gears and encoders; the arguments are those of `relation_of`."""
    posterior, index = fit.posterior, fit.posterior.problem.index
    both, flank = GAP in index, fit.scope.flanks[0]
    gap = float(posterior.moved[index[GAP]]) if both else 0.0
    relation = relation_of(pair, fit.waves, both=both, flank=flank, kinds=kinds, gap=gap)
    if relation is None:
        return None
    rows = np.eye(len(posterior.problem.columns))[relation.tied_columns(index)]
    mean, covariance, _ = posterior.told(rows, moved=True)
    value, slope, constants = map(np.asarray, least_squares(relation, mean, covariance))
    scale = np.sqrt(np.diag(covariance))
    weight = np.linalg.solve(covariance / scale / scale[:, None], slope / scale[:, None])
    gain = np.linalg.solve((slope / scale[:, None]).T @ weight, weight.T) / scale
    return Gears(relation, value, gain @ rows, constants)


@eqx.filter_jit
def least_squares(
    relation: Relation,
    mean: Float[Numbers, " c"],
    covariance: Float[Numbers, "c c"],
) -> tuple[Float[Array, " p"], Float[Array, "c p"], Float[Array, " constants"]]:
    """Return parameters, slopes of the coefficients, and constants (Levenberg and Marquardt)."""
    count = len(mean)
    scale = jnp.sqrt(jnp.diag(covariance))
    factor = jnp.linalg.cholesky(covariance / scale[None] / scale[:, None] + 1e-12 * jnp.eye(count))
    # the usual sizes of the parameters relative to each other
    unit = jnp.array([1.0 if name in GEARS else 1e-3 for name in relation.names])

    def residual(scaled: Float[Array, " p"], _: None) -> Float[Array, " c"]:
        off = (relation.coefficients(unit * scaled)[:count] - mean) / scale
        return jax.scipy.linalg.solve_triangular(factor, off, lower=True)

    solver, start = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10), jnp.full(len(unit), 1e-6)
    found = optx.least_squares(residual, solver, start, max_steps=64, throw=False)
    value = unit * found.value
    slopes = jax.jacfwd(relation.coefficients)(value)[:count]
    return value, slopes, relation.coefficients(value)[count:]
