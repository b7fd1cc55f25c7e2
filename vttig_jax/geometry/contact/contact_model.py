"""Flank model of the unloaded contact of two tooth surfaces."""

import math
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Number, Numbers, float64, known
from ...base.units import DEG
from ...kinematics.flank_model import FIRST_ORDERS, GridOrders, ImplicitModel, flank_index
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import Flank, GearPair
from ..mounting import Misalignment, Mounting
from ..tooth.tooth import Tooth, tooth_of
from .deviations import Deviations
from .first_contact import SearchGrid, error_of, first_contacts
from .flanks import Mates
from .tooth_pairs import concentric_touch, mates_of
from .validation import check_contact, flank_starts, least_tooth_pairs, same_everywhere

Backlash = Literal["drawing", "given"]
Scalar = Float[Number, ""]

# Default search grid, chosen: sections, tooth pairs, roll angles on a flank.
_SECTIONS, _TOOTH_PAIRS, _POINTS = 9, 3, 9


class ContactModel(ImplicitModel):
    """Flank model of the first contact of two tooth surfaces; see `contact_model`.

    **Arguments**
    - `teeth`: driving and driven gear.
    - `starts`: roll angles at the start of each flank, rad; rows are gears, columns flanks A and B.
    - `nominal_distance`: centre distance at which concentric gears define the zero of φ₂, mm.
    - `mounting`: position of the axes and the base circles.
    - `opening`: additional angle of flank B, rad of the driven gear, relative to the drawing.
    - `deviations`: deviations of all flanks, or None.
    - `search_grid`: grid of the search for first contact.
    """

    ratio: Float[Numbers, ""]
    teeth: tuple[Tooth, Tooth]
    starts: Float[Numbers, "gear=2 flank=2"]
    nominal_distance: Scalar
    mounting: Mounting
    opening: Scalar
    deviations: Deviations | None
    search_grid: SearchGrid

    @property
    def grid_orders(self) -> GridOrders:
        """Order z₁ of the driving shaft if the contact varies over a tooth mesh.

        Otherwise they are the first orders of both shafts.
        """
        plain = self.mounting.misalignment is None and self.deviations is None
        uniform = plain and same_everywhere(self.teeth, self.mounting.centre_distance)
        return FIRST_ORDERS if uniform else ((self.teeth[0].teeth, 0),)

    def transmission_error(
        self, driving_angle: Real[ArrayLike, "*shape"], flank: Flank
    ) -> Float[Array, "*shape"]:
        """Return TE = φ₂ − i φ₁ at first contact on `flank`, rad; NaN without contact."""
        angle = jnp.asarray(driving_angle, float)
        mates = mates_on(self, flank_index(flank))
        if not angle.size:
            return angle
        (row,) = self.search_grid.padded(angle.ravel())
        contact = first_contacts(mates, self.mounting, self.search_grid, row, None)
        error = error_of((mates, self.mounting, row, None), contact)
        return error[: angle.size].reshape(angle.shape)

    def at_both_angles(
        self,
        driving_angle: Float[Array, "*shape"],
        driven_angle: Float[Array, "*shape"],
        flank: Flank,
    ) -> Float[Array, "*shape"]:
        """Return TE at first contact, rad, with the driven base circle centre at the given φ₂."""
        first, second = jnp.broadcast_arrays(driving_angle, driven_angle)
        mates, shape = mates_on(self, flank_index(flank)), first.shape
        if not first.size:
            return first
        driving, driven = self.search_grid.padded(first.ravel(), second.ravel())
        contact = first_contacts(mates, self.mounting, self.search_grid, driving, driven)
        error = error_of((mates, self.mounting, driving, driven), contact)
        return error[: first.size].reshape(shape)


@eqx.filter_jit
def mates_on(model: ContactModel, side: int) -> Mates:
    """Return flank A (0) or B (1) of both gears; φ₂ = 0 is first contact on flank A as drawn.

    The function is separate so that the code compiled for flank A is used for flank B too.
    """
    drawn = mates_of(model.teeth, model.starts, jnp.asarray(model.ratio), None, 0)
    # Flank B of a driving tooth touches the next tooth of the driven gear.
    on_b = model.opening + 2 * math.pi / model.teeth[1].teeth
    standing = side * on_b - concentric_touch(drawn, model.nominal_distance)
    mates = mates_of(model.teeth, model.starts, jnp.asarray(model.ratio), model.deviations, side)
    return eqx.tree_at(lambda tree: tree.standing, mates, standing)


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
    """Return the flank model of two gears from the first contact of their surfaces.

    For every driving angle φ₂ is that of first contact over all points of the flanks from the end
    of the fillet to the tip, all sections of the common face and the neighbouring tooth pairs. This
    includes contact lines, points, tip edges and ends of the face. The contact is unloaded and the
    surfaces are rigid. At φ₁ = φ₂ = 0 concentric gears as drawn touch on flank A, at the nominal
    centre distance, s = 0, in the section z = 0.

    Derivatives with respect to every number of the arguments follow from the contact point alone
    (envelope theorem); those of second and higher order contain its motion on the flanks and along
    the face, by the implicit function theorem. Where several points touch at once, they are the
    derivatives of the point closest to the middle of the face and of the path of contact: for lines
    on unmodified flanks all points give the same result, at a kink it is a one-sided derivative. A
    section whose neighbours touch as early is then kept.

    **Arguments**
    - `pair`: gear pair.
    - `eccentricities`: offsets of the base circles, axial displacement, constant backlash.
    - `misalignment`: tilt of the driven axis; None for parallel axes.
    - `deviations`: deviations of the flanks from the drawing, as maps and for each tooth.
    - `sections`: number of sections over the common face; the best section between them is searched
      too. The default is 9, or the number of columns of the finest map; it is the section z = 0
      alone if the recessions are linear and equal and the contact ratio is well above 1, because
      all sections then touch at once.
    - `constant_backlash`: "drawing" for the backlash of the drawn teeth; "given" rotates flank B so
      that concentric gears have the constant backlash of `eccentricities`, as after a fit.
    - `centre_distance_mm`: centre distance, by default the nominal one.
    - `teeth`: gears (driving, driven) that replace the drawn ones, e.g. with measured recessions.
    - `tooth_pairs`: number of tooth pairs searched; by default 3, or more if the contact ratio
      requires it.
    - `points`: number of roll angles on the grid of each flank; by default 9, or 2 for each row of
      the finest map.

    **Returns** `ContactModel`, a flank model. Its transmission error is NaN if the faces do not
    overlap, or if at a large centre distance no tooth is close enough to the line of centres.

    **Raises** `PairError` for gears that do not touch or have pointed or missing teeth, and
    `ValueError` for invalid options. Traced numbers are not checked; an undercut flank then begins
    on its base circle.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> from vttig_jax.geometry import Misalignment, contact_model
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
    driving, driven = map(
        _as_pytree, teeth or (tooth_of(pair, "driving"), tooth_of(pair, "driven"))
    )
    gears = driving, driven
    distance = (
        pair.centre_distance_mm if centre_distance_mm is None else float64(centre_distance_mm)
    )
    if sections is None:
        uniform = misalignment is None and deviations is None and same_everywhere(gears, distance)
        sections = 1 if uniform else max(_SECTIONS, _knots(deviations, "z_mm"))
    if points is None:
        points = max(_POINTS, 2 * _knots(deviations, "roll_mm"))
    if tooth_pairs is None:
        needed = least_tooth_pairs(gears, distance) if known(gears, distance) else 0
        tooth_pairs = max(_TOOTH_PAIRS, needed)
    search_grid = SearchGrid(sections, tooth_pairs, points)
    driving_offset, driven_offset = eccentricities.cartesian
    mounting = Mounting(
        centre_distance=distance,
        axial=eccentricities.axial_mm,
        driving_offset=driving_offset,
        driven_offset=driven_offset,
        half_widths=jnp.stack([jnp.asarray(gear.face_width_mm) / 2 for gear in gears]),
        misalignment=misalignment,
    )
    if known(pair, gears, distance):
        check_contact(gears, mounting, search_grid, deviations)
    given = eccentricities.constant_backlash_deg * DEG - pair.drawing_backlash
    return ContactModel(
        ratio=jnp.asarray(float(pair.ratio), float),
        teeth=gears,
        starts=flank_starts(gears),
        nominal_distance=pair.centre_distance_mm,
        mounting=mounting,
        opening=given if constant_backlash == "given" else np.zeros(()),
        deviations=deviations,
        search_grid=search_grid,
    )


def _as_pytree(tooth: Tooth) -> Tooth:
    """Return the gear with recessions that are plain functions wrapped as pytrees for JAX."""
    recession = tuple(
        flank if isinstance(flank, eqx.Module) else jax.tree_util.Partial(flank)
        for flank in tooth.recession
    )
    return eqx.tree_at(lambda gear: gear.recession, tooth, recession)


def _knots(deviations: Deviations | None, direction: str) -> int:
    """Return the number of points of the finest map along `direction`, a field of `FlankMap`."""
    maps = () if deviations is None else deviations.maps
    return max((len(getattr(flank_map, direction)) for flank_map in maps), default=0)
