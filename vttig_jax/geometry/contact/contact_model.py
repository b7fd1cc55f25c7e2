"""Unloaded contact of two tooth surfaces as a flank model: first touch, wherever it is."""

import math
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Number, Numbers, float64
from ...base.units import DEG
from ...kinematics.flank_model import ImplicitModel, flank_index
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import Flank, GearPair
from ..mounting import Misalignment, Mounting
from ..tooth.tooth import Tooth, tooth_of
from .deviations import Deviations
from .first_contact import Effort, error_at, error_of, winners
from .flanks import Mates
from .tooth_pairs import concentric_touch, mates_of
from .validation import check_contact, flank_starts, known, least_tooth_pairs, same_everywhere

Backlash = Literal["drawing", "given"]
Scalar = Float[Number, ""]

_SECTIONS = 9
_TOOTH_PAIRS = 3
_POINTS = 9


class ContactModel(ImplicitModel):
    """First touch of the surfaces of two gears, flank by flank; see `contact_model`.

    **Arguments**
    - `teeth`: the driving and the driven gear.
    - `starts`: roll angles at which each flank begins, rows gears, columns flank A and B.
    - `nominal_distance`: centre distance at which concentric gears define the zero of φ₂, mm.
    - `mounting`: where the axes and the base circles are.
    - `opening`: rad of the driven gear by which flank B stands on from where it is drawn.
    - `deviations`: of all flanks, or None.
    - `effort`: what is searched.
    """

    ratio: Float[Array, ""]
    teeth: tuple[Tooth, Tooth]
    starts: Float[Numbers, "gear=2 flank=2"]
    nominal_distance: Scalar
    mounting: Mounting
    opening: Scalar
    deviations: Deviations | None
    effort: Effort

    @property
    def highest_order(self) -> float:
        """Of the first orders, or of tooth mesh where contact is not the same all along it."""
        plain = self.mounting.misalignment is None and self.deviations is None
        even = plain and same_everywhere(self.teeth, self.mounting.centre_distance)
        return max(1.0, float(self.ratio)) if even else float(self.teeth[0].teeth)

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """TE = φ₂ − i φ₁ at first touch on `flank`, rad; NaN where nothing touches."""
        angle = jnp.asarray(driving_angle, float)
        mates = mates_on(self, flank_index(flank))
        if not angle.size:
            return angle
        (row,) = self.effort.filled_up(angle.ravel())
        winner = winners(mates, self.mounting, self.effort, row, None)
        found = error_of(mates, self.mounting, row, winner)
        return found[: angle.size].reshape(angle.shape)

    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """TE at first touch with the centre of the driven base circle where φ₂ has it, rad."""
        first, second = jnp.broadcast_arrays(driving_angle, driven_angle)
        mates, shape = mates_on(self, flank_index(flank)), first.shape
        if not first.size:
            return first
        one, other = self.effort.filled_up(first.ravel(), second.ravel())
        winner = winners(mates, self.mounting, self.effort, one, other)
        found = error_at(mates, self.mounting, one, other, winner)
        return found[: first.size].reshape(shape)


@eqx.filter_jit
def mates_on(model: ContactModel, side: int) -> Mates:
    """Flank A (0) or B (1) of both gears, standing where φ₂ = 0 is first touch on flank A.

    By itself, so that what is compiled for flank A serves flank B as well.
    """
    drawn = mates_of(model.teeth, model.starts, model.ratio, None, 0)
    # Flank B of a tooth meets the next tooth of the mate.
    on_b = model.opening + 2 * math.pi / model.teeth[1].teeth
    standing = side * on_b - concentric_touch(drawn, model.nominal_distance)
    found = mates_of(model.teeth, model.starts, model.ratio, model.deviations, side)
    return eqx.tree_at(lambda mates: mates.standing, found, standing)


def contact_model(
    pair: GearPair,
    eccentricities: Eccentricities = Eccentricities(),
    *,
    misalignment: Misalignment | None = None,
    deviations: Deviations | None = None,
    sections: int | None = None,
    constant_backlash: Backlash = "drawing",
    centre_distance_mm: Scalar | float | None = None,
    teeth: tuple[Tooth, Tooth] | None = None,
    tooth_pairs: int | None = None,
    points: int | None = None,
) -> ContactModel:
    """Flank model of two gears from their surfaces alone, wherever and however they touch.

    For every driving angle φ₂ is that of first touch, over all points of the flanks from the end of
    the fillet to the tip, over all sections of the common face and over neighbouring pairs of
    teeth: lines of contact, points, tip edges and ends of the face alike. Unloaded: the surfaces do
    not give. φ₁ = φ₂ = 0 is where concentric gears as drawn touch on flank A, at the nominal centre
    distance, s = 0, in the section z = 0.

    Derivatives with respect to every number of the arguments follow from the point of first touch
    alone (envelope theorem). Where several points touch at once they are those of one of them, the
    one nearest to the middle of the face and of the path of contact: for lines on unmodified flanks
    every choice is right, at a kink it is one of its sides. They are of first order only.

    **Arguments**
    - `pair`: the gears.
    - `eccentricities`: offsets of the base circles, axial displacement, constant backlash.
    - `misalignment`: of the driven axis; None for parallel axes.
    - `deviations`: what the flanks deviate from their drawing, as maps and tooth by tooth.
    - `sections`: over the common face; the best one between them is found as well. By default 9, or
      as many as the finest map has columns, but the section z = 0 alone where flanks recede alike
      and linearly and the contact ratio is well above 1, so that all sections touch at once.
    - `constant_backlash`: "drawing" for the backlash of the teeth as they are drawn; "given" turns
      flank B so that concentric gears have the one of `eccentricities`, as after a fit.
    - `centre_distance_mm`: where the axes are, if not at the nominal centre distance.
    - `teeth`: (driving, driven) gears in the place of the drawn ones, as with measured recessions.
    - `tooth_pairs`: how many pairs are looked at; by default 3, or more where the contact ratio
      asks for it.
    - `points`: roll angles on the grid of each flank from which first touch is searched; by default
      9, or 2 for each row of the finest map.

    **Returns** `ContactModel`, which keeps the protocol of flank models. Its transmission error is
    NaN where the faces do not overlap, and, with axes so far apart that the tips only just reach
    each other, where no tooth is near enough to the line of centres.

    **Raises** `PairError` for gears that do not meet or have no whole teeth, `ValueError` for
    options that are none. Nothing is checked while numbers are traced, and an undercut flank then
    begins on its base circle.

    For `control.bounds.bounds_of` give `highest=(2 z₁, 2)` where the contact has harmonics of tooth
    mesh, as with misalignment.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> from vttig_jax.geometry import contact_model
    >>> from vttig_jax.geometry import Misalignment
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3)
    >>> np.degrees(contact_model(pair, rig).transmission_error(np.array([0.0, 0.05]), "A")).round(5)
    array([0.03402, 0.03459])
    >>> tilted = contact_model(pair, rig, misalignment=Misalignment(deviation_rad=1e-4))
    >>> np.degrees(tilted.transmission_error(np.array([0.0, 0.05]), "A")).round(5)
    array([0.03474, 0.03532])

    ```
    """
    if constant_backlash not in ("drawing", "given"):
        raise ValueError(
            'Argument `constant_backlash` must be "drawing" or "given", but is'
            f" {constant_backlash!r}."
        )
    if not known(pair):
        pair = jax.tree.map(jnp.asarray, pair)  # so that no formula mixes NumPy and traced numbers
    made = tuple(map(_with_leaves, teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))))
    gears = made[0], made[1]
    distance = (
        pair.centre_distance_mm if centre_distance_mm is None else float64(centre_distance_mm)
    )
    if sections is None:
        plain = misalignment is None and deviations is None and same_everywhere(gears, distance)
        sections = 1 if plain else max(_SECTIONS, _knots(deviations, "z_mm"))
    if points is None:
        points = max(_POINTS, 2 * _knots(deviations, "roll_mm"))
    if tooth_pairs is None:
        needed = least_tooth_pairs(gears, distance) if known(gears, distance) else 0
        tooth_pairs = max(_TOOTH_PAIRS, needed)
    effort = Effort(sections, tooth_pairs, points)
    driving, driven = eccentricities.cartesian
    mounting = Mounting(
        centre_distance=distance,
        axial=eccentricities.axial_mm,
        driving_offset=driving,
        driven_offset=driven,
        half_widths=jnp.stack([jnp.asarray(gear.face_width_mm) / 2 for gear in gears]),
        misalignment=misalignment,
    )
    if known(pair, gears, distance):
        check_contact(gears, mounting, effort, deviations)
    given = eccentricities.constant_backlash_deg * DEG - pair.drawing_backlash
    return ContactModel(
        ratio=jnp.asarray(float(pair.ratio), float),
        teeth=gears,
        starts=flank_starts(gears),
        nominal_distance=pair.centre_distance_mm,
        mounting=mounting,
        opening=given if constant_backlash == "given" else np.zeros(()),
        deviations=deviations,
        effort=effort,
    )


def _with_leaves(tooth: Tooth) -> Tooth:
    """Recessions that are plain functions as pytrees without numbers."""
    recession = tuple(
        one if isinstance(one, eqx.Module) else jax.tree_util.Partial(one)
        for one in tooth.recession
    )
    return eqx.tree_at(lambda gear: gear.recession, tooth, recession)


def _knots(deviations: Deviations | None, direction: str) -> int:
    """How many points along one direction the finest map has."""
    maps = () if deviations is None else deviations.maps
    return max((len(getattr(one, direction)) for one in maps), default=0)
