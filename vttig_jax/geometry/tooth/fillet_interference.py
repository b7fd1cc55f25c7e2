"""Interference of the mate's tip with the fillet: form circle and start of active profile."""

from dataclasses import dataclass
from typing import get_args

import numpy as np
from jaxtyping import Float

from ...base.files.text_tables import text_table
from ...pair.gear_pair import GearPair
from .form_circle import form_radius, start_of_flank, undercut_depth
from .rack_cutter import SIDES
from .tooth import Shaft, tooth_of


@dataclass(frozen=True)
class FilletInterference:
    """Radii of both gears in mm; rows are (driving, driven), columns (flank A, flank B).

    **Arguments**
    - `form_radius_mm`: radius at which the involute begins; NaN if undercut removes it completely.
    - `active_radius_mm`: smallest radius that the tip of the mate reaches on the line of action;
      NaN where that point lies beyond the interference point, where no involute exists.
    - `overlap_mm`: length on the line of action by which the mate's tip reaches beyond the form
      circle; positive where it meets the fillet, infinite where there is no involute.
    """

    form_radius_mm: Float[np.ndarray, "gear=2 flank=2"]
    active_radius_mm: Float[np.ndarray, "gear=2 flank=2"]
    overlap_mm: Float[np.ndarray, "gear=2 flank=2"]

    @property
    def interferes(self) -> np.ndarray:
        """Whether the tip of the mate meets the fillet, shape (gear, flank)."""
        return self.overlap_mm > 0

    def __str__(self) -> str:
        rows = []
        for gear, shaft in enumerate(get_args(Shaft)):
            for flank in range(2):
                meets = self.interferes[gear, flank]
                rows.append(
                    (
                        f"{shaft} {'AB'[flank]}",
                        _three_digits(self.form_radius_mm[gear, flank]),
                        _three_digits(self.active_radius_mm[gear, flank]),
                        _three_digits(-self.overlap_mm[gear, flank]),
                        "the mate's tip meets the fillet" if meets else "free",
                    )
                )
        headers = ["flank", ("form radius", "mm"), ("active from", "mm"), ("clear by", "mm"), ""]
        return text_table(rows, headers, align="lrrrl")


def fillet_interference(pair: GearPair) -> FilletInterference:
    """Compare the start of each involute with the start of its active profile.

        active: √(r² − r_b²) = a sin α_w − √(r_a² − r_b²) of the mate

    The gears have no eccentricity, the nominal centre distance and tip circles as drawn. All
    sections give the same result, because the recession rotates a flank together with its fillet.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import fillet_interference
    >>> gears = Gear(12, face_width_mm=20), Gear(80, face_width_mm=20)
    >>> print(fillet_interference(GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)))
    flank      form radius [mm]  active from [mm]  clear by [mm]
    driving A            11.303                 –         -2.058  the mate's tip meets the fillet
    driving B            11.303                 –         -2.058  the mate's tip meets the fillet
    driven A             78.193            78.665          1.655  free
    driven B             78.193            78.665          1.655  free

    ```
    """
    form, active, overlap = np.empty((3, 2, 2))
    shafts = get_args(Shaft)
    base, tips = np.asarray(pair.base_radii), np.asarray(pair.tip_radii)
    line = float(pair.centre_distance_mm) * np.sin(np.asarray(pair.working_pressure_angles))
    for gear, shaft in enumerate(shafts):
        tooth = tooth_of(pair, shaft)
        order = SIDES if shaft == "driving" else SIDES[::-1]
        for flank, side in enumerate(order):
            active_length = line[flank] - np.sqrt(tips[1 - gear] ** 2 - base[1 - gear, flank] ** 2)
            base_radius = base[gear, flank]
            form[gear, flank] = form_radius(tooth, side)
            radius = np.hypot(base_radius, active_length)
            active[gear, flank] = radius if active_length >= 0 else np.nan
            form_length = start_of_flank(tooth, side)
            if undercut_depth(tooth, side) > 0:
                form_length = np.sqrt(np.maximum(form[gear, flank] ** 2 - base_radius**2, 0.0))
            overlap[gear, flank] = np.nan_to_num(form_length - active_length, nan=np.inf)
    return FilletInterference(form, active, overlap)


def _three_digits(value: float) -> str | None:
    return f"{value:.3f}" if np.isfinite(value) else None
