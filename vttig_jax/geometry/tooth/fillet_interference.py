"""Does the tip of the mate dig into the fillet? Form circle against start of active profile."""

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
    """Radii of both gears, rows (driving, driven), columns (flank A, flank B), mm.

    **Arguments**
    - `form_radius_mm`: where the involute begins; NaN where undercut leaves none.
    - `active_radius_mm`: lowest radius that the tip of the mate reaches on the line of action; NaN
      where that lies beyond the base circle, where no involute can be.
    - `overlap_mm`: by how much the mate's tip goes beyond the form circle along the line of action;
      positive where it meets the fillet. Infinite where there is no involute.
    """

    form_radius_mm: Float[np.ndarray, "gear=2 flank=2"]
    active_radius_mm: Float[np.ndarray, "gear=2 flank=2"]
    overlap_mm: Float[np.ndarray, "gear=2 flank=2"]

    @property
    def interferes(self) -> np.ndarray:
        """True where the tip of the mate meets the fillet, shape (gear, flank)."""
        return self.overlap_mm > 0

    def __str__(self) -> str:
        rows = []
        for gear, shaft in enumerate(get_args(Shaft)):
            for flank in range(2):
                meets = self.interferes[gear, flank]
                rows.append(
                    (
                        f"{shaft} {'AB'[flank]}",
                        _three(self.form_radius_mm[gear, flank]),
                        _three(self.active_radius_mm[gear, flank]),
                        _three(-self.overlap_mm[gear, flank]),
                        "the mate's tip meets the fillet" if meets else "free",
                    )
                )
        headers = ["flank", ("form radius", "mm"), ("active from", "mm"), ("clear by", "mm"), ""]
        return text_table(rows, headers, align="lrrrl")


def fillet_interference(pair: GearPair) -> FilletInterference:
    """Compare where each involute begins with where the tip of the mate begins to use it.

        active: √(r² − r_b²) = a sin α_w − √(r_a² − r_b²) of the mate

    At the nominal centre distance, gears running true, tip circles as drawn. The same in every
    section, because the recession turns a flank together with its fillet.

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
            reach = np.sqrt(tips[1 - gear] ** 2 - base[1 - gear, flank] ** 2)
            used = line[flank] - reach
            own = base[gear, flank]
            form[gear, flank] = form_radius(tooth, side)
            active[gear, flank] = np.hypot(own, used) if used >= 0 else np.nan
            begins = start_of_flank(tooth, side)
            if undercut_depth(tooth, side) > 0:
                begins = np.sqrt(np.maximum(form[gear, flank] ** 2 - own**2, 0.0))
            overlap[gear, flank] = np.nan_to_num(begins - used, nan=np.inf)
    return FilletInterference(form, active, overlap)


def _three(value: float) -> str | None:
    return f"{value:.3f}" if np.isfinite(value) else None
