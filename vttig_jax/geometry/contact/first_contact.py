"""First contact at each driving angle and its transmission error."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ...base.numerics.implicit import at_extreme, known_root
from ..mounting import Mounting, Values
from .flanks import Mates, Pose, Reach
from .search import TIE, ContactSearch, Place, TouchPoint, nearest_best, search, share_of_middle
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
    - `share`: place of the section in the common face, 0 … 1; None for the section z = 0.
    - `place`: part of the flanks that touches, as a number of `Place`.
    - `tooth`: number of the driving tooth, 0 for the one between the axes at φ = 0.
    """

    error: Float[Array, " n"]
    roll: Float[Array, " n"]
    share: Float[Array, " n"] | None
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
    return replace(contacts, share=None)


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


Gears = tuple[Mates, Mounting, Float[Array, " n"], Float[Array, " n"] | None]
"""Flanks, mounting, driving angles, and driven angles that place the driven base circle centre.

Without driven angles the centre is at the φ₂ of the contact. Angles are in rad.
"""

Slopes = tuple[Float[Array, " n"], Float[Array, " n"]]


@eqx.filter_jit
def error_of(gears: Gears, contact: FirstContact) -> Float[Array, " n"]:
    """Return TE at a known contact, rad.

    By the envelope theorem its derivative is that of first contact: the point on the flank, the
    section and the tooth pair are constant; a tip edge and an end of the face move with the gear.
    Higher derivatives also need the motion of the point on the flank and of the section.
    """
    slopes = _slopes(contact, jax.lax.stop_gradient(gears))
    return at_extreme(_error, _moved, (contact, slopes), gears)


def _error(place: tuple[FirstContact, Slopes], gears: Gears) -> Float[Array, " n"]:
    """Return TE, rad; at an end of the driven flank the Lagrange function of this constraint.

    The search gives φ₂ to second order in the motion of the driven centre, so one step of Newton's
    method completes it; the derivative of that step is that of the solution.
    """
    contact, (multiplier, by_driven) = place
    driving = gears[0].driving
    roll = jnp.where(contact.place == Place.DRIVING_TIP, driving.tip, contact.roll)
    roll = jnp.where(contact.place == Place.DRIVING_START, driving.start, roll)
    reach = _reach(replace(contact, roll=roll), gears)
    nothing = contact.place == Place.NOTHING
    error = reach.error - multiplier * (reach.radius - _end_radius(gears[0], contact))
    error = jnp.where(nothing, jnp.nan, error)
    if gears[3] is not None:
        return error
    guess = jnp.where(nothing, 0.0, contact.error)
    return guess + (error - guess) / (1 - by_driven)


def _slopes(contact: FirstContact, gears: Gears) -> Slopes:
    """Return ∂TE/∂r of the constraint r = driven radius, and ∂TE/∂φ₂ of the driven centre.

    The first is a Lagrange multiplier, rad/mm, at an end of the driven flank, and elsewhere zero.
    """
    reach, error_slope, radius_slope = _along("roll", contact, gears)
    bound = _on_driven_end(contact) & (radius_slope != 0)
    multiplier = jnp.where(bound, error_slope / jnp.where(bound, radius_slope, 1.0), 0.0)
    return multiplier, reach.error_by_driven - multiplier * reach.radius_by_driven


def _moved(place: tuple[FirstContact, Slopes], gears: Gears) -> tuple[FirstContact, Slopes]:
    """Return the same contact and slopes with their derivatives, from what defines them."""
    contact, _ = place
    if gears[3] is None:
        contact = replace(contact, error=error_of(gears, contact))
    if contact.share is not None:
        share = known_root(_face_condition, contact.share, (contact, gears))
        contact = replace(contact, share=share)
    contact = _on_flank(contact, gears)
    return contact, _slopes(contact, gears)


def _on_flank(contact: FirstContact, gears: Gears) -> FirstContact:
    """Return the contact with the roll angle that follows the gears and the section."""
    return replace(contact, roll=known_root(_flank_condition, contact.roll, (contact, gears)))


def _flank_condition(roll: Values, args: tuple[FirstContact, Gears]) -> Values:
    """Return what is zero at the roll angle of first contact in a section.

    It is the slope of TE within the flanks, the excess radius at an end of the driven flank, and
    the distance from an end of the driving flank.
    """
    contact, gears = args
    driving = gears[0].driving
    reach, slope, _ = _along("roll", replace(contact, roll=roll), gears)
    excess = reach.radius - _end_radius(gears[0], contact)
    zero = jnp.where(_on_driven_end(contact), excess, slope)
    zero = jnp.where(contact.place == Place.DRIVING_TIP, roll - driving.tip, zero)
    return jnp.where(contact.place == Place.DRIVING_START, roll - driving.start, zero)


def _face_condition(share: Values, args: tuple[FirstContact, Gears]) -> Values:
    """Return what is zero at the section of first contact: the slope of TE along the face.

    The section stays at an end of the face, and where the neighbouring sections touch as early.
    """

    def rise(share: Values, contact: FirstContact, gears: Gears) -> Values:
        contact = _on_flank(replace(contact, share=share), gears)
        _, error_slope, radius_slope = _along("share", contact, gears)
        return error_slope - _slopes(contact, gears)[0] * radius_slope

    start, (contact, gears) = jax.lax.stop_gradient((share, args))
    ones = jnp.ones_like(start)
    _, bend = jax.jvp(lambda share: rise(share, contact, gears), (start,), (ones,))
    moves = (start > 0) & (start < 1) & (gears[0].sense * bend < -TIE)
    return jnp.where(moves, rise(share, *args), share - start)


def _along(name: str, contact: FirstContact, gears: Gears) -> tuple[Reach, Values, Values]:
    """Return the reach at a contact, and the derivatives of TE and driven radius by a field of it.

    `name` is "roll" or "share".
    """

    def values(value: Values) -> tuple[tuple[Values, Values], Reach]:
        reach = _reach(replace(contact, **{name: value}), gears)
        return (reach.error, reach.radius), reach

    value = getattr(contact, name)
    _, slopes, reach = jax.jvp(values, (value,), (jnp.ones_like(value),), has_aux=True)
    return reach, *slopes


def _reach(contact: FirstContact, gears: Gears) -> Reach:
    """Return where the driven flank touches the driving flank at a contact."""
    mates, mounting, driving_angle, driven_angle = gears
    if driven_angle is None:
        error = jnp.where(contact.place == Place.NOTHING, 0.0, contact.error)
        driven_angle = mates.ratio * driving_angle + error
    pose = Pose(
        driving_angle - contact.tooth * mates.pitch,
        contact.tooth,
        mounting.driving_centre(driving_angle),
        mounting.driven_centre(driven_angle),
    )
    share = share_of_middle(mounting) if contact.share is None else contact.share
    return mates.reach(mounting, pose, contact.roll, share)


def _on_driven_end(contact: FirstContact) -> Bool[Array, " n"]:
    return (contact.place == Place.DRIVEN_TIP) | (contact.place == Place.DRIVEN_START)


def _end_radius(mates: Mates, contact: FirstContact) -> Values:
    """Return the radius at the tip of the driven flank, or at its start if contact is there, mm."""
    driven = mates.driven
    end = jnp.where(contact.place == Place.DRIVEN_START, driven.start, driven.tip)
    return driven.base_radius * jnp.sqrt(1 + end**2)
