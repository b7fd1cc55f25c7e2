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
from ..kinematics.first_order import closed_model
from ..kinematics.flank_table import FirstOrderBounds
from ..kinematics.harmonic import OrderModel
from ..model.columns import GAP, ColumnName
from ..model.mixed_fit import CLEAR, MixedFit
from ..model.parameter import LARGEST
from ..model.parameters import FULL_TURN, SIGNIFICANT
from ..model.rows import ONE, S, Wave
from ..pair.gear_pair import Eccentricities, GearPair
from ..pair.schema import Flank

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
    core: MixedFit, wave: Wave, flank: Flank, log: int = 0, *, common: float = 1.0
) -> Float[np.ndarray, "2 columns"]:
    """Return the functionals (a cos p, a sin p) of a harmonic on a flank.

    `common`: share of what both flanks have in common.
    """
    index = core.posterior.problem.index
    rows = np.zeros((2, len(core.posterior.problem.columns)))
    for place, part in enumerate(("sin", "cos")):
        for differs, weight in ((False, common), (True, S[flank])):
            if (name := ColumnName(wave.row(part), log, differs)) in index:
                rows[place, index[name]] = weight
    return rows


def order_table(core: MixedFit) -> tuple[Order, ...]:
    """Return amplitude, standard error and phase of all harmonics on every flank.

    Harmonics of a shaft that made less than a turn are left out. A line is a fractional order of
    the driving shaft.
    """
    asked: list[tuple[Wave, Flank]] = [
        (wave, flank)
        for wave in core.waves
        for flank in core.scope.flanks
        if wave.shaft != "both" and has_turned(core, wave)
    ]
    if not asked:
        return ()
    rows = np.concatenate([order_rows(core, wave, flank) for wave, flank in asked])
    mean, covariance, _ = core.posterior.told(rows, moved=True)
    table = []
    for number, (wave, flank) in enumerate(asked):
        own = slice(2 * number, 2 * number + 2)
        amplitude, std, phase_deg, _ = polar_spread(
            mean[own] / ARCSEC, covariance[own, own] / ARCSEC**2
        )
        if std > LARGEST["arcsec"]:
            continue
        shaft = "driving" if wave.shaft == "line" else wave.shaft
        significant = amplitude >= CLEAR * std
        table.append(Order(shaft, wave.order, flank, amplitude, std, phase_deg, significant))
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


def _shown_flanks(core: MixedFit) -> list[Flank]:
    """Return for flanks A and B the flank whose numbers they have: an unmeasured one the other."""
    measured = core.scope.flanks
    return [flank if flank in measured else measured[0] for flank in S]


def flank_rows(
    core: MixedFit, *, bends: bool = False
) -> Float[np.ndarray, "flanks=2 waves 2 columns"]:
    """Return the functionals (sine, cosine) of all whole orders on both flanks.

    What both flanks have in common at orders of a shaft that made less than a turn counts with
    `bends` only.
    """
    rows = [
        order_rows(core, wave, flank, common=float(bends or has_turned(core, wave)))
        for flank in _shown_flanks(core)
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
    levels = np.stack([level_row(core, flank) for flank in _shown_flanks(core)])
    return OrderModel(
        ratio=jnp.asarray(core.scope.ratio),
        terms=tuple((int(wave.driving), int(wave.driven)) for wave in whole_waves(core)),
        offset=jnp.asarray(levels @ moved + core.scope.levels[0]),
        cosine=jnp.asarray(series[..., 1]),
        sine=jnp.asarray(series[..., 0]),
    )


def level_row(core: MixedFit, flank: Flank) -> Float[np.ndarray, " columns"]:
    """Return the functional of the mean level of the first log on a flank."""
    row, index = core.posterior.row(ColumnName(ONE, 0)), core.posterior.problem.index
    if GAP in index:
        row[index[GAP]] = S[flank]
    bent = {w.row(part) for w in core.waves if not has_turned(core, w) for part in ("cos", "sin")}
    first = core.rows[0]
    for name, place in index.items():
        own = name.log == 0 and not name.differs
        if own and (name.row in bent or name.row.kind == "drift"):
            row[place] = first.column(name.row).mean()
    return row


def mounted_exact(pair: GearPair, rig: Eccentricities, mounting: float) -> ExactModel:
    """Return the exact model with φ₂ as the driven encoder reads it.

    The driven gear is at φ₂ = i φ₁ + m + TE. The `mounting` m is the reading of the driven encoder
    where the driving encoder reads zero, minus the TE there; it may be several radians if the
    encoders are absolute. The phase θ₂ of the driven eccentricity counts from φ₂ = 0 in both cases.
    """
    model = exact_model(pair, rig)
    return eqx.tree_at(lambda m: m.offset, model, jnp.asarray(model.offset) + mounting)


def mounted_closed(pair: GearPair, rig: Eccentricities, mounting: float) -> FirstOrderBounds:
    """Return the closed form, (19) and (20), with the driven waves ahead by the mounting."""
    model = closed_model(pair, rig).ahead(jnp.array([0.0, mounting]))
    return eqx.tree_at(lambda m: m.offset, model, jnp.asarray(model.offset) + mounting)
