"""Report of the contact at driving angles: teeth, section, radii, contact lines and misfit."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Real

from ..base.files.text_tables import key_values
from ..base.units import DEG
from ..kinematics.flank_model import flank_index
from ..pair.gear_pair import Flank
from .backlash import TOUCHING
from .contact import ContactModel, Place, SearchGrid, contact_search, earliest, error_of, mates_on
from .flanks import Mates
from .mounting import Mounting

_SECTIONS = 9  # default number of sections; chosen
_END = 1e-6
"""Share of the common face that is treated as its end (chosen)."""


@dataclass(frozen=True)
class Contacts:
    """Contact of one flank at n driving angles in s sections and for k tooth pairs.

    The sections are equidistant over the common face; the last one is the best between them.

    **Arguments**
    - `model`: contact model.
    - `flank`: "A" or "B".
    - `driving_angle`: φ₁ in rad.
    - `transmission_error`: TE at first contact in rad, NaN without contact.
    - `tooth_pair`: numbers of the teeth (driving, driven) that touch first, counted from 1 in the
      order in which they come into mesh; tooth 1 of the driving gear is between the axes at φ = 0.
    - `place`: part of the flanks that touches, as numbers of `Place`.
    - `end_of_face`: −1 or 1 if only the lower or upper end of the common face touches, else 0.
    - `z_mm`: height of the first contact, NaN without contact.
    - `radius_mm`: distances of the contact from the centres of the driving and driven base circles.
    - `section_z_mm`, `section_radius_mm`: height and driving radius of the first contact in each
      section and for each pair.
    - `section_pair`: number of the driving tooth of each pair, counted from 1.
    - `misfit`: driven angle, rad, between the first contact and each of the contacts by section and
      pair; infinite where flanks cannot touch.
    - `tolerance`: misfit in rad up to which surfaces touch.
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
        """Whether the flanks of each tooth pair touch in each section."""
        return self.misfit <= self.tolerance

    @cached_property
    def section_misfit(self) -> Float[np.ndarray, "n s"]:
        """Smallest misfit of the tooth pairs in each section, rad."""
        return self.misfit.min(axis=1)

    @property
    def largest_misfit(self) -> float:
        """Largest finite misfit of any section, rad."""
        misfit = self.section_misfit
        return float(misfit[np.isfinite(misfit)].max(initial=0.0))

    @cached_property
    def in_contact(self) -> Bool[np.ndarray, " n"]:
        """Whether the flank is in contact at each driving angle."""
        return self.place != Place.NOTHING

    @cached_property
    def length_mm(self) -> Float[np.ndarray, " n"]:
        """Length of contact along z, mm: the longest of all tooth pairs at each driving angle."""
        low = np.where(self.touching, self.section_z_mm, np.inf).min(axis=2)
        high = np.where(self.touching, self.section_z_mm, -np.inf).max(axis=2)
        return np.maximum(high - low, 0.0).max(axis=1)

    @cached_property
    def line(self) -> Bool[np.ndarray, " n"]:
        """Whether the contact is a line, longer than half the distance of neighbouring sections."""
        grid = max(self.misfit.shape[2] - 2, 1)
        face = np.ptp(self.section_z_mm, axis=(1, 2))
        return self.length_mm > face / grid / 2

    @cached_property
    def pairs_in_contact(self) -> Int[np.ndarray, " n"]:
        """Number of tooth pairs that touch at each driving angle."""
        return self.touching.any(axis=2).sum(axis=1)

    def kind(self, place: int) -> str:
        """Describe the contact at a driving angle, given by its index, e.g. "line, flank"."""
        part = Place(int(self.place[place]))
        if part is Place.NOTHING:
            return "nothing"
        shape = "line" if self.line[place] else "point"
        end = self.end_of_face[place]
        side = f", {'upper' if end > 0 else 'lower'} end of the face" if end else ""
        return f"{shape}, {part}{side}"

    def contact_lines(self, place: int) -> dict[int, Float[np.ndarray, "m 2"]]:
        """Return the points (z, driving radius), mm, of contact lines by driving tooth number.

        `place` is the index of the driving angle.
        """
        lines = {}
        for pair, touches in enumerate(self.touching[place]):
            if touches.any():
                points = self.section_z_mm[place, pair], self.section_radius_mm[place, pair]
                lines[int(self.section_pair[place, pair])] = np.stack(points, axis=-1)[touches]
        return lines

    def to_json(self) -> dict[str, Any]:
        """Return the object of one flank in `flanks` of schema `vttig.contact/1`."""
        error = self.transmission_error[self.in_contact] / DEG
        kinds = Counter(map(self.kind, range(len(self.driving_angle))))
        return {
            "transmission_error_min_deg": error.min() if len(error) else None,
            "transmission_error_max_deg": error.max() if len(error) else None,
            "pairs_in_contact": float(self.pairs_in_contact.mean()),
            "largest_misfit_deg": self.largest_misfit / DEG,
            "kinds": dict(kinds.most_common()),
        }

    def __str__(self) -> str:
        count = len(self.driving_angle)
        rows = [("angles", f"{count}")]
        if count:
            low, high, pairs, misfit, kinds = self.to_json().values()
            rows += [
                ("transmission error", None if low is None else f"{low:z.5f}° … {high:z.5f}°"),
                ("pairs in contact", f"{pairs:.3f} on average"),
                ("largest misfit", f"{misfit:.5f}° of a section"),
                *((kind, f"{times} of {count}") for kind, times in kinds.items()),
            ]
        return key_values(rows, title=f"contact, flank {self.flank}")


def contact_at(
    model: ContactModel,
    driving_angle: Real[ArrayLike, " n"],
    flank: Flank,
    *,
    sections: int | None = None,
    tolerance_rad: float = TOUCHING,
) -> Contacts:
    """Report the contact of a model: its transmission error and the contact that causes it.

    **Arguments**
    - `model`: contact model; `contact_model` makes it.
    - `driving_angle`: φ₁ in rad, one-dimensional.
    - `flank`: "A" or "B".
    - `sections`: number of sections over the common face, 9 or more when absent. Without face width
      there is a single section, which does not distinguish lines from points.
    - `tolerance_rad`: misfit in rad of the driven gear up to which surfaces touch.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import contact_at, contact_model
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
        sections = max(model.search_grid.sections, _SECTIONS) if known else 1
    mates = mates_on(model, flank_index(flank))
    grid, teeth = replace(model.search_grid, sections=sections), [g.teeth for g in model.teeth]
    rows = grid.batches(angles if len(angles) else np.zeros(1))
    found = _contacts(mates, model.mounting, grid, rows)
    fields = {name: np.asarray(values)[: len(angles)] for name, values in found.items()}
    fields["tooth_pair"] = np.mod(fields["tooth_pair"], teeth).astype(int) + 1
    fields["section_pair"] = np.mod(fields["section_pair"], teeth[0]).astype(int) + 1
    return Contacts(
        model=model, flank=flank, driving_angle=angles, tolerance=tolerance_rad, **fields
    )


@eqx.filter_jit
def _contacts(
    mates: Mates, mounting: Mounting, grid: SearchGrid, angles: Float[Array, "batches n"]
) -> dict[str, Array]:
    def batch(driving: Float[Array, " n"]) -> dict[str, Any]:
        scene = contact_search(mates, mounting, grid, driving, None)
        touch = scene.touches()
        shares = jnp.asarray(touch.share)
        height = mates.sense * touch.error
        reach = jax.vmap(scene.reach)(touch.roll, shares)
        radii = mates.driving.base_radius * jnp.sqrt(1 + touch.roll**2), reach.radius
        contact, both, z = earliest(height, (touch, radii, reach.z))
        highest = jnp.max(height, axis=(0, 1), keepdims=True)
        tied = jnp.sum(height > highest - 1e-12, axis=(0, 1))
        # At most two ties: a section of the grid, and the best section at the same place.
        single = (grid.sections > 1) & (tied <= 2)
        end = jnp.where(contact.share < _END, -1, jnp.where(contact.share > 1 - _END, 1, 0))
        touches = contact.place != Place.NOTHING
        return {
            "transmission_error": error_of((mates, mounting, driving, None), contact),
            "tooth_pair": jnp.stack([contact.tooth, mates.driven_tooth(contact.tooth)], axis=-1),
            "place": contact.place.astype(int),
            "end_of_face": jnp.where(single, end, 0),
            "z_mm": jnp.where(touches, z, jnp.nan),
            "radius_mm": jnp.where(touches[:, None], jnp.stack(both, axis=-1), jnp.nan),
            "section_z_mm": reach.z.T,
            "section_radius_mm": radii[0].T,
            "section_pair": scene.pose.tooth.T,
            "misfit": jnp.where(jnp.isfinite(height), highest - height, jnp.inf).T,
        }

    return jax.tree.map(jnp.concatenate, jax.lax.map(batch, angles))
