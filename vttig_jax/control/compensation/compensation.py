"""Backlash map as harmonics of both shaft angles, which a controller evaluates in every period.

    j(φ₁, ξ) = c₀ + Σ_t [cosine_t cos(n₁ φ₁ + n₂ ξ) + sine_t sin(n₁ φ₁ + n₂ ξ)],    ξ = i φ₁

Both angles are needed only modulo one turn, so the turn within the hunting period need not be
counted. ξ is the reading φ₂ minus the transmission error. The transmission error need not be known:
at a given φ₁ only as many values of ξ are possible as the hunting period has turns. They are
2π/turns apart, and the right value is the one nearest to the reading φ₂ minus the middle of the
range of the transmission error. If the reading is too far from all possible values, the readings
do not belong to this pair with these zeros, and the backlash is unknown.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Real

from ...base.errors import NoAnswerError, UsageError
from ...base.files.text_tables import key_values
from ...base.units import ARCSEC, DEG, REV
from ...kinematics.harmonic import Term
from ...pair.gear_pair import Drive, GearPair

Readings = Real[ArrayLike, "..."]
Numbers = Float[np.ndarray, "..."] | np.float64
Truths = Bool[np.ndarray, "..."] | np.bool_


class GapReading(NamedTuple):
    """Backlash (rad of the driven gear), its derivative with respect to φ₁, and whether known.

    Where `known` is false, value and derivative are 0.
    """

    backlash_rad: Numbers
    slope: Numbers
    known: Truths


class Shift(NamedTuple):
    """Axial displacement that closes the gap (mm), its derivative by φ₁, and whether known.

    Where `known` is false, value and derivative are 0.
    """

    shift_mm: Numbers
    slope_mm_per_rad: Numbers
    known: Truths


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

    def backlash(self, driving_rad: Readings, driven_rad: Readings) -> GapReading:
        """Return the backlash at single-turn readings, both in rad from the zeros of the fit.

        It is unknown if a reading is not finite, or if the readings are farther than the tolerance
        from every possible position of the pair. According to the map, the pair binds where the
        backlash is negative.

        **Raises** `NoAnswerError` if single-turn readings cannot identify the turn.
        """
        self.require_locating()
        first, second = np.broadcast_arrays(
            np.asarray(driving_rad, np.float64), np.asarray(driven_rad, np.float64)
        )
        finite = np.isfinite(first) & np.isfinite(second)
        first, second = (np.where(finite, angle, 0.0) for angle in (first, second))
        first, second = (angle - REV * np.rint(angle / REV) for angle in (first, second))
        ideal = float(self.ratio) * first
        distance = second - ideal - self.offset_rad
        turn = np.rint(distance / self.spacing_rad)
        known = finite & (np.abs(distance - turn * self.spacing_rad) <= self.tolerance_rad)
        value, slope = self.at_both_angles(first, ideal + turn * self.spacing_rad)
        return GapReading(np.where(known, value, 0.0)[()], np.where(known, slope, 0.0)[()], known)

    def shift(self, driving_rad: Readings, driven_rad: Readings, margin_mm: float = 0.0) -> Shift:
        """Return the axial displacement that closes the gap minus `margin_mm`, but at least 0, mm.

        **Raises** `UsageError` where no displacement closes the gap, `NoAnswerError` where
        single-turn readings never identify the turn, `ValueError` for a negative or NaN margin.
        """
        require_closing(self.closing_rad_per_mm)
        if not (margin_mm >= 0 and math.isfinite(margin_mm)):
            raise ValueError(f"Argument `margin_mm` must be 0 or more, but is {margin_mm}.")
        gap = self.backlash(driving_rad, driven_rad)
        shift = gap.backlash_rad / self.closing_rad_per_mm - margin_mm
        closes = gap.known & (shift > 0)
        return Shift(
            np.where(closes, shift, 0.0)[()],
            np.where(closes, gap.slope / self.closing_rad_per_mm, 0.0)[()],
            gap.known,
        )

    def at_both_angles(
        self, driving_rad: Numbers | float, ideal_rad: Numbers | float
    ) -> tuple[Numbers, Numbers]:
        """Return j(φ₁, ξ) in rad, and its derivative with respect to φ₁ if ξ moves with i φ₁."""
        value = np.full(np.shape(driving_rad), self.constant_rad)
        slope = np.zeros(np.shape(driving_rad))
        ratio = float(self.ratio)
        for (first, second), cosine, sine in zip(
            self.terms, self.cosine_rad, self.sine_rad, strict=True
        ):
            phase = first * np.asarray(driving_rad) + second * np.asarray(ideal_rad)
            wave = np.cos(phase), np.sin(phase)
            value += cosine * wave[0] + sine * wave[1]
            slope += (first + second * ratio) * (sine * wave[0] - cosine * wave[1])
        return value[()], slope[()]

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
