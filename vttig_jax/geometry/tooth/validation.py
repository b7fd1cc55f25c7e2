"""Checks of a tooth before its surface is computed."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Real

from ...base.errors import PairError
from .rack_cutter import SIDES, Side
from .recession import Tabulated
from .tooth import Tooth

_SECTIONS = 41  # sections checked by default; a chosen number

Heights = Real[ArrayLike, "..."] | Sequence[float] | None
"""Heights of sections in mm, or None for sections over the face width."""


def check_tooth(tooth: Tooth, z: Heights = None) -> None:
    """Raise `PairError` if a gear has no tooth surface; `section_report` reports other defects.

    The function checks the numbers of the drawing, the recession of each flank (finite values,
    increasing heights of a table, differentiable by JAX) and the thickness at the reference circle,
    which must be positive in every section.

    **Arguments**
    - `tooth`: gear.
    - `z`: heights of the checked sections, mm; over the face width when absent.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.base import PairError
    >>> from vttig_jax.geometry import check_tooth, tooth_of
    >>> wide = Gear(45, 3, 3, 80)
    >>> pair = GearPair(wide, wide, module_mm=2.0, pressure_angles_deg=20.0)
    >>> try:
    ...     check_tooth(tooth_of(pair, "driving"))
    ... except PairError as error:
    ...     print(error)
    thickness: the tooth is -1.051 mm thick on the reference circle at z = 40 mm; make the face
    narrower (the tooth vanishes at z = 30 mm), the helix angles smaller or the profile shift
    larger.

    ```
    """
    _check_numbers(tooth)
    heights = section_heights(tooth, z)
    check_recessions(tooth, heights)
    _check_thickness(tooth, heights)


def check_recessions(tooth: Tooth, heights: Float[np.ndarray, " n"]) -> None:
    """Raise `PairError` if δ of a flank is not finite, a bad table or not differentiable by JAX."""
    for index, side in enumerate(SIDES):
        _check_recession(tooth, index, side, heights)


def section_heights(tooth: Tooth, z: Heights) -> Float[np.ndarray, " n"]:
    """Return the given heights, or equidistant heights over the face width, mm."""
    if z is not None:
        heights = np.atleast_1d(np.asarray(z, float)).ravel()
        if not len(heights) or not np.all(np.isfinite(heights)):
            raise ValueError(f"Argument `z` must be finite heights in mm, but is {z!r}.")
        return heights
    width = float(tooth.face_width_mm)
    if not width > 0:
        raise ValueError(
            "Argument `z` must be given for a gear without a face width, but is None; or give the"
            " gear its face_width_mm."
        )
    return np.linspace(-width / 2, width / 2, _SECTIONS)


def _check_numbers(tooth: Tooth) -> None:
    limits = {
        "module_mm": (tooth.module_mm, 0.0, np.inf),
        "pressure_angles_deg": (tooth.pressure_angles_deg, 0.0, 90.0),
        "addendum_mm": (tooth.addendum_mm, 0.0, np.inf),
        "dedendum_mm": (tooth.dedendum_mm, 0.0, np.inf),
        "root radius": (tooth.root_radius, 0.0, np.inf),
    }
    for name, (value, low, high) in limits.items():
        for number in np.ravel(value):
            if not low < number < high:
                limit = "above 0" if high == np.inf else f"between {low:g} and {high:g}"
                raise PairError(f"{number:g} is not possible; give a value {limit}.", where=name)
    if not 0 <= tooth.fillet_radius_mm < np.inf:
        raise PairError(
            f"{float(tooth.fillet_radius_mm):g} mm is not possible as radius of the cutter's tip;"
            " give 0 (sharp) or more.",
            where="fillet_radius_mm",
        )
    base = np.max(np.asarray(tooth.base_radii))
    if not tooth.tip_radius > base:
        raise PairError(
            f"the tip circle ({float(tooth.tip_radius):.3f} mm) lies inside the base circle"
            f" ({base:.3f} mm), so there is no flank; give more teeth, addendum or profile shift.",
            where="tip radius",
        )


def _check_recession(tooth: Tooth, index: int, side: Side, heights: np.ndarray) -> None:
    recession, where = tooth.recession[index], f"recession of the {side} flank"
    if isinstance(recession, Tabulated):
        recession.check(where)
    values = np.asarray(recession(heights), float)
    if values.shape != heights.shape:
        raise PairError(
            f"the function returns shape {values.shape} for heights of shape {heights.shape};"
            " return one value for each height.",
            where=where,
        )
    if not np.all(np.isfinite(values)):
        first = int(np.argmin(np.isfinite(values)))
        raise PairError(
            f"δ is not finite at z = {heights[first]:g} mm ({values[first]:g}); give a function"
            " that is smooth over the whole face (a crowned gear needs its face width).",
            where=where,
        )
    try:
        shape = jax.ShapeDtypeStruct(heights.shape, heights.dtype)
        jax.eval_shape(lambda z: jnp.asarray(recession(z)), shape)
    except jax.errors.JAXTypeError as error:
        raise PairError(
            "the function cannot be differentiated by JAX; write it with `jax.numpy` instead of"
            " `numpy` and without `if` on z.",
            where=where,
        ) from error


def _check_thickness(tooth: Tooth, heights: np.ndarray) -> None:
    radius = np.full(heights.shape, float(tooth.reference_radius))
    thickness = np.asarray(tooth.thickness(radius, heights))
    vanished = thickness <= 0
    if not vanished.any():
        return
    nearest = heights[vanished][np.argmin(np.abs(heights[vanished]))]
    worst = int(np.argmin(thickness))
    raise PairError(
        f"the tooth is {thickness[worst]:.3f} mm thick on the reference circle at z ="
        f" {heights[worst]:g} mm; make the face narrower (the tooth vanishes at z ="
        f" {nearest:g} mm), the helix angles smaller or the profile shift larger.",
        where="thickness",
    )
