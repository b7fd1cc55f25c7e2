"""Outline of a tooth section: root, fillets, flanks and tip as one line of points."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Number, Numbers, compiled
from .rack_cutter import Side, arc_roll, paper_angle, rack_side, side_index, to_gear
from .roll_limits import flank_span, root_arcs, tip_arcs
from .surface import PARTS, Part, tooth_surface
from .tooth import Tooth


class ToothSection(eqx.Module):
    """Sections of a tooth from the middle of one root land to the middle of the next one.

    **Arguments**
    - `points`: x, y, z in mm, counter-clockwise seen from +z with the material on the left; the
      outline, rotated by one pitch 2π/teeth, continues where the outline itself ends.
    - `pieces`: (side, part) of each piece in order; neighbouring pieces share their common point.
    - `intervals`: number of intervals of each piece.
    """

    points: Float[Array, "*shape n 3"]
    pieces: tuple[tuple[Side, Part], ...] = eqx.field(static=True)
    intervals: int = eqx.field(static=True)

    def piece(self, side: Side, part: Part) -> Float[Array, "*shape k 3"]:
        """Return the points of one piece, mm, including both ends."""
        start = self.pieces.index((side, part)) * self.intervals
        return self.points[..., start : start + self.intervals + 1, :]

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels "side part" of the intervals between neighbouring points."""
        return tuple(f"{side} {part}" for side, part in self.pieces for _ in range(self.intervals))


_ORDER: tuple[tuple[Side, Part], ...] = (
    *(("right", part) for part in PARTS),
    *(("left", part) for part in reversed(PARTS)),
)


def tooth_section(
    tooth: Tooth, z: Real[ArrayLike, "*shape"], *, intervals: int = 16
) -> ToothSection:
    """Return sections of a whole tooth: root, fillet, flank and tip on the right, then on the left.

    The points of flanks and lands are equidistant in roll angle, the points of fillets in normal
    angle. The outline is not clipped: it crosses itself if the tooth is undercut or pointed or if
    fillets overlap; `section_report` reports these sections.

    **Arguments**
    - `tooth`: gear.
    - `z`: heights of the sections, mm, any shape.
    - `intervals`: number of intervals of each of the eight pieces.

    **Returns** `ToothSection` with 8 `intervals` + 1 points for each section.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import tooth_of, tooth_section
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> section = tooth_section(tooth_of(pair, "driving"), np.array([0.0, 10.0]))
    >>> section.points.shape, section.labels[:2]
    ((2, 129, 3), ('right root', 'right root'))
    >>> section.piece("right", "flank")[0, -1].round(4)
    Array([ 0.7688, 46.9937,  0.    ], dtype=float64)

    ```
    """
    if intervals < 1:
        raise ValueError(f"Argument `intervals` must be 1 or more, but is {intervals}.")
    share = np.linspace(0.0, 1.0, intervals + 1)
    return ToothSection(_line(tooth, z, share), _ORDER, intervals)


@compiled
def _line(tooth: Tooth, z: Real[ArrayLike, "*shape"], share: Numbers) -> Array:
    height = jnp.asarray(z, float)
    arcs = {"root": root_arcs(tooth, height), "tip": tip_arcs(tooth, height)}
    radii = {"root": tooth.root_radius, "tip": tooth.tip_radius}
    share = jnp.expand_dims(share, range(height.ndim))
    pieces = []
    for side, part in _ORDER:
        if part in arcs:
            points = _land(radii[part], arcs[part][..., side_index(side), :], height, share)
        else:
            points = _profile(tooth, height[..., None], share, side, part)
        pieces.append(points if side == "right" else points[..., ::-1, :])
    inner = [piece[..., :-1, :] for piece in pieces[:-1]]
    return jnp.concatenate([*inner, pieces[-1]], axis=-2)


def _profile(tooth: Tooth, z: Array, share: Numbers, side: Side, part: Part) -> Array:
    """Return points of a flank or fillet, mm, from root to tip in every section.

    The parameter of a fillet is its normal angle, which always distinguishes its points; the roll
    angle is constant on a fillet whose arc centre lies on the pitch line.
    """
    if part == "flank":
        start, end = flank_span(tooth, side)
        return tooth_surface(tooth, start + share * (end - start), z, side=side)
    rack = rack_side(tooth, side)
    normal_angle = jnp.pi / 2 + share * (rack.pressure_angle - jnp.pi / 2)
    phi = paper_angle(rack, arc_roll(rack, normal_angle), z)
    return jnp.asarray(to_gear(rack, rack.arc(normal_angle, z), phi))


def _land(radius: Number, arc: Numbers, z: Array, share: Numbers) -> Array:
    """Return points, mm, on a circle between two clockwise angles."""
    angle = arc[..., :1] + share * (arc[..., 1:] - arc[..., :1])
    across, up = radius * jnp.sin(angle), radius * jnp.cos(angle)
    return jnp.stack([across, up, z[..., None] + 0.0 * angle], axis=-1)
