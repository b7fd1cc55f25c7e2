"""What touches at each driving angle: teeth, section, radii, tip edges, contact lines, misfit."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Real

from ...base.files.text_tables import key_values
from ...base.units import DEG
from ...kinematics.flank_model import flank_index
from ...pair.gear_pair import Flank
from ..mounting import Mounting
from .contact_model import ContactModel, mates_on
from .first_contact import Effort, Winner, error_of, first_of, scene_of
from .flanks import Mates
from .search import Place, nearest_best
from .search import search as searched

_SECTIONS = 9
_AT_ONCE = 64, 1024
"""Angles that are looked at together, few and many."""

_END = 1e-6
"""Share of the common face that counts as its end."""


@dataclass(frozen=True)
class Contacts:
    """Contact of one flank at n driving angles, looked at in s sections and k pairs of teeth.

    The sections are those asked for, over the common face, and the best one between them.

    **Arguments**
    - `model`: the flank model that was looked at.
    - `flank`: "A" or "B".
    - `driving_angle`: φ₁ in rad.
    - `transmission_error`: TE at first touch in rad, NaN where nothing touches.
    - `tooth_pair`: numbers of the teeth (driving, driven) that touch first, counted from 1 in the
      order in which they come into mesh; tooth 1 of the driving gear is between the axes at φ = 0.
    - `place`: what touches, as numbers of `Place`.
    - `end_of_face`: −1 and 1 where it does so at the lower or upper end of the common face alone.
    - `z_mm`: height of the first touch, NaN where nothing touches.
    - `radius_mm`: its distances from the centres of the driving and the driven base circle.
    - `section_z_mm`, `section_radius_mm`: the same for the first touch in every section and pair;
      radii are those on the driving gear.
    - `section_pair`: number of the driving tooth of each pair, counted from 1.
    - `misfit`: by how much each of these stays behind the first touch, rad of the driven gear;
      infinite where flanks do not meet.
    - `tolerance`: rad up to which they touch.
    """

    model: ContactModel
    flank: Flank
    driving_angle: Float[np.ndarray, " n"]
    transmission_error: Float[np.ndarray, " n"]
    tooth_pair: Int[np.ndarray, "n 2"]
    place: Int[np.ndarray, " n"]
    end_of_face: Int[np.ndarray, " n"]
    z_mm: Float[np.ndarray, " n"]
    radius_mm: Float[np.ndarray, "n 2"]
    section_z_mm: Float[np.ndarray, "n k s"]
    section_radius_mm: Float[np.ndarray, "n k s"]
    section_pair: Int[np.ndarray, "n k"]
    misfit: Float[np.ndarray, "n k s"]
    tolerance: float

    @cached_property
    def touching(self) -> Bool[np.ndarray, "n k s"]:
        """Sections and pairs of teeth that touch."""
        return self.misfit <= self.tolerance

    @cached_property
    def section_misfit(self) -> Float[np.ndarray, "n s"]:
        """Misfit of each section, whichever pair is nearest, rad."""
        return self.misfit.min(axis=1)

    @property
    def largest_misfit(self) -> float:
        """Of any section that meets its mate at all, rad."""
        misfit = self.section_misfit
        return float(misfit[np.isfinite(misfit)].max(initial=0.0))

    @cached_property
    def found(self) -> Bool[np.ndarray, " n"]:
        """Angles at which anything touches."""
        return self.place != Place.NOTHING

    @cached_property
    def length_mm(self) -> Float[np.ndarray, " n"]:
        """Height from the first to the last section in which one pair touches, the longest."""
        low = np.where(self.touching, self.section_z_mm, np.inf).min(axis=2)
        high = np.where(self.touching, self.section_z_mm, -np.inf).max(axis=2)
        return np.maximum(high - low, 0.0).max(axis=1)

    @cached_property
    def line(self) -> Bool[np.ndarray, " n"]:
        """Contact along a line: one pair touches in two sections that are apart."""
        grid = max(self.misfit.shape[2] - 2, 1)
        face = np.ptp(self.section_z_mm, axis=(1, 2))
        return self.length_mm > face / grid / 2

    @cached_property
    def pairs_in_contact(self) -> Int[np.ndarray, " n"]:
        """How many pairs of teeth touch."""
        return self.touching.any(axis=2).sum(axis=1)

    def kind(self, place: int) -> str:
        """Contact at one driving angle in words, such as "line, flank"."""
        what = Place(int(self.place[place]))
        if what is Place.NOTHING:
            return "nothing"
        shape = "line" if self.line[place] else "point"
        end = self.end_of_face[place]
        side = f", {'upper' if end > 0 else 'lower'} end of the face" if end else ""
        return f"{shape}, {what}{side}"

    def contact_lines(self, place: int) -> dict[int, Float[np.ndarray, "m 2"]]:
        """Points (z, driving radius) in mm of each contact line, by number of the driving tooth."""
        found = {}
        for pair, touches in enumerate(self.touching[place]):
            if touches.any():
                points = self.section_z_mm[place, pair], self.section_radius_mm[place, pair]
                found[int(self.section_pair[place, pair])] = np.stack(points, axis=-1)[touches]
        return found

    def __str__(self) -> str:
        count = len(self.driving_angle)
        kinds = Counter(self.kind(place) for place in range(count))
        rows = [("angles", f"{count}")]
        if count:
            error = (self.transmission_error[self.found] / DEG).round(5) + 0.0  # no −0
            span = f"{error.min():.5f}° … {error.max():.5f}°" if len(error) else None
            rows += [
                ("transmission error", span),
                ("pairs in contact", f"{self.pairs_in_contact.mean():.3f} on average"),
                ("largest misfit", f"{self.largest_misfit / DEG:.5f}° of a section"),
            ]
            rows += [(kind, f"{times} of {count}") for kind, times in kinds.most_common()]
        return key_values(rows, title=f"contact, flank {self.flank}")


def contact_at(
    model: ContactModel,
    driving_angle: Real[ArrayLike, " n"],
    flank: Flank,
    *,
    sections: int | None = None,
    tolerance_rad: float = 1e-9,
) -> Contacts:
    """Look at the contact of a model: `transmission_error` with everything that is behind it.

    **Arguments**
    - `model`: from `contact_model`.
    - `driving_angle`: φ₁ in rad, one-dimensional.
    - `flank`: "A" or "B".
    - `sections`: how many of the common face to look at, at least 9 of them when absent; a single
      one where no face width is known, which then cannot tell lines from points.
    - `tolerance_rad`: rad of the driven gear up to which surfaces touch.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import contact_model
    >>> from vttig_jax.geometry import contact_at
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> angles = np.linspace(0.0, 2 * np.pi / 45, 40, endpoint=False)
    >>> print(contact_at(contact_model(pair), angles, "A"))
    contact, flank A
      angles              40
      transmission error  0.00000° … 0.00000°
      pairs in contact    1.950 on average
      largest misfit      0.00000° of a section
      line, flank         40 of 40

    ```
    """
    angles = np.atleast_1d(np.asarray(driving_angle, float))
    if sections is None:
        known = not np.isnan(np.asarray(model.mounting.half_widths)).all()
        sections = max(model.effort.sections, _SECTIONS) if known else 1
    mates = mates_on(model, flank_index(flank))
    teeth = np.array([gear.teeth for gear in model.teeth])
    effort, pieces = replace(model.effort, sections=sections), []
    for angle in _cut(angles):
        looked, winner = _looked_at(mates, model.mounting, effort, jnp.asarray(angle), teeth)
        error = error_of(mates, model.mounting, jnp.asarray(angle), winner)
        pieces.append(looked | {"transmission_error": error})
    found = {
        name: np.concatenate([np.asarray(piece[name]) for piece in pieces])[: len(angles)]
        for name in pieces[0]
    }
    return Contacts(
        model=model, flank=flank, driving_angle=angles, tolerance=tolerance_rad, **found
    )


def _cut(values: Float[np.ndarray, " n"]) -> list[np.ndarray]:
    """Pieces of one of two lengths, the last one filled up with its last value; at least one."""
    if not len(values):
        return [np.zeros(_AT_ONCE[0])]
    count = _AT_ONCE[len(values) > _AT_ONCE[0]]
    return list(np.pad(values, (0, -len(values) % count), mode="edge").reshape(-1, count))


@eqx.filter_jit
def _looked_at(
    mates: Mates,
    mounting: Mounting,
    effort: Effort,
    driving: Float[Array, " n"],
    teeth: Int[np.ndarray | Array, "2"],
) -> tuple[dict[str, Array], Winner]:
    scene = scene_of(mates, mounting, effort, driving, None)
    found = searched(scene, effort.sections)
    winner = first_of(scene, found)
    height = mates.sense * found.error
    reach = scene.reach(found.roll, found.share)
    column = jnp.arange(len(driving))
    tooth = jnp.stack([winner.tooth, mates.driven_tooth(winner.tooth)], axis=-1)
    row, pair = nearest_best(height)
    radii = mates.driving.base_radius * jnp.sqrt(1 + found.roll**2), reach.radius
    tied = jnp.sum(height > jnp.max(height, axis=(0, 1)) - 1e-12, axis=(0, 1))
    # A section of the grid and the best one in its place.
    single = (effort.sections > 1) & (tied <= 2)
    end = jnp.where(winner.share < _END, -1, jnp.where(winner.share > 1 - _END, 1, 0))
    here = winner.place != Place.NOTHING
    both = jnp.stack([radius[row, pair, column] for radius in radii], axis=-1)
    behind = jnp.where(jnp.isfinite(height), jnp.max(height, axis=(0, 1)) - height, jnp.inf)
    looked = {
        "tooth_pair": jnp.mod(tooth, teeth).astype(int) + 1,
        "place": winner.place.astype(int),
        "end_of_face": jnp.where(single, end, 0),
        "z_mm": jnp.where(here, reach.z[row, pair, column], jnp.nan),
        "radius_mm": jnp.where(here[:, None], both, jnp.nan),
        "section_z_mm": reach.z.transpose(2, 1, 0),
        "section_radius_mm": radii[0].transpose(2, 1, 0),
        "section_pair": jnp.mod(scene.pose.tooth, teeth[0]).astype(int).T + 1,
        "misfit": behind.transpose(2, 1, 0),
    }
    return looked, winner
