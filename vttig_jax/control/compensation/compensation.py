"""Backlash map as harmonics of both shaft angles, which a controller evaluates in every period.

    j(φ₁, ξ) = c₀ + Σ_t [cosine_t cos(n₁ φ₁ + n₂ ξ) + sine_t sin(n₁ φ₁ + n₂ ξ)],    ξ = i φ₁

Both angles are needed only modulo one turn, so the turn within the hunting period need not be
counted. ξ is the reading φ₂ minus the transmission error. The transmission error need not be known:
at a given φ₁ only as many values of ξ are possible as the hunting period has turns. They are
2π/turns apart, and the right value is the one nearest to the reading φ₂ minus the middle of the
range of the transmission error. If the reading is too far from all possible values, the readings
do not belong to this pair with these zeros, and the backlash is unknown.
"""

import itertools
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ...base.errors import NoAnswerError, PairError, UsageError
from ...base.files.text_tables import key_values
from ...base.units import ARCSEC, DEG, REV
from ...kinematics.backlash_map import BacklashMap
from ...kinematics.flank_error import errors_at
from ...kinematics.flank_model import FlankModel, ImplicitModel, fixed_point
from ...kinematics.flank_table import FirstOrderBounds
from ...kinematics.harmonic import CombinedModel, OrderModel, Term
from ...pair.gear_pair import Drive, Flank, GearPair

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


Numbers = Float[np.ndarray, "..."] | np.float64


def closing_of(pair: GearPair | Drive) -> float:
    """Return the decrease of the backlash per axial displacement, rad/mm; NaN if not positive.

    It is (tan β_L + tan β_R)/R₂.
    """
    if isinstance(pair, GearPair) and float(pair.thinning) > 0:
        return float(pair.thinning) / float(pair.reference_radii[1])
    return math.nan


def require_closing(closing_rad_per_mm: float) -> None:
    """Raise `UsageError` if no axial displacement reduces the backlash (the argument is NaN)."""
    if math.isnan(closing_rad_per_mm):
        raise UsageError(
            "no axial displacement closes this gap: the teeth do not thin towards +z, or the"
            " drive has no gear geometry; export the backlash alone (--quantity backlash), or"
            " give the helix angles of the pair (`helix_angle_deg`) and fit again."
        )


@dataclass(frozen=True)
class Compensation:
    """Backlash and axial displacement as functions of both shaft angles.

    **Arguments**
    - `ratio`: i, driven over driving speed.
    - `constant_rad`: mean backlash over the hunting period, rad of the driven gear.
    - `terms`: orders (n₁, n₂) of the harmonics of the backlash.
    - `cosine_rad`, `sine_rad`: cosine and sine coefficient of each harmonic, rad.
    - `closing_rad_per_mm`: decrease of the backlash per axial displacement,
      (tan β_L + tan β_R)/R₂; NaN if no displacement reduces the backlash.
    - `offset_rad`: middle of the range of the transmission error of both flanks, rad.
    - `tolerance_rad`: largest accepted distance of φ₂ − i φ₁ − `offset_rad` from a multiple of
      `spacing_rad`: half of that range plus the allowed error of the readings, rad. `spacing_rad`
      is 2π divided by the driving turns in the hunting period.
    - `error_rad`: largest difference between the harmonics and the map at 8192 angles, rad.
    """

    ratio: Fraction
    constant_rad: float
    terms: tuple[Term, ...]
    cosine_rad: Float[np.ndarray, " terms"]
    sine_rad: Float[np.ndarray, " terms"]
    closing_rad_per_mm: float
    offset_rad: float
    tolerance_rad: float
    error_rad: float

    @property
    def hunting_turns(self) -> int:
        """Number of turns of the driving shaft in the hunting period."""
        return self.ratio.denominator

    @property
    def spacing_rad(self) -> float:
        """Distance between the driven angles ξ that are possible at one driving angle, rad.

        It is 2π/`hunting_turns`: in each turn of the hunting period, the same driving angle modulo
        one turn belongs to another driven angle modulo one turn.
        """
        return REV / self.hunting_turns

    @property
    def is_locating(self) -> bool:
        """Whether single-turn readings identify the driving turn within the hunting period.

        They do if `tolerance_rad` is less than half of `spacing_rad`.
        """
        return self.tolerance_rad < self.spacing_rad / 2

    def at_both_angles(self, driving_rad: Numbers | float, ideal_rad: Numbers | float) -> Numbers:
        """Return j(φ₁, ξ), rad of the driven gear."""
        value = np.full(np.shape(driving_rad), self.constant_rad)
        for (first, second), cosine, sine in zip(
            self.terms, self.cosine_rad, self.sine_rad, strict=True
        ):
            phase = first * np.asarray(driving_rad) + second * np.asarray(ideal_rad)
            value += cosine * np.cos(phase) + sine * np.sin(phase)
        return value[()]

    def require_locating(self) -> None:
        """Raise `NoAnswerError` if single-turn readings cannot identify the turn."""
        if not self.is_locating:
            raise NoAnswerError(
                f"the driven angles of the {self.hunting_turns} turns of the hunting period are"
                f" {self.spacing_rad / DEG:.3g}° apart, but a reading may be"
                f" {self.tolerance_rad / DEG:.3g}° off: single-turn readings do not tell the turn;"
                " allow a smaller error of the readings (--tolerance-arcsec), or count the turns"
                " and use the harmonics in JSON or the table in CSV."
            )

    def to_json(self) -> dict[str, Any]:
        """Return the fields of schema `vttig.compensation/1` except those about the input files."""
        harmonics = zip(self.terms, self.cosine_rad, self.sine_rad, strict=True)
        closing = self.closing_rad_per_mm
        return {
            "meaning": "backlash_rad = constant_rad + sum of cos_rad cos(p) + sin_rad sin(p) with p"
            " = driving_order phi1 + driven_order xi and xi = ratio phi1; phi1: driving angle from"
            " the zero of the fit, turns counted within the hunting period; xi is also the driven"
            " reading less its transmission error. rad of the driven gear. axial_mm = backlash_rad"
            " / closing_rad_per_mm. Readings phi1, phi2 of single turns belong to this pair where"
            " phi2 - ratio phi1 - offset_rad is within tolerance_rad of a multiple of spacing_rad;"
            " xi = ratio phi1 + that multiple.",
            "ratio": str(self.ratio),
            "ratio_value": float(self.ratio),
            "hunting_turns": self.hunting_turns,
            "constant_rad": self.constant_rad,
            "harmonics": [
                {
                    "driving_order": first,
                    "driven_order": second,
                    "cos_rad": float(cosine),
                    "sin_rad": float(sine),
                }
                for (first, second), cosine, sine in harmonics
            ],
            "closing_rad_per_mm": closing if math.isfinite(closing) else None,
            "offset_rad": self.offset_rad,
            "tolerance_rad": self.tolerance_rad,
            "spacing_rad": self.spacing_rad,
            "locating": self.is_locating,
            "error_rad": self.error_rad,
        }

    def __str__(self) -> str:
        closing = self.closing_rad_per_mm
        rows = [
            ("harmonics", f"{len(self.terms)}, within {self.error_rad / ARCSEC:.2g}″ of the map"),
            ("hunting period", f"{self.hunting_turns} driving turns"),
            ("mean backlash", f"{self.constant_rad / DEG:.5f}°"),
            (
                "readings known",
                f"within {self.tolerance_rad / DEG:.4f}° of angles {self.spacing_rad / DEG:.4g}°"
                " apart",
            ),
        ]
        if math.isfinite(closing):
            rows.append(("mean axial shift", f"{self.constant_rad / closing:.4f} mm"))
        return key_values(rows, title="compensation")


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
        constant, terms, waves = gap_series(grid.model, _highest(grid.model, margin))
        found = of_series(constant, terms, waves)
        if found.error_rad <= _TOLERANCE:
            amplitude = np.hypot(waves.real, waves.imag)
            order = np.argsort(amplitude, kind="stable")
            weak = (np.cumsum(amplitude[order]) <= left_out_rad) | (amplitude[order] <= _LEAST)
            kept = sorted(order[~weak].tolist(), key=lambda index: terms[index])
            return of_series(constant, tuple(terms[index] for index in kept), waves[kept])
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
