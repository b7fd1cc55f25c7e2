"""Report of the drawn backlash by section, compared with the apparent backlash of a fit."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import PairError
from ...base.files.text_tables import key_values, text_table
from ...base.units import DEG
from ...pair.gear_pair import GearPair
from ..mounting import common_face
from ..tooth.tooth import tooth_of
from .drawn_backlash import Teeth, backlash_and_contact, section_backlash

_SECTIONS = 11  # sections reported by default; a chosen number
TOUCHING = 1e-9
"""Angle, rad, within which flanks touch: they interfere only if they overlap by more (chosen)."""


@dataclass(frozen=True)
class GapReport:
    """Backlash at one centre distance and axial position without eccentricity.

    **Arguments**
    - `centre_distance_mm`, `axial_mm`: centre distance a and axial shift s.
    - `backlash`: backlash of the pair, rad of the driven gear; negative if the teeth interfere.
    - `reference_radius_mm`: radius R₂, which converts rad to mm.
    - `contact_z_mm`: heights at which flank A and flank B have the least clearance.
    - `z_mm`: heights of sections over the common face.
    - `section_backlash`: backlash of each section alone, rad.
    - `apparent`: constant backlash estimated by a fit, rad, or None.
    - `logged_axial_mm`, `logged_backlash`: axial shift of the log and drawn backlash there, rad.
    - `opening_mm`: increase of the backlash at the reference circle, mm, per mm of −s.
    """

    centre_distance_mm: float
    axial_mm: float
    backlash: float
    reference_radius_mm: float
    contact_z_mm: Float[np.ndarray, "2"]
    z_mm: Float[np.ndarray, " n"]
    section_backlash: Float[np.ndarray, " n"]
    apparent: float | None
    logged_axial_mm: float
    logged_backlash: float
    opening_mm: float

    @property
    def backlash_mm(self) -> float:
        """Backlash at the reference circle of the driven gear, mm."""
        return self.backlash * self.reference_radius_mm

    @property
    def interferes(self) -> Bool[np.ndarray, " n"]:
        """Whether the teeth of each section are thicker than the space, beyond rounding."""
        return self.section_backlash < -TOUCHING

    @property
    def difference(self) -> float | None:
        """Apparent minus drawn backlash, rad; None without a fit.

        Its causes are thinner teeth, a larger centre distance, torsional wind-up and bearing play.
        """
        return None if self.apparent is None else self.apparent - self.logged_backlash

    def __str__(self) -> str:
        size = np.array([self.backlash / DEG, self.backlash_mm])
        pairs = [
            ("centre distance", f"{self.centre_distance_mm:g} mm"),
            ("axial position", f"{self.axial_mm:g} mm"),
            ("backlash", "{:.4f}° = {:.4f} mm".format(*(size.round(4) + 0.0))),
            (
                "least room at z",
                "A {:.3f} mm, B {:.3f} mm".format(*(self.contact_z_mm.round(3) + 0.0)),
            ),
        ]
        if self.difference is not None and self.apparent is not None:
            pairs.append(("apparent, of the fit", f"{self.apparent / DEG:.4f}°"))
            thinner = self.difference * self.reference_radius_mm
            text = f"{self.difference / DEG:+.4f}° = {thinner:+.4f} mm of tooth thickness"
            if self.opening_mm:
                text += f" or {-thinner / self.opening_mm:+.3f} mm of s"
            pairs.append((f"less that drawn at s = {self.logged_axial_mm:g}", text))
        rows = [
            (
                f"{z:.3f}",
                f"{round(gap / DEG, 4) + 0.0:.4f}",  # no −0
                f"{round(gap * self.reference_radius_mm, 4) + 0.0:.4f}",
                "interferes" if interferes else "",
            )
            for z, gap, interferes in zip(
                self.z_mm, self.section_backlash, self.interferes, strict=True
            )
        ]
        headers = [("z", "mm"), ("backlash", "°"), ("backlash", "mm"), ""]
        table = text_table(rows, headers, align="rrrl")
        return f"{key_values(pairs, title='backlash from the teeth')}\n{table}"


def gap_report(
    pair: GearPair,
    centre_distance_mm: float | None = None,
    axial_mm: float = 0.0,
    *,
    apparent_deg: float | None = None,
    logged_axial_mm: float = 0.0,
    sections: int = _SECTIONS,
    teeth: Teeth | None = None,
) -> GapReport:
    """Report the backlash of a pair at one position, section by section.

    **Arguments**
    - `pair`: gear pair.
    - `centre_distance_mm`: centre distance a; the drawn one when absent.
    - `axial_mm`: axial shift s, positive towards the driving gear's thick end.
    - `apparent_deg`: j_c of a fit, compared with the drawn backlash at the position of the log.
    - `logged_axial_mm`: axial shift s of the log.
    - `sections`: number of sections over the common face.
    - `teeth`: gears (driving, driven) if they differ from the drawing.

    **Raises** `ValueError` if the faces do not overlap, `PairError` if the axes are too close.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import gap_report
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20, crowning_um=10), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> print(gap_report(pair, axial_mm=0.9, apparent_deg=0.038, sections=3))
    backlash from the teeth
      centre distance           125.12 mm
      axial position            0.9 mm
      backlash                  -0.0048° = -0.0067 mm
      least room at z           A 0.000 mm, B 0.000 mm
      apparent, of the fit      0.0380°
      less that drawn at s = 0  -0.0248° = -0.0346 mm of tooth thickness or +0.330 mm of s
     z [mm]  backlash [°]  backlash [mm]
    -10.000        0.0095         0.0133
     -0.450       -0.0047        -0.0066  interferes
      9.100        0.0071         0.0099

    ```
    """
    gears = teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))
    distance = float(pair.centre_distance_mm if centre_distance_mm is None else centre_distance_mm)
    low, high = (float(end) for end in common_face(gears, jnp.asarray(axial_mm, float)))
    if not low <= high:
        raise ValueError(
            f"Argument `axial_mm` must leave the faces some overlap, but is {axial_mm:g}, at which"
            f" they are {low - high:g} mm apart."
        )
    heights = np.linspace(low, high, sections if high > low else 1)
    # All positions are evaluated in one array, so that the function is compiled for one shape.
    shifts = np.append(axial_mm + np.array([0.0, -1e-3, 1e-3]), logged_axial_mm)
    values, contact = map(np.asarray, backlash_and_contact(pair, distance, shifts, teeth=gears))
    backlash, opened, closed, logged = map(float, values)
    if np.isnan(backlash):
        raise PairError(
            f"{distance:g} mm puts a working pitch circle below a base circle; move the axes"
            " apart.",
            where="centre_distance_mm",
        )
    return GapReport(
        centre_distance_mm=distance,
        axial_mm=axial_mm,
        backlash=backlash,
        reference_radius_mm=float(pair.reference_radii[1]),
        contact_z_mm=contact[0],
        z_mm=heights,
        section_backlash=np.asarray(
            section_backlash(pair, heights, distance, axial_mm, teeth=gears)
        ),
        apparent=None if apparent_deg is None else apparent_deg * DEG,
        logged_axial_mm=logged_axial_mm,
        logged_backlash=logged,
        opening_mm=(opened - closed) / 2e-3 * float(pair.reference_radii[1]),
    )
