"""Table of the fitted harmonics of every flank, and the flank model that they make."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import erfc, gammaincc

from ..base.numerics.polar_spread import polar_spread
from ..base.units import ARCSEC
from ..kinematics.exact import ExactModel, exact_model
from ..kinematics.first_order import ClosedModel, closed_model
from ..kinematics.harmonic import OrderModel
from ..model.mixed_fit import CLEAR, MixedFit
from ..model.parameter import LARGEST
from ..model.parameters import FULL_TURN, SIGNIFICANT
from ..model.rows import KNOTS, Wave
from ..pair.gear_pair import Eccentricities, Flank, GearPair

SIDES: dict[int, Flank] = {1: "A", -1: "B"}
"""Side of a run in the model → flank."""

_RANKS = {"driving": 0, "driven": 1, "mesh": 2}


@dataclass(frozen=True)
class Order:
    """Harmonic a sin(k φ_shaft + p) of the transmission error of one flank, at the driven gear.

    The phase p of a fractional order holds for the zero of the shaft angle of the log. An order is
    `significant` if its amplitude is at least `CLEAR` standard errors.
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

    def __str__(self) -> str:
        return f"{self.amplitude_arcsec:.3g} ± {self.std_arcsec:.2g}"


def order_rows(
    core: MixedFit, wave: Wave, side: int, log: int = 0, *, common: float = 1.0
) -> Float[np.ndarray, "2 columns"]:
    """Return the functionals (a cos p, a sin p) of a harmonic on a flank, 1 for A and −1 for B.

    `common`: share of what both flanks have in common.
    """
    index = core.posterior.problem.index
    rows = np.zeros((2, len(index)))
    for place, part in enumerate(("sin", "cos")):
        for differs, weight in ((False, common), (True, -0.5 * side)):
            if (name := (wave.shaft, wave.order, part, differs, log)) in index:
                rows[place, index[name]] = weight
    return rows


def order_table(core: MixedFit) -> tuple[Order, ...]:
    """Return amplitude, standard error and phase of all harmonics on every flank.

    Harmonics of a shaft that made less than a turn are left out. A line is a fractional order of
    the driving shaft.
    """
    asked = [
        (wave, side)
        for wave in core.waves
        for side in core.scope.flanks
        if wave.shaft != "both" and has_turned(core, wave)
    ]
    if not asked:
        return ()
    rows = np.concatenate([order_rows(core, wave, side) for wave, side in asked])
    mean, covariance, _ = core.posterior.told(rows, moved=True)
    table = []
    for number, (wave, side) in enumerate(asked):
        own = slice(2 * number, 2 * number + 2)
        amplitude, std, phase_deg, _ = polar_spread(
            mean[own] / ARCSEC, covariance[own, own] / ARCSEC**2
        )
        if std > LARGEST["arcsec"]:
            continue
        shaft = "driving" if wave.shaft == "line" else wave.shaft
        significant = amplitude >= CLEAR * std
        table.append(Order(shaft, wave.order, SIDES[side], amplitude, std, phase_deg, significant))
    return tuple(sorted(table, key=lambda o: (_RANKS[o.shaft], o.order, o.flank)))


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


def has_turned(core: MixedFit, wave: Wave) -> bool:
    """Return whether the shaft of a harmonic made a full turn."""
    shaft = "driven" if wave.shaft == "driven" else "driving"
    return bool(core.scope.turns[shaft] >= FULL_TURN)


def whole_waves(core: MixedFit) -> list[Wave]:
    """Return the harmonics of whole orders, which a map contains."""
    return [w for w in core.waves if all(float(n).is_integer() for n in (w.driving, w.driven))]


def _shown_sides(core: MixedFit) -> list[int]:
    """Return for flanks A and B the flank whose numbers they have: an unmeasured one the other."""
    return [side if side in core.scope.flanks else -side for side in SIDES]


def flank_rows(
    core: MixedFit, *, bends: bool = False
) -> Float[np.ndarray, "flanks=2 waves 2 columns"]:
    """Return the functionals (sine, cosine) of all whole orders on both flanks.

    What both flanks have in common at orders of a shaft that made less than a turn counts with
    `bends` only.
    """
    rows = [
        order_rows(core, wave, side, common=float(bends or has_turned(core, wave)))
        for side in _shown_sides(core)
        for wave in whole_waves(core)
    ]
    # A model may have no orders.
    return np.reshape(rows, (2, -1 if rows else 0, 2, len(core.posterior.moved)))


def order_model(core: MixedFit) -> OrderModel:
    """Return the flank model of all whole orders, in the angles of the first log.

    What both flanks have in common at orders of a shaft that made less than a turn is a slow bend
    of the log; only its mean counts. An unmeasured flank has the orders of the other one. The
    offset is that of the mean level.
    """
    moved = core.posterior.moved
    series = flank_rows(core) @ moved
    levels = np.stack([level_row(core, side) for side in _shown_sides(core)])
    return OrderModel(
        ratio=jnp.asarray(core.scope.ratio),
        terms=tuple((int(wave.driving), int(wave.driven)) for wave in whole_waves(core)),
        offset=jnp.asarray(levels @ moved + core.scope.levels[0]),
        cosine=jnp.asarray(series[..., 1]),
        sine=jnp.asarray(series[..., 0]),
    )


def level_row(core: MixedFit, side: int) -> Float[np.ndarray, " columns"]:
    """Return the functional of the mean level of the first log on a flank."""
    row, index = core.posterior.row(("offset", 0)), core.posterior.problem.index
    if ("gap",) in index:
        row[index["gap",]] = -0.5 * side
    first = core.rows[0]
    for wave in core.waves:
        for part in ("cos", "sin"):
            name = (wave.shaft, wave.order, part)
            if not has_turned(core, wave) and (*name, False, 0) in index:
                row[index[*name, False, 0]] = first.table[:, first.names[name]].mean()
    for k in range(KNOTS):
        if ("drift", 0, k) in index:
            row[index["drift", 0, k]] = first.table[:, first.names["drift", k]].mean()
    return row


def mounted_exact(pair: GearPair, rig: Eccentricities, mounting: float) -> ExactModel:
    """Return the exact model with φ₂ as the driven encoder reads it.

    The driven gear is at φ₂ = i φ₁ + m + TE. The `mounting` m is the reading of the driven encoder
    where the driving encoder reads zero, minus the TE there; it may be several radians if the
    encoders are absolute. The phase θ₂ of the driven eccentricity counts from φ₂ = 0 in both cases.
    """
    model = exact_model(pair, rig)
    return eqx.tree_at(lambda m: m.offset, model, jnp.asarray(model.offset) + mounting)


def mounted_closed(pair: GearPair, rig: Eccentricities, mounting: float) -> ClosedModel:
    """Return the closed form, (19) and (20), with the driven phasor rotated by the mounting."""
    model = closed_model(pair, rig)
    turned = model.driven_phasor * jnp.exp(1j * mounting)
    moved = jnp.asarray(model.offset) + mounting
    return eqx.tree_at(lambda m: (m.driven_phasor, m.offset), model, (turned, moved))
