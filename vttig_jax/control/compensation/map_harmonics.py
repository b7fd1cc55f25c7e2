"""From a backlash map to its harmonics, checked against the map itself."""

import math
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Numbers
from ...base.errors import NoAnswerError, PairError
from ...base.units import ARCSEC, REV
from ...kinematics.backlash_map import BacklashMap, chunked
from ...kinematics.flank_model import FlankModel
from ...kinematics.harmonic import CombinedModel, OrderModel, Term
from ...pair.gear_pair import Drive, Flank, GearPair
from ..plants.flank_bounds import bounds_of
from .compensation import Compensation

_LEAST = 1e-12
"""rad below which a harmonic of the backlash is left out."""

_GOOD = 1e-9
"""rad that the harmonics may miss the map by, a thousandth of what the finest encoder resolves."""

_CHECKED = 8192
"""Angles of the hunting period at which the harmonics are compared with the map."""

_MARGINS = (8, 16, 32)
"""Orders above those of the model that are tried: what its harmonics make of each other."""

_MOST_CELLS = 2**26
"""Points of both angles times harmonics of the model: 0.5 GB."""

_PER_PERIOD, _MOST_POINTS = 32, 2**24
"""Grid on which the range of the transmission error is searched."""


def compensation_of(
    grid: BacklashMap,
    contact: FlankModel | None = None,
    *,
    allowed_rad: float,
    left_out_rad: float = 0.0,
) -> Compensation:
    """The harmonics of a backlash map, checked against it.

    **Arguments**
    - `grid`: the map, of a pair or a drive.
    - `contact`: the flank model whose transmission errors the encoders show; that of the map where
      absent.
    - `allowed_rad`: how far the readings may put φ₂ − i φ₁ off what the flanks allow.
    - `left_out_rad`: amplitudes that the harmonics left out may add up to: the weakest are, as long
      as their sum stays below. At 0 every harmonic above 1e-12 rad is kept.

    **Raises** `PairError` for a hunting period or a mesh order too long to work out,
    `NoAnswerError` where no harmonics come close to the map, `ValueError` for negative tolerances.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import compensation_of
    >>> from vttig_jax.kinematics import BacklashMap
    >>> from vttig_jax.kinematics import exact_model
    >>> from vttig_jax.rig import paper_eccentricities, paper_pair
    >>> vttig_jax.enable_x64()
    >>> pair = paper_pair()
    >>> grid = BacklashMap(exact_model(pair, paper_eccentricities()), None, pair)
    >>> compensation = compensation_of(grid, allowed_rad=1e-4)
    >>> gap = compensation.backlash(1.0, 45 / 80 * 1.0)
    >>> bool(gap.known), bool(abs(gap.backlash_rad - grid.at(1.0)) < 1e-11)
    (True, True)

    ```
    """
    for name, value in (("allowed_rad", allowed_rad), ("left_out_rad", left_out_rad)):
        if not (value >= 0 and math.isfinite(value)):
            raise ValueError(f"Argument `{name}` must be 0 or more, but is {value}.")
    pair, closing = grid.pair, math.nan
    if isinstance(pair, GearPair) and float(pair.thinning) > 0:
        closing = float(pair.thinning) / float(pair.reference_radii[1])
    low, high = _range(contact or grid.model, pair)
    angles = np.random.default_rng(0).uniform(0.0, pair.hunting_turns * REV, _CHECKED)
    wanted = grid.over(angles)
    empty = Compensation(
        pair.ratio,
        constant_rad=float(wanted.mean()),
        terms=(),
        cosine_rad=np.empty(0),
        sine_rad=np.empty(0),
        closing_rad_per_mm=closing,
        offset_rad=(low + high) / 2,
        tolerance_rad=(high - low) / 2 + allowed_rad,
        error_rad=math.inf,
    )
    full = _with_harmonics(empty, grid.model, angles, wanted)
    return _checked(_without_weak(full, left_out_rad), angles, wanted)


def _with_harmonics(
    empty: Compensation,
    model: FlankModel,
    angles: Float[np.ndarray, " n"],
    wanted: Float[np.ndarray, " n"],
) -> Compensation:
    """All harmonics of the backlash; of higher orders until they give the map."""
    found = _checked(empty, angles, wanted)
    if found.error_rad <= _LEAST:
        return found  # a gap of one width, which has no harmonics
    for margin in _MARGINS:
        bounds = bounds_of(model, np.zeros(2), _highest(model, margin))
        offset, cosine, sine = (
            np.asarray(values)[1] - np.asarray(values)[0]
            for values in (bounds.offset, bounds.cosine, bounds.sine)
        )
        found = replace(
            empty,
            constant_rad=float(offset),
            terms=bounds.terms,
            cosine_rad=cosine,
            sine_rad=sine,
        )
        found = _checked(found, angles, wanted)
        if found.error_rad <= _GOOD:
            return found
    raise NoAnswerError(
        f"{len(found.terms)} harmonics of both shafts miss the backlash map by"
        f" {found.error_rad / ARCSEC:.2g}″; fit with lower orders in [fit]."
    )


def _highest(model: FlankModel, margin: int) -> tuple[int, int]:
    """Orders of both shafts to look at: those of the model and `margin` more."""
    terms: tuple[Term, ...] = ()
    if isinstance(model, OrderModel):
        terms = model.terms
    elif isinstance(model, CombinedModel):
        terms = model.orders.terms
    driving = max((abs(first) for first, _ in terms), default=1) + margin
    driven = max((abs(second) for _, second in terms), default=1) + margin
    if 16 * (driving + 1) * (driven + 1) * (len(terms) + 1) > _MOST_CELLS:
        raise PairError(
            f"harmonics up to order {driving} of the driving and {driven} of the driven shaft are"
            " too many to work out; fit with fewer or lower orders in [fit].",
            where="fit.mesh_orders",
        )
    return driving, driven


def _without_weak(full: Compensation, left_out_rad: float) -> Compensation:
    """Without the weakest harmonics, and in a fixed order."""
    amplitude = np.hypot(full.cosine_rad, full.sine_rad)
    order = np.argsort(amplitude, kind="stable")
    weak = (np.cumsum(amplitude[order]) <= left_out_rad) | (amplitude[order] <= _LEAST)
    kept = sorted(order[~weak].tolist(), key=lambda place: full.terms[place])
    return replace(
        full,
        terms=tuple(full.terms[place] for place in kept),
        cosine_rad=full.cosine_rad[kept],
        sine_rad=full.sine_rad[kept],
    )


def _checked(
    made: Compensation, angles: Float[np.ndarray, " n"], wanted: Float[np.ndarray, " n"]
) -> Compensation:
    """The compensation with its error against the map."""
    value, _ = made.at_both_angles(angles, float(made.ratio) * angles)
    return replace(made, error_rad=float(np.abs(value - wanted).max()))


def _range(contact: FlankModel, pair: GearPair | Drive) -> tuple[float, float]:
    """Least and largest transmission error over the hunting period, on either flank."""
    per_turn = _PER_PERIOD * math.ceil(max(contact.highest_order, 1.0))
    if pair.hunting_turns * per_turn > _MOST_POINTS:
        raise PairError(
            f"a hunting period of {pair.hunting_turns} turns is too long to search for the range of"
            " its transmission error; give the ratio as a quotient of tooth numbers, such as"
            ' "7/1798".',
            where="drive.ratio" if isinstance(pair, Drive) else "driven.teeth",
        )
    grid = np.arange(pair.hunting_turns * per_turn) * (REV / per_turn)

    def over(flank: Flank) -> Float[np.ndarray, " n"]:
        return chunked(lambda angles: _transmission_error(contact, angles, flank), grid)

    lower, upper = over("A"), over("B")
    return float(min(lower.min(), upper.min())), float(max(lower.max(), upper.max()))


@eqx.filter_jit
def _transmission_error(model: FlankModel, angles: Numbers, flank: Flank) -> Array:
    return model.transmission_error(angles, flank)
