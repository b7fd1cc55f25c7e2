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
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import NoAnswerError, UsageError
from ...base.files.text_tables import key_values
from ...base.units import ARCSEC, DEG, REV
from ...kinematics.harmonic import Term
from ...pair.gear_pair import Drive, GearPair

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
