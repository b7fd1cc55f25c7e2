"""Checks of a tooth before it is measured."""

import numpy as np
from jaxtyping import Float

from ...base.errors import PairError
from ..tooth.form_circle import form_radius
from ..tooth.rack_cutter import SIDES
from ..tooth.tooth import Tooth
from ..tooth.validation import check_tooth
from .thickness import base_half_angles, radius_where

_SECTIONS = 33  # sections checked over the face; a chosen number


def check_measurable(tooth: Tooth, section_mm: float = 0.0) -> None:
    """Raise `PairError` for a tooth without thickness, a pointed tooth or a closed tooth space.

    The function checks the section and, if the face width is given, sections over the face. An
    undercut tooth is accepted.

    **Example**
    ```python
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.base import PairError
    >>> from vttig_jax.geometry.measures.validation import check_measurable
    >>> from vttig_jax.geometry import tooth_of
    >>> wide = Gear(45, 3.0, 3.0, 30.0)
    >>> pair = GearPair(wide, wide, module_mm=2.0, pressure_angles_deg=20.0)
    >>> try:
    ...     check_measurable(tooth_of(pair, "driving"))
    ... except PairError as error:
    ...     print(error)
    tip circle: the tooth is pointed at z = 15 mm: its flanks meet at a diameter of 93.783 mm, below
    the tip circle of 94 mm; make the face narrower, the helix angles smaller or the addendum lower.

    ```
    """
    heights = _heights(tooth, section_mm)
    check_tooth(tooth, heights)
    if not all(form_radius(tooth, side) < float(tooth.tip_radius) for side in SIDES):
        raise PairError(
            f"the fillet leaves no flank below the tip circle of {2 * float(tooth.tip_radius):g}"
            " mm; take more teeth, more profile shift or a smaller tip radius of the rack.",
            where="form circle",
        )
    _check_tips(tooth, heights)
    _check_spaces(tooth, heights)


def _heights(tooth: Tooth, section_mm: float) -> Float[np.ndarray, " n"]:
    width = float(tooth.face_width_mm)
    if np.isnan(width):
        return np.array([section_mm])
    return np.append(np.linspace(-width / 2, width / 2, _SECTIONS), section_mm)


def _check_tips(tooth: Tooth, heights: Float[np.ndarray, " n"]) -> None:
    tip = float(tooth.tip_radius)
    angles = tooth.half_angles(np.full_like(heights, tip), heights).sum(axis=-1)
    worst = int(np.argmin(angles))
    if angles[worst] > 0:
        return
    height = heights[worst]
    total = float(base_half_angles(tooth, heights[worst : worst + 1]).sum())
    radius = radius_where(tooth.base_radii, total)
    end = "" if radius is None else f": its flanks meet at a diameter of {2 * radius:.3f} mm"
    raise PairError(
        f"the tooth is pointed at z = {height:g} mm{end}, below the tip circle of {2 * tip:g} mm;"
        f" make {_cure(tooth, heights, worst)} or the addendum lower.",
        where="tip circle",
    )


def _check_spaces(tooth: Tooth, heights: Float[np.ndarray, " n"]) -> None:
    """Raise `PairError` if neighbouring teeth touch at the form circle."""
    radius = max(form_radius(tooth, side) for side in SIDES)
    angles = tooth.half_angles(np.full_like(heights, radius), heights).sum(axis=-1)
    spaces = radius * (2 * np.pi / tooth.teeth - angles)
    worst = int(np.argmin(spaces))
    if spaces[worst] > 0:
        return
    raise PairError(
        f"the teeth leave no space between them at z = {heights[worst]:g} mm"
        f" ({spaces[worst]:.3f} mm at a diameter of {2 * radius:.3f} mm); make the face narrower,"
        " the helix angles smaller or the rack less deep.",
        where="space",
    )


def _cure(tooth: Tooth, heights: Float[np.ndarray, " n"], worst: int) -> str:
    """Return the advice for section `worst`: less taper, or less shift if sections are alike."""
    recession = tooth.recessions(heights).sum(axis=-1)
    if np.ptp(recession) and recession[worst] > 0:
        return "the face narrower, the helix angles smaller"
    return "the profile shift lower"
