"""Backlash from the teeth themselves: what the space between them leaves, section by section."""

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

_GRID = 33
_ZOOMS = 3
_FINER = 8
"""Sections on a grid over the common face, and how often and by how much it is then refined."""

_POLISHES = 2
"""Steps of Newton's method after that."""


@compiled
def section_backlash(
    pair: GearPair,
    z_mm: Real[ArrayLike, "*shape"],
    centre_distance_mm: Real[ArrayLike, ""] | None = None,
    axial_mm: Real[ArrayLike, ""] = 0.0,
    *,
    teeth: Teeth | None = None,
) -> Float[Array, "*shape"]:
    """Backlash that single sections of gears running true would have alone, rad of the driven gear.

        j(z) = [2π r_w1/z₁ − Σ over flanks of (r_w1 ψ₁(r_w1, z) + r_w2 ψ₂(r_w2, −z − s))]/r_w2

    with the half angles ψ of `Tooth` on the working pitch circles r_w1 + r_w2 = a. Negative where
    the teeth are thicker than the space. Flank A and flank B of crowned or unequal gears can touch
    in different sections: what the pair has is `geometric_backlash`.

    **Arguments**
    - `pair`: the gears.
    - `z_mm`: heights from the middle of the driving face, mm, any shape.
    - `centre_distance_mm`: a; that of the drawing when absent.
    - `axial_mm`: s, the shift of the driven gear towards the driving gear's thick end.
    - `teeth`: gears that differ from their drawing (driving, driven), as `tooth_of` gives them.

    **Returns** rad, shape of `z_mm`; NaN outside the common face.

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
    found = _left(gears, distance, _material(gears, distance, axial, z).sum(axis=-1))
    known = ~jnp.isnan(gears[0].face_width_mm) | ~jnp.isnan(gears[1].face_width_mm)
    slack = 1e-12 * distance
    return jnp.where(known & ((z < low - slack) | (z > high + slack)), jnp.nan, found)


def geometric_backlash(
    pair: GearPair,
    centre_distance_mm: Real[ArrayLike, "..."] | None = None,
    axial_mm: Real[ArrayLike, "..."] = 0.0,
    *,
    teeth: Teeth | None = None,
) -> Float[Array, "..."]:
    """Backlash of the tooth thicknesses at any centre distance and shift, rad of the driven gear.

        j = [2π r_w1/z₁ − Σ over flanks of max over z of (r_w1 ψ₁(z) + r_w2 ψ₂(−z − s))]/r_w2

    over the common face of gears that run true. With linear recessions it is j(0) − s (tan β_L +
    tan β_R)/R₂ of (16) at every s; with crowned ones each flank touches where the material of both
    gears is thickest. Negative: the teeth interfere at that position by so much.

    **Arguments**
    - `pair`: the gears.
    - `centre_distance_mm`: a, any shape; that of the drawing when absent.
    - `axial_mm`: s, any shape, broadcast against it; positive closes the gap.
    - `teeth`: gears that differ from their drawing (driving, driven).

    **Returns** rad; times R₂ it is the backlash at the reference circle. NaN where the faces do not
    overlap.

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
    return least_room(pair, centre_distance_mm, axial_mm, teeth=teeth)[0]


@compiled
def least_room(
    pair: GearPair,
    centre_distance_mm: Real[ArrayLike, "..."] | None = None,
    axial_mm: Real[ArrayLike, "..."] = 0.0,
    *,
    teeth: Teeth | None = None,
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape 2"]]:
    """`geometric_backlash`, and the heights at which flank A and flank B would touch, mm."""
    gears = teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))
    distance, axial = jnp.broadcast_arrays(
        jnp.asarray(
            pair.centre_distance_mm if centre_distance_mm is None else centre_distance_mm, float
        ),
        jnp.asarray(axial_mm, float),
    )
    low, high = common_face(gears, axial)
    z = _thickest(gears, axial)
    both = _material(gears, distance[..., None], axial[..., None], z)
    material = jnp.trace(both, axis1=-2, axis2=-1)
    return jnp.where(low <= high, _left(gears, distance, material), jnp.nan), z


def _thickest(gears: Teeth, axial: Values) -> Values:
    """Heights at which flank A and flank B have most material; shares of the face stay.

    There both gears together recede least, whatever the centre distance: r_w1/R₁ = r_w2/R₂.
    """
    fixed, shift = jax.tree.map(jax.lax.stop_gradient, (gears, axial))
    low, high = (end[..., None] for end in common_face(fixed, shift))
    width = high - low

    def receding(share: Values) -> Values:
        rows = low[..., None] + share * width[..., None]
        return _receding(fixed, shift[..., None, None], rows)

    def zoomed(_, at: tuple[Values, Values]) -> tuple[Values, Values]:
        best, cell = at
        shares = jnp.clip(best[..., None] + cell * steps, 0.0, 1.0)
        return _best(receding(shares), shares), cell / _FINER

    steps = jnp.linspace(-1.0, 1.0, 2 * _FINER + 1)
    shares = jnp.broadcast_to(jnp.linspace(0.0, 1.0, _GRID), (*shift.shape, 2, _GRID))
    grid = _best(receding(shares), shares), jnp.asarray(1 / (_GRID - 1))
    best, cell = jax.lax.fori_loop(0, _ZOOMS, zoomed, grid)
    for _ in range(_POLISHES):
        best = jnp.clip(best + _to_level(receding, best, cell), 0.0, 1.0)
    low, high = (end[..., None] for end in common_face(gears, axial))
    return low + best * (high - low)


def _receding(gears: Teeth, axial: Values, z: Values) -> Values:
    """δ of both gears together on flank A and B, which are the last axis but one of z, mm."""
    driving, driven = gears
    total = driving.recessions(z) + driven.recessions(-(z + axial))[..., ::-1]
    return jnp.stack([total[..., 0, :, 0], total[..., 1, :, 1]], axis=-2)


def _to_level(receding: Callable[[Values], Values], share: Values, cell: Values) -> Values:
    """Newton's step to where `receding` is level; none where it does not bend."""
    ones = jnp.ones_like(share)[..., None]

    def slope(at: Values) -> Values:
        return jax.jvp(receding, (at,), (ones,))[1]

    rise, bend = jax.jvp(slope, (share[..., None],), (ones,))
    hollow = bend > 0
    step = jnp.where(hollow, -rise / jnp.where(hollow, bend, 1.0), 0.0)
    return jnp.clip(step[..., 0], -cell, cell)


def _best(receding: Values, shares: Values) -> Values:
    """Share of the section that recedes least, of those that tie the one in the row's middle."""
    count = shares.shape[-1]
    aside = np.abs(np.arange(count) - (count - 1) / 2)
    tied = receding <= receding.min(axis=-1, keepdims=True) + 1e-13
    place = jnp.argmin(jnp.where(tied, aside, jnp.inf), axis=-1)
    return jnp.take_along_axis(shares, place[..., None], axis=-1)[..., 0]


def _material(gears: Teeth, distance: Values, axial: Values, z: Values) -> Values:
    """Arc of both gears together on flank A and B, on their working pitch circles, mm."""
    driving, driven = gears
    teeth = driving.teeth + driven.teeth
    first, second = (jnp.broadcast_to(distance * gear.teeth / teeth, z.shape) for gear in gears)
    left = driving.half_angles(first, z) * first[..., None]
    right = driven.half_angles(second, -(z + axial)) * second[..., None]
    return jnp.asarray(left + right[..., ::-1])


def _left(gears: Teeth, distance: Values, material: Values) -> Values:
    """Backlash in rad of the driven gear that so much material leaves."""
    share = 1 / (gears[0].teeth + gears[1].teeth)
    return (2 * math.pi * distance * share - material) / (distance * gears[1].teeth * share)
