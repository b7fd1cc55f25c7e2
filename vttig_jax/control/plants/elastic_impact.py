"""One impact on a spring with a damper, from flight to flight, without small steps.

A body is p deep in a flank (negative: away from it) and feels, per inertia,

    F/J = max(0, ω² p + clip(2 ζ ω ṗ, ±ω² p)),  ω = √(c/J)

(Modelica's ElastoBacklash: the damper gives at most what the spring does; the flank never pulls).
A step that samples this force must be far shorter than the contact, some π/ω. But the law is
linear in pieces, and an impact goes through them in one order:

    flight → stiff (2 c p) → both (c p + d ṗ) → loose (0) → flight

So each piece is a power series of the time, its end a root of another. Time is counted in 1/ω here.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

Scalar = Float[Array, ""]
Truth = Bool[Array, ""]
Series = Sequence[Scalar]
"""Coefficients, lowest power first."""

_ORDER = 12
_LONGEST = 1.3
"""Time that a series covers: what it leaves out is below 1.3¹³/13! = 5e-9 of the depth."""
_LONGEST_OVERDAMPED = 2.0
"""The same counted in the decay time of the faster mode, whose error the damper forgets."""
_NEWTON = 4


class Press(NamedTuple):
    """How deep in a flank, rad, and how fast deeper: rad per 1/ω."""

    depth: Scalar
    rate: Scalar


class Impact(NamedTuple):
    """Where an impact leads.

    - `press`: at the end of the time. - `met`: whether the flank was met, or pressed at the start.
    - `entry`: time until it was met; the whole time where it was not.
    """

    press: Press
    entry: Scalar
    met: Truth


class Pulls(NamedTuple):
    """Acceleration into the flank without contact, rad per 1/ω², constant in each phase.

    It differs by what friction does: `before` the flank is met, while `pressed`, and `after`.
    """

    before: Scalar
    pressed: Scalar
    after: Scalar


class _Piece(NamedTuple):
    """A piece of the law in contact.

    - `spring`, `damper`: shares of c and d that act in it.
    - `depth`, `rate`: it lasts while depth · p + rate · (d/c) ṗ is positive.
    - `loosens`: whether its end is that of the force.
    """

    spring: Scalar
    damper: Scalar
    depth: Scalar
    rate: Scalar
    loosens: Scalar


_STIFF = (2.0, 0.0, -1.0, 1.0, 0.0)
_BOTH = (1.0, 1.0, 1.0, 1.0, 1.0)
_PIECES = np.array([_STIFF, _BOTH, _BOTH, _BOTH])
"""Three series of `both` cover 3.9/ω: contacts that throw the body back are over by then (up to a
damping ratio of 5, where it keeps 7 % of its speed)."""


def impact(start: Press, pulls: Pulls, time: Scalar, damping_ratio: Scalar) -> Impact:
    """Follow a body for a time in 1/ω, through one impact at most.

    What comes after it is at rest in the flank, p = max(0, pull): a contact that lasts on, and a
    bounce that would come back within the time. So no energy is gained.
    """
    entry = jnp.where(start.depth > 0, 0.0, _arrival(start, pulls.before))
    met = entry <= time
    flown = _flown(start, pulls.before, jnp.minimum(entry, time))
    depth = jnp.where(met & (start.depth <= 0), 0.0, flown.depth)
    left = jnp.where(met, time - jnp.minimum(entry, time), 0.0)
    state = (Press(depth, flown.rate), left, jnp.zeros_like(met))
    pull = pulls.pressed

    def through(state, piece: Float[Array, "5"]):
        return _through(state, _Piece(*piece), pull, damping_ratio), None

    (press, left, loose), _ = jax.lax.scan(through, state, jnp.asarray(_PIECES))
    press, left, thrown = _given_way(press, left, met & loose, pull, damping_ratio)
    flight = jnp.where(thrown, jnp.minimum(left, _arrival(press, pulls.after)), 0.0)
    stays = left > flight
    flown = _flown(press, pulls.after, flight)
    depth = jnp.where(stays, jnp.maximum(pull, 0.0), flown.depth)
    rate = jnp.where(stays, 0.0, flown.rate)
    return Impact(Press(depth, rate), jnp.where(met, entry, time), met)


def longest_contact(damping_ratio: float) -> float:
    """Time in 1/ω for which `impact` follows a contact that throws nothing back."""
    both = [_Piece(*piece) for piece in jnp.asarray(_PIECES) if piece[1] > 0]
    return float(sum(_covered(piece, jnp.asarray(damping_ratio)) for piece in both))


def _through(state, piece: _Piece, pull: Scalar, damping_ratio: Scalar):
    """As far as a piece of the law goes, or a series, or the time that is left."""
    press, left, loose = state
    damper = 2 * damping_ratio
    inside = piece.depth * press.depth + piece.rate * damper * press.rate
    covered = jnp.minimum(left, _covered(piece, damping_ratio))
    most = jnp.where((inside >= 0) & ~loose, covered, 0.0)
    depth = _series(press, pull, piece.spring, piece.damper * damper)
    slopes = [n * c for n, c in enumerate(depth)][1:]
    margin = [
        piece.depth * c + piece.rate * damper * s for c, s in zip(depth, slopes, strict=False)
    ]
    ends = ~loose & (_value_slope(margin, most)[0] <= 0)
    time = jnp.where(ends, _root(margin, most), most)
    press = Press(*_value_slope(depth, time))
    return press, left - time, loose | (ends & (piece.loosens > 0))


def _given_way(press: Press, left: Scalar, loose: Truth, pull: Scalar, damping_ratio: Scalar):
    """A body that feels no force inside the flank until it is out, or pulled in again.

    **Returns** where it is then, the time that is left, and whether it is out. Pulled in again, it
    waits for the next step.
    """
    damper = 2 * damping_ratio
    square = press.rate**2 - 2 * pull * press.depth
    leaves = (press.rate < 0) & (square >= 0)
    speed = _root_of(square) - press.rate
    out = 2 * jnp.maximum(press.depth, 0.0) / jnp.where(leaves, speed, 1.0)
    force = Press(press.depth + damper * press.rate, press.rate + damper * pull)
    lasts = jnp.where(leaves, out, _arrival(force, pull))
    time = jnp.where(loose, jnp.minimum(left, lasts), 0.0)
    thrown = loose & leaves & (lasts <= left)
    press = _flown(press, pull, time)
    left = jnp.where(loose & ~thrown, 0.0, left - time)
    return Press(jnp.where(thrown, 0.0, press.depth), press.rate), left, thrown


def _covered(piece: _Piece, damping_ratio: Scalar) -> Scalar:
    """Time that the series of a piece covers."""
    square = damping_ratio**2 - 1
    over = (square > 0) & (piece.damper > 0)
    fast = jnp.where(over, damping_ratio + _root_of(square), 1.0)
    return jnp.where(over, _LONGEST_OVERDAMPED / fast, _LONGEST)


def _series(press: Press, pull: Scalar, spring: Scalar, damper: Scalar) -> Series:
    """Of p̈ = pull − spring p − damper ṗ."""
    found = [press.depth, press.rate]
    for n in range(_ORDER - 1):
        force = spring * found[n] + (n + 1) * damper * found[n + 1]
        found.append(((pull if n == 0 else 0.0) - force) / ((n + 1) * (n + 2)))
    return found


def _value_slope(series: Series, time: Scalar) -> tuple[Scalar, Scalar]:
    value, slope = series[-1], jnp.zeros_like(series[-1])
    for coefficient in series[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def _root(series: Series, most: Scalar) -> Scalar:
    """Where a series that starts at or above zero and is below at `most` vanishes."""
    end, _ = _value_slope(series, most)

    # In a loop, because XLA would otherwise repeat all of it for each of its uses.
    def newton(_, time):
        value, slope = _value_slope(series, time)
        return jnp.clip(time - value / _nonzero(slope), 0.0, most)

    first = most * jnp.clip(series[0] / _nonzero(series[0] - end), 0.0, 1.0)
    return jax.lax.fori_loop(0, _NEWTON, newton, first)


def _flown(press: Press, pull: Scalar, time: Scalar) -> Press:
    return Press(press.depth + time * (press.rate + 0.5 * time * pull), press.rate + time * pull)


def _arrival(press: Press, pull: Scalar) -> Scalar:
    """When a flight that begins at depth ≤ 0 comes to depth zero from outside; ∞ for never."""
    square = press.rate**2 - 2 * pull * press.depth
    root = _root_of(square)
    inwards = press.rate > 0
    above = jnp.where(inwards, -2 * press.depth, root - press.rate)
    below = jnp.where(inwards, press.rate + root, pull)
    comes = (square >= 0) & (below > 0)
    return jnp.where(comes, jnp.maximum(above, 0.0) / jnp.where(comes, below, 1.0), jnp.inf)


def _root_of(value: Scalar) -> Scalar:
    """Square root with a finite slope everywhere; 0 below zero."""
    positive = value > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)


def _nonzero(value: Scalar) -> Scalar:
    return jnp.where(value == 0, 1.0, value)
