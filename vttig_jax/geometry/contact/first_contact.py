"""First contact at each driving angle and its transmission error."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..mounting import Mounting, Values
from .flanks import Mates, Pose
from .search import ContactSearch, Place, TouchPoint, nearest_best, search, share_of_middle
from .tooth_pairs import chosen_pairs, concentric_touch, path_of

_AT_ONCE = 2**17
"""Number of flank points evaluated in one batch (chosen), which fit in a processor's cache."""

_FEWEST = 64
"""Smallest batch of driving angles; larger batches are multiples of it (chosen)."""


class SearchGrid(eqx.Module):
    """Grid of the search for first contact.

    **Arguments**
    - `sections`: number of sections over the common face; 1 for the section z = 0 alone.
    - `tooth_pairs`: number of tooth pairs around the line of centres.
    - `points`: number of roll angles on a flank.
    """

    sections: int = eqx.field(static=True)
    tooth_pairs: int = eqx.field(static=True)
    points: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        for name, least in (("sections", 1), ("tooth_pairs", 1), ("points", 3)):
            if getattr(self, name) < least:
                raise ValueError(
                    f"Argument `{name}` must be {least} or more, but is {getattr(self, name)}."
                )

    @property
    def batch_size(self) -> int:
        """Number of driving angles in one batch."""
        angles = _AT_ONCE // (self.points * self.tooth_pairs)
        return max(angles // _FEWEST, 1) * _FEWEST

    def padded(self, *rows: Float[Array, " n"]) -> tuple[Float[Array, " m"], ...]:
        """Pad rows of equal length with their last value to one of a few lengths.

        The length is a power of two or whole batches, so that few lengths are compiled.
        """
        count = rows[0].shape[0]
        length = min(max(_FEWEST, 1 << (count - 1).bit_length()), self.batch_size)
        batches = -(-count // self.batch_size)
        if batches > 1:
            length = batches * -(-count // batches // _FEWEST) * _FEWEST
        # Known values are padded by NumPy, which does not compile for a new length.
        modules = (jnp if isinstance(row, Tracer) else np for row in rows)
        padded = (
            xp.pad(row, (0, length - count), mode="edge")
            for xp, row in zip(modules, rows, strict=True)
        )
        return tuple(jnp.asarray(row) for row in padded)


class FirstContact(eqx.Module):
    """First contact at each driving angle; its arrays carry no derivatives.

    **Arguments**
    - `error`: TE at first contact, rad.
    - `roll`: roll angle of the driving flank, rad.
    - `share`: place of the section in the common face, 0 … 1.
    - `place`: part of the flanks that touches, as a number of `Place`.
    - `tooth`: number of the driving tooth, 0 for the one between the axes at φ = 0.
    """

    error: Float[Array, " n"]
    roll: Float[Array, " n"]
    share: Float[Array, " n"]
    place: Float[Array, " n"]
    tooth: Float[Array, " n"]


def contact_search(
    mates: Mates,
    mounting: Mounting,
    search_grid: SearchGrid,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"] | None,
) -> ContactSearch:
    """Return the search problem at driving angles, rad.

    `driven_angle`, rad, fixes the centre of the driven base circle. If it is None, the centre is
    placed at the φ₂ of the contact.
    """
    path = path_of(mates, mounting.centre_distance)
    tooth_angle, number = chosen_pairs(path, mates, driving_angle, search_grid.tooth_pairs)
    guess = None
    if driven_angle is None:
        guess = concentric_touch(mates, mounting.centre_distance)
        driven_angle = mates.ratio * driving_angle + guess
    pose = Pose(
        tooth_angle,
        number,
        mounting.driving_centre(driving_angle[None]),
        mounting.driven_centre(driven_angle[None]),
    )
    return ContactSearch(mates, mounting, pose, guess, search_grid.points)


def earliest_contact(scene: ContactSearch, touch: TouchPoint) -> FirstContact:
    """Return the first contact at each angle among the contacts `touch` of sections and pairs."""
    section, pair = nearest_best(scene.mates.sense * touch.error)
    column = jnp.arange(touch.error.shape[-1])

    def selected(values: Array) -> Array:
        return values[section, pair, column].astype(float)

    tooth = scene.pose.tooth[pair, column]
    error, roll, share = map(selected, (touch.error, touch.roll, touch.share))
    return FirstContact(error, roll, share, selected(touch.place), tooth)


def first_contacts(
    mates: Mates,
    mounting: Mounting,
    search_grid: SearchGrid,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"] | None,
) -> FirstContact:
    """Return the first contacts at driving angles padded by `SearchGrid.padded`.

    The search is compiled alone and is not differentiated, so a derivative does not recompile it.
    """
    fixed = jax.tree.map(jax.lax.stop_gradient, (mates, mounting, driving_angle, driven_angle))
    contacts = _first_contacts(fixed[0], fixed[1], search_grid, fixed[2], fixed[3])
    if search_grid.sections > 1:
        return contacts
    # The single section stays at z = 0 also when derivatives move the ends of the face.
    share = jnp.broadcast_to(share_of_middle(mounting), contacts.share.shape)
    return eqx.tree_at(lambda contact: contact.share, contacts, share)


@eqx.filter_jit
def _first_contacts(
    mates: Mates,
    mounting: Mounting,
    search_grid: SearchGrid,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"] | None,
) -> FirstContact:
    """Return the first contacts; the driving angles are searched batch by batch."""

    def search_batch(angles: tuple[Array, Array | None]) -> FirstContact:
        scene = contact_search(mates, mounting, search_grid, *angles)
        return earliest_contact(scene, search(scene, search_grid.sections))

    batches = -(-len(driving_angle) // search_grid.batch_size)
    if batches == 1:
        return search_batch((driving_angle, driven_angle))

    def split(values: Array) -> Array:
        return values.reshape(batches, -1)

    contacts = jax.lax.map(search_batch, jax.tree.map(split, (driving_angle, driven_angle)))
    return jax.tree.map(jnp.ravel, contacts)


@eqx.filter_jit
def error_of(
    mates: Mates, mounting: Mounting, driving_angle: Float[Array, " n"], contact: FirstContact
) -> Float[Array, " n"]:
    """Return TE at a known contact, rad, with the driven centre at the resulting φ₂.

    By the envelope theorem its derivative is that of first contact: the point on the flank, the
    section and the tooth pair are constant; a tip edge and an end of the face move with the gear.
    The search gives φ₂ to second order in the motion of the driven centre, so one step of Newton's
    method completes it; the derivative of that step is that of the solution.
    """
    guess = jnp.where(contact.place == Place.NOTHING, 0.0, contact.error)
    driven_angle = mates.ratio * driving_angle + guess
    error, by_driven = _error_and_slope(mates, mounting, driving_angle, driven_angle, contact)
    return guess + (error - guess) / (1 - by_driven)


@eqx.filter_jit
def error_at(
    mates: Mates,
    mounting: Mounting,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"],
    contact: FirstContact,
) -> Float[Array, " n"]:
    """Return TE at a known contact, rad; `driven_angle` places the driven base circle centre."""
    return _error_and_slope(mates, mounting, driving_angle, driven_angle, contact)[0]


def _error_and_slope(
    mates: Mates,
    mounting: Mounting,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"],
    contact: FirstContact,
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Return TE, rad, and ∂TE/∂φ₂ for the φ₂ that places the driven base circle centre.

    The slope carries no derivatives.
    """
    pose = Pose(
        driving_angle - contact.tooth * mates.pitch,
        contact.tooth,
        mounting.driving_centre(driving_angle),
        mounting.driven_centre(driven_angle),
    )
    driving, driven = mates.driving, mates.driven
    on_tip = contact.place == Place.DRIVEN_TIP
    on_end = on_tip | (contact.place == Place.DRIVEN_START)
    end = jnp.where(on_tip, driven.tip, driven.start)

    def error_and_radius(roll: Values) -> tuple[Values, Values]:
        reach = mates.reach(mounting, pose, roll, contact.share)
        return reach.error, reach.radius

    ones = jnp.ones_like(contact.roll)
    (_, radius), slopes = jax.jvp(error_and_radius, (contact.roll,), (ones,))
    error_slope, radius_slope = jax.lax.stop_gradient(slopes)
    radius_slope = jnp.where(radius_slope == 0, 1.0, radius_slope)
    # A step of Newton's method to an end of the driven flank; its derivative is that of the end.
    excess = radius - driven.base_radius * jnp.sqrt(1 + end**2)
    roll = jnp.where(on_end, contact.roll - excess / radius_slope, contact.roll)
    roll = jnp.where(contact.place == Place.DRIVING_TIP, driving.tip, roll)
    roll = jnp.where(contact.place == Place.DRIVING_START, driving.start, roll)
    reach = mates.reach(mounting, pose, roll, contact.share)
    of_end = error_slope * reach.radius_by_driven / radius_slope
    slope = reach.error_by_driven - jnp.where(on_end, of_end, 0.0)
    error = jnp.where(contact.place == Place.NOTHING, jnp.nan, reach.error)
    return error, jax.lax.stop_gradient(slope)
