"""Backlash computed from the tooth thicknesses of both gears, by section and for the pair."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import compiled
from ...pair.gear_pair import GearPair
from ..mounting import Values, common_face
from ..tooth.tooth import Tooth, tooth_of

Teeth = tuple[Tooth, Tooth]
"""The driving and the driven gear."""

# Chosen settings of the search for the section with the least clearance.
_GRID = 33  # sections of the first grid over the common face
_ZOOMS = 3  # refinements of the grid
_FINER = 8  # factor of each refinement
_POLISHES = 2  # final steps of Newton's method


@compiled
def section_backlash(
    pair: GearPair,
    z_mm: Real[ArrayLike, "*shape"],
    centre_distance_mm: Real[ArrayLike, ""] | None = None,
    axial_mm: Real[ArrayLike, ""] = 0.0,
    *,
    teeth: Teeth | None = None,
) -> Float[Array, "*shape"]:
    """Return the backlash of each section alone, without eccentricity, rad of the driven gear.

        j(z) = [2π r_w1/z₁ − Σ over flanks of (r_w1 ψ₁(r_w1, z) + r_w2 ψ₂(r_w2, −z − s))]/r_w2

    ψ are the half angles of `Tooth` on the working pitch circles, r_w1 + r_w2 = a. The backlash is
    negative if the teeth are thicker than the space. Crowned or unequal gears can touch on flank A
    and flank B in different sections; `geometric_backlash` gives the backlash of the pair.

    **Arguments**
    - `pair`: gear pair.
    - `z_mm`: heights from the middle of the driving face, any shape.
    - `centre_distance_mm`: centre distance a; the drawn one when absent.
    - `axial_mm`: axial shift s of the driven gear towards the driving gear's thick end.
    - `teeth`: gears (driving, driven), as `tooth_of` returns them, if they differ from the drawing.

    **Returns** backlash in rad, shape of `z_mm`; NaN outside the common face.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import section_backlash
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20, crowning_um=10), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> np.degrees(section_backlash(pair, np.array([-10.0, 0.0, 10.0, 11.0]))).round(5)
    array([0.07711, 0.06279, 0.07711,     nan])

    ```
    """
    gears = teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))
    distance = jnp.asarray(
        pair.centre_distance_mm if centre_distance_mm is None else centre_distance_mm, float
    )
    z, axial = jnp.asarray(z_mm, float), jnp.asarray(axial_mm, float)
    low, high = common_face(gears, axial)
    backlash = _clearance(gears, distance, _thickness(gears, distance, axial, z).sum(axis=-1))
    known = ~jnp.isnan(gears[0].face_width_mm) | ~jnp.isnan(gears[1].face_width_mm)
    tolerance = 1e-12 * distance
    return jnp.where(known & ((z < low - tolerance) | (z > high + tolerance)), jnp.nan, backlash)


def geometric_backlash(
    pair: GearPair,
    centre_distance_mm: Real[ArrayLike, "..."] | None = None,
    axial_mm: Real[ArrayLike, "..."] = 0.0,
    *,
    teeth: Teeth | None = None,
) -> Float[Array, "..."]:
    """Return the backlash of the pair from its tooth thicknesses, rad of the driven gear.

        j = [2π r_w1/z₁ − Σ over flanks of max over z of (r_w1 ψ₁(z) + r_w2 ψ₂(−z − s))]/r_w2

    z is in the common face; the gears have no eccentricity. For linear recessions the backlash is
    j(0) − s (tan β_L + tan β_R)/R₂ of (16) at every s. For crowned gears each flank touches where
    both gears together are thickest. A negative backlash is an interference of the teeth.

    **Arguments**
    - `pair`: gear pair.
    - `centre_distance_mm`: centre distance a, any shape; the drawn one when absent.
    - `axial_mm`: axial shift s, broadcast against the centre distance; s > 0 closes the backlash.
    - `teeth`: gears (driving, driven) if they differ from the drawing.

    **Returns** backlash in rad; multiplied by R₂ it is the backlash at the reference circle. NaN
    where the faces do not overlap.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import geometric_backlash
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> np.degrees(geometric_backlash(pair, axial_mm=np.array([0.0, 0.5, 1.0]))).round(5)
    array([ 0.06279,  0.02525, -0.01228])
    >>> np.degrees(geometric_backlash(pair, np.array([125.0, 125.3]))).round(5) + 0.0
    array([0.     , 0.15781])

    ```
    """
    return backlash_and_contact(pair, centre_distance_mm, axial_mm, teeth=teeth)[0]


@compiled
def backlash_and_contact(
    pair: GearPair,
    centre_distance_mm: Real[ArrayLike, "..."] | None = None,
    axial_mm: Real[ArrayLike, "..."] = 0.0,
    *,
    teeth: Teeth | None = None,
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape 2"]]:
    """Return `geometric_backlash`, rad, and the contact heights of flank A and flank B, mm."""
    gears = teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))
    distance, axial = jnp.broadcast_arrays(
        jnp.asarray(
            pair.centre_distance_mm if centre_distance_mm is None else centre_distance_mm, float
        ),
        jnp.asarray(axial_mm, float),
    )
    low, high = common_face(gears, axial)
    z = _contact_heights(gears, axial)
    by_section = _thickness(gears, distance[..., None], axial[..., None], z)
    thickness = jnp.trace(by_section, axis1=-2, axis2=-1)
    return jnp.where(low <= high, _clearance(gears, distance, thickness), jnp.nan), z


def _contact_heights(gears: Teeth, axial: Values) -> Values:
    """Return the heights z, mm, of least clearance; the last axis is (flank A, flank B).

    The sum of the recessions of both gears is smallest there at any centre distance, because
    r_w1/R₁ = r_w2/R₂. For derivatives the height is a fixed share of the common face.
    """
    fixed, shift = jax.tree.map(jax.lax.stop_gradient, (gears, axial))
    low, high = (end[..., None] for end in common_face(fixed, shift))
    width = high - low

    def recession(share: Values) -> Values:
        heights = low[..., None] + share * width[..., None]
        return _recession_sum(fixed, shift[..., None, None], heights)

    def refined(_, state: tuple[Values, Values]) -> tuple[Values, Values]:
        best, cell = state
        shares = jnp.clip(best[..., None] + cell * steps, 0.0, 1.0)
        return _best(recession(shares), shares), cell / _FINER

    steps = jnp.expand_dims(jnp.linspace(-1.0, 1.0, 2 * _FINER + 1), range(shift.ndim + 1))
    shares = jnp.broadcast_to(jnp.linspace(0.0, 1.0, _GRID), (*shift.shape, 2, _GRID))
    grid = _best(recession(shares), shares), jnp.asarray(1 / (_GRID - 1))
    best, cell = jax.lax.fori_loop(0, _ZOOMS, refined, grid)
    for _ in range(_POLISHES):
        best = jnp.clip(best + _newton_step(recession, best, cell), 0.0, 1.0)
    low, high = (end[..., None] for end in common_face(gears, axial))
    return low + best * (high - low)


def _recession_sum(gears: Teeth, axial: Values, z: Values) -> Values:
    """Return the sum of the recessions of both gears, mm; axis −2 of `z` is (flank A, flank B)."""
    driving, driven = gears
    total = driving.recessions(z) + driven.recessions(-(z + axial))[..., ::-1]
    return jnp.stack([total[..., 0, :, 0], total[..., 1, :, 1]], axis=-2)


def _newton_step(recession: Callable[[Values], Values], share: Values, cell: Values) -> Values:
    """Return Newton's step to the minimum of `recession`, limited to ± `cell`.

    `share` is the present place in the common face, 0 … 1. The step is 0 if the curvature is not
    positive.
    """
    ones = jnp.ones_like(share)[..., None]

    def first(values: Values) -> Values:
        return jax.jvp(recession, (values,), (ones,))[1]

    slope, curvature = jax.jvp(first, (share[..., None],), (ones,))
    convex = curvature > 0
    step = jnp.where(convex, -slope / jnp.where(convex, curvature, 1.0), 0.0)
    return jnp.clip(step[..., 0], -cell, cell)


def _best(recession: Values, shares: Values) -> Values:
    """Return the share with the smallest recession along the last axis.

    Of equal recessions the one closest to the middle of the row is taken.
    """
    count = shares.shape[-1]
    off_middle = np.abs(np.arange(count) - (count - 1) / 2)
    tied = recession <= recession.min(axis=-1, keepdims=True) + 1e-13
    index = jnp.argmin(jnp.where(tied, off_middle, jnp.inf), axis=-1)
    return jnp.take_along_axis(shares, index[..., None], axis=-1)[..., 0]


def _thickness(gears: Teeth, distance: Values, axial: Values, z: Values) -> Values:
    """Return the half thicknesses r_w1 ψ₁ + r_w2 ψ₂ of both teeth on the working pitch circles, mm.

    The last axis of the result is (flank A, flank B). The sum over this axis is the thickness of a
    driving tooth plus that of a driven tooth. `distance` and `axial` are a and s, mm.
    """
    driving, driven = gears
    teeth = driving.teeth + driven.teeth
    first, second = (jnp.broadcast_to(distance * gear.teeth / teeth, z.shape) for gear in gears)
    left = driving.half_angles(first, z) * first[..., None]
    right = driven.half_angles(second, -(z + axial)) * second[..., None]
    return jnp.asarray(left + right[..., ::-1])


def _clearance(gears: Teeth, distance: Values, thickness: Values) -> Values:
    """Return the backlash (2π r_w1/z₁ − `thickness`)/r_w2, rad of the driven gear.

    `distance` is the centre distance a = r_w1 + r_w2, mm. `thickness` is the sum of the thickness
    of a driving tooth and of a driven tooth, each on its working pitch circle, mm.
    """
    share = 1 / (gears[0].teeth + gears[1].teeth)
    return (2 * math.pi * distance * share - thickness) / (distance * gears[1].teeth * share)
