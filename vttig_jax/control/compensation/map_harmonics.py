"""Computation of the harmonics of a backlash map, with a comparison with the map."""

import itertools
import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array

from ...base.errors import NoAnswerError, PairError
from ...base.units import ARCSEC, REV
from ...kinematics.backlash_map import BacklashMap
from ...kinematics.flank_error import errors_at
from ...kinematics.flank_model import FlankModel, ImplicitModel, fixed_point
from ...kinematics.flank_table import FirstOrderBounds
from ...kinematics.harmonic import CombinedModel, OrderModel, Term
from ...pair.gear_pair import Drive, Flank, GearPair
from .compensation import Compensation, closing_of

_LEAST = 1e-12
"""Amplitude up to which a harmonic of the backlash is always omitted, rad; a chosen value."""

_TOLERANCE = 1e-9
"""Largest accepted error of all harmonics, rad: 1/1000 of the finest encoder's resolution."""

_CHECK_ANGLES = 8192
"""Number of angles at which the harmonics are compared with the map: a chosen value."""

_MARGINS = (8, 16, 32)
"""Orders above the highest order of the model that are tried in turn; chosen values.

They are needed because the backlash also contains products of the model's harmonics."""

_MOST_CELLS = 2**26
"""Largest number of grid points of both angles times harmonics of the model (0.5 GB)."""

_PER_PERIOD, _MOST_POINTS = 32, 2**24
"""Grid for the range of the TE: points per cycle of the highest order, and most points in all."""


def compensation_of(
    grid: BacklashMap,
    contact: FlankModel | None = None,
    *,
    allowed_rad: float,
    left_out_rad: float = 0.0,
) -> Compensation:
    """Return the harmonics of a backlash map and check them against the map.

    **Arguments**
    - `grid`: backlash map of a pair or a drive.
    - `contact`: flank model of the transmission error in the encoder readings; by default the model
      of the map.
    - `allowed_rad`: largest error of φ₂ − i φ₁ in the readings, rad.
    - `left_out_rad`: largest sum of the amplitudes of the omitted harmonics, rad; the weakest are
      omitted first. With 0 every harmonic above 1e-12 rad is kept.

    **Raises** `PairError` for a hunting period that is too long or orders that are too high,
    `NoAnswerError` where the harmonics miss the map, `ValueError` for negative tolerances.

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
    >>> gap = compensation.at_both_angles(1.0, 45 / 80 * 1.0)
    >>> bool(abs(gap - grid.at(1.0)) < 1e-11)
    True

    ```
    """
    for name, value in (("allowed_rad", allowed_rad), ("left_out_rad", left_out_rad)):
        if not (value >= 0 and math.isfinite(value)):
            raise ValueError(f"Argument `{name}` must be 0 or more, but is {value}.")
    pair = grid.pair
    low, high = _range(contact or grid.model, pair)
    angles = np.random.default_rng(0).uniform(0.0, pair.hunting_turns * REV, _CHECK_ANGLES)
    map_values = grid.over(angles)

    def of_series(constant: float, terms: tuple[Term, ...], waves: Any) -> Compensation:
        """Return the compensation with these harmonics, and its largest error at `angles`."""
        found = Compensation(
            pair.ratio,
            constant_rad=constant,
            terms=terms,
            cosine_rad=waves.real,
            sine_rad=-waves.imag,
            closing_rad_per_mm=closing_of(pair),
            offset_rad=(low + high) / 2,
            tolerance_rad=(high - low) / 2 + allowed_rad,
            error_rad=math.inf,
        )
        value = found.at_both_angles(angles, float(pair.ratio) * angles)
        return replace(found, error_rad=float(np.abs(value - map_values).max()))

    found = of_series(float(map_values.mean()), (), np.empty(0, complex))
    if found.error_rad <= _LEAST:
        return found  # a constant gap, which has no harmonics
    for margin in _MARGINS:
        series = gap_series(grid.model, _highest(grid.model, margin))
        found = of_series(*series)
        if found.error_rad <= _TOLERANCE:
            return of_series(*_without_weak(*series, left_out_rad))
    raise NoAnswerError(
        f"{len(found.terms)} harmonics of both shafts miss the backlash map by"
        f" {found.error_rad / ARCSEC:.2g}″; fit with lower orders in [fit]."
    )


def gap_series(model: FlankModel, highest: tuple[int, int]) -> tuple[float, tuple[Term, ...], Any]:
    """Return the backlash of a model as a Fourier series in both shaft angles.

        j(φ₁, ξ) = c₀ + Re Σ_t c_t exp(j (n₁ φ₁ + n₂ ξ)),   ξ = i φ₁

    On a grid of both angles it is exact to rounding for orders up to `highest`. Of (n₁, n₂) and
    (−n₁, −n₂), which are the same harmonic, one is returned, and none of at most `_LEAST` rad.

    **Returns** c₀ (rad), the orders (n₁, n₂) and the complex c_t (rad).

    **Raises** `ValueError` for a model that is neither closed nor implicit.
    """
    if isinstance(model, FirstOrderBounds):
        waves = np.asarray(model.cosine) - 1j * np.asarray(model.sine)
        return float(np.diff(model.offset)[0]), ((1, 0), (0, 1)), waves[1] - waves[0]
    if not isinstance(model, ImplicitModel):
        raise ValueError(
            f"Argument `model` must be a closed or implicit flank model, but is {type(model)}."
        )
    counts = [4 * order + 4 for order in highest]
    angles: Any = np.meshgrid(*(REV * np.arange(n) / n for n in counts), indexing="ij")
    spectrum = np.fft.fft2(np.asarray(_gap_on_torus(model, *angles))) / (counts[0] * counts[1])
    orders = itertools.product(range(highest[0] + 1), range(-highest[1], highest[1] + 1))
    terms = tuple(
        term for term in orders if (term[0] > 0 or term[1] > 0) and abs(spectrum[term]) > _LEAST / 2
    )
    return float(spectrum[0, 0].real), terms, 2 * np.array([spectrum[term] for term in terms])


@eqx.filter_jit
def _gap_on_torus(model: ImplicitModel, driving: Array, ideal: Array) -> Array:
    """Return TE_B − TE_A, rad, where both angles are independent: φ₂ = ξ + TE."""

    def error(flank: Flank) -> Array:
        def step(error: Array, args: Any) -> Array:
            model, driving, ideal = args
            return model.at_both_angles(driving, ideal + error, flank)

        return fixed_point(step, (model, driving, ideal))

    return error("B") - error("A")


def _highest(model: FlankModel, margin: int) -> tuple[int, int]:
    """Return the highest order to compute for each shaft: that of the model plus `margin`."""
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


def _without_weak(
    constant: float, terms: tuple[Term, ...], waves: Any, left_out_rad: float
) -> tuple[float, tuple[Term, ...], Any]:
    """Return a series without its weakest harmonics; the others are sorted by order.

    `left_out_rad` is the largest sum of the omitted amplitudes, rad.
    """
    amplitude = np.hypot(waves.real, waves.imag)
    order = np.argsort(amplitude, kind="stable")
    weak = (np.cumsum(amplitude[order]) <= left_out_rad) | (amplitude[order] <= _LEAST)
    kept = sorted(order[~weak].tolist(), key=lambda index: terms[index])
    return constant, tuple(terms[index] for index in kept), waves[kept]


def _range(contact: FlankModel, pair: GearPair | Drive) -> tuple[float, float]:
    """Return the smallest and largest TE of both flanks over the hunting period, rad."""
    per_turn = _PER_PERIOD * math.ceil(max(contact.highest_order, 1.0))
    if pair.hunting_turns * per_turn > _MOST_POINTS:
        raise PairError(
            f"a hunting period of {pair.hunting_turns} turns is too long to search for the range of"
            " its transmission error; give the ratio as a quotient of tooth numbers, such as"
            ' "7/1798".',
            where="drive.ratio" if isinstance(pair, Drive) else "driven.teeth",
        )
    grid = np.arange(pair.hunting_turns * per_turn) * (REV / per_turn)
    both = errors_at(contact, "A", grid), errors_at(contact, "B", grid)
    return float(np.min(both)), float(np.max(both))
