"""One impact of a body on a flank with spring and damper, computed without small time steps.

At a penetration p of the body into the flank (negative outside) the torque per inertia is

    F/J = max(0, ω² p + clip(2 ζ ω ṗ, ±ω² p)),  ω = √(c/J)

(Modelica's ElastoBacklash: the damping is limited to the spring torque; the flank never pulls).
An ordinary integrator would need steps much shorter than the contact, which lasts about π/ω. The
law is piecewise linear, and an impact passes its pieces in a fixed order (torque in brackets):

    flight → stiff (2 c p) → both (c p + d ṗ) → loose (0) → flight

In each piece p is a power series in time. The piece ends at the root of a second power series, its
condition of validity. All times are in units of 1/ω.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..hermite import nonzero

Scalar = Float[Array, ""]
Truth = Bool[Array, ""]
Series = Sequence[Scalar]
"""Coefficients of a power series in time, lowest power first."""

_ORDER = 12  # highest power of a series; a chosen value
_SERIES_TIME = 1.3
"""Longest time (1/ω) for one series; the truncation error is 1.3¹³/13! = 5e-9 of the depth or less.
"""
_SERIES_TIME_OVERDAMPED = 2.0
"""Longest time for one series if ζ > 1, in decay times of the faster mode; a chosen value."""
_NEWTON = 4  # Newton iterations; a chosen value


class Press(eqx.Module):
    """Penetration into a flank, rad, and its rate, rad per 1/ω."""

    depth: Scalar
    rate: Scalar


class Impact(eqx.Module):
    """Result of an impact.

    - `press`: penetration at the end of the given time. - `met`: whether there was any contact.
    - `entry`: time until the first contact, 1/ω; if there was no contact, the whole time.
    """

    press: Press
    entry: Scalar
    met: Truth


class Pulls(eqx.Module):
    """Acceleration of the body into the flank by all torques except the contact torque.

    It is in rad per 1/ω² and constant in each of three phases: `before` the contact, during the
    contact (`pressed`), and `after` the contact. Its value differs only by the friction.
    """

    before: Scalar
    pressed: Scalar
    after: Scalar


class _Progress(eqx.Module):
    """State of an impact between two pieces of the contact law.

    - `press`: penetration and its rate. - `remaining`: time until the end of the step, 1/ω.
    - `loose`: whether the contact torque has become zero.
    """

    press: Press
    remaining: Scalar
    loose: Truth


class _Piece(eqx.Module):
    """Linear piece of the contact law.

    - `spring`, `damper`: factors of c and d, so that the torque is spring · c p + damper · d ṗ.
    - `depth`, `rate`: the piece applies while depth · p + rate · (d/c) ṗ is positive.
    - `releases`: whether the contact torque is zero after this piece.
    """

    spring: Scalar
    damper: Scalar
    depth: Scalar
    rate: Scalar
    releases: Scalar


_STIFF = (2.0, 0.0, -1.0, 1.0, 0.0)
_BOTH = (1.0, 1.0, 1.0, 1.0, 1.0)
_PIECES = np.array([_STIFF, _BOTH, _BOTH, _BOTH])
"""The piece `_BOTH` is computed with three consecutive series. Together they cover 3.9/ω. For
damping ratios up to 5 a contact with a rebound is shorter; at 5 the rebound has 7 % of the speed.
"""


def impact(start: Press, pulls: Pulls, time: Scalar, damping_ratio: Scalar) -> Impact:
    """Return the state of a body after a time (1/ω) with at most one impact.

    If the contact outlasts the series, or if the body would meet the flank again within the time,
    the body ends at rest at p = max(0, pull). The energy therefore never increases.
    """
    entry = jnp.where(start.depth > 0, 0.0, _arrival(start, pulls.before))
    met = entry <= time
    flown = _flight(start, pulls.before, jnp.minimum(entry, time))
    depth = jnp.where(met & (start.depth <= 0), 0.0, flown.depth)
    remaining = jnp.where(met, time - jnp.minimum(entry, time), 0.0)
    begun = _Progress(Press(depth, flown.rate), remaining, jnp.zeros_like(met))
    pull = pulls.pressed

    def advance(state: _Progress, piece: Float[Array, "5"]) -> tuple[_Progress, None]:
        return _advance(state, _Piece(*piece), pull, damping_ratio), None

    ended, _ = jax.lax.scan(advance, begun, jnp.asarray(_PIECES))
    loose = met & ended.loose
    press, remaining, thrown = _separation(ended.press, ended.remaining, loose, pull, damping_ratio)
    flight = jnp.where(thrown, jnp.minimum(remaining, _arrival(press, pulls.after)), 0.0)
    stays = remaining > flight
    flown = _flight(press, pulls.after, flight)
    depth = jnp.where(stays, jnp.maximum(pull, 0.0), flown.depth)
    rate = jnp.where(stays, 0.0, flown.rate)
    return Impact(Press(depth, rate), jnp.where(met, entry, time), met)


def longest_contact(damping_ratio: float) -> float:
    """Return the time (1/ω) for which `impact` follows a contact without rebound."""
    both = [_Piece(*piece) for piece in jnp.asarray(_PIECES) if piece[1] > 0]
    return float(sum(_series_time(piece, jnp.asarray(damping_ratio)) for piece in both))


def _advance(state: _Progress, piece: _Piece, pull: Scalar, damping_ratio: Scalar) -> _Progress:
    """Advance until the piece, the validity of its series or the remaining time ends.

    The earliest of these three ends counts. `pull` is the acceleration by other torques.
    """
    press, remaining, loose = state.press, state.remaining, state.loose
    damper = 2 * damping_ratio
    inside = piece.depth * press.depth + piece.rate * damper * press.rate
    covered = jnp.minimum(remaining, _series_time(piece, damping_ratio))
    limit = jnp.where((inside >= 0) & ~loose, covered, 0.0)
    depth = _series(press, pull, piece.spring, piece.damper * damper)
    slopes = [n * c for n, c in enumerate(depth)][1:]
    margin = [
        piece.depth * c + piece.rate * damper * s for c, s in zip(depth, slopes, strict=False)
    ]
    ends = ~loose & (_value_slope(margin, limit)[0] <= 0)
    time = jnp.where(ends, _root(margin, limit), limit)
    press = Press(*_value_slope(depth, time))
    return _Progress(press, remaining - time, loose | (ends & (piece.releases > 0)))


def _separation(press: Press, remaining: Scalar, loose: Truth, pull: Scalar, damping_ratio: Scalar):
    """Move a body that is still inside the flank but has no contact torque.

    The contact torque is zero when the damper cancels the spring (`loose`). The body then moves at
    the constant acceleration `pull` (rad per 1/ω²) until one of three events: it leaves the flank
    at the penetration zero, the law p + 2 ζ ṗ gives a torque again, or the `remaining` time (1/ω)
    has passed. After the second event the body stays where it is until the end of this time step,
    and the next time step continues from there. A body that is not `loose` is not moved.

    **Returns** the penetration and its rate, the time that remains (1/ω), and True if the body left
    the flank.
    """
    damper = 2 * damping_ratio
    square = press.rate**2 - 2 * pull * press.depth
    leaves = (press.rate < 0) & (square >= 0)
    speed = _sqrt(square) - press.rate
    leaving_time = 2 * jnp.maximum(press.depth, 0.0) / jnp.where(leaves, speed, 1.0)
    force = Press(press.depth + damper * press.rate, press.rate + damper * pull)
    duration = jnp.where(leaves, leaving_time, _arrival(force, pull))
    time = jnp.where(loose, jnp.minimum(remaining, duration), 0.0)
    thrown = loose & leaves & (duration <= remaining)
    press = _flight(press, pull, time)
    remaining = jnp.where(loose & ~thrown, 0.0, remaining - time)
    return Press(jnp.where(thrown, 0.0, press.depth), press.rate), remaining, thrown


def _series_time(piece: _Piece, damping_ratio: Scalar) -> Scalar:
    """Return the time (1/ω) over which the power series of a piece is accurate enough."""
    square = damping_ratio**2 - 1
    over = (square > 0) & (piece.damper > 0)
    fast = jnp.where(over, damping_ratio + _sqrt(square), 1.0)
    return jnp.where(over, _SERIES_TIME_OVERDAMPED / fast, _SERIES_TIME)


def _series(press: Press, pull: Scalar, spring: Scalar, damper: Scalar) -> Series:
    """Return the power series of p̈ = pull − spring p − damper ṗ."""
    series = [press.depth, press.rate]
    for n in range(_ORDER - 1):
        force = spring * series[n] + (n + 1) * damper * series[n + 1]
        series.append(((pull if n == 0 else 0.0) - force) / ((n + 1) * (n + 2)))
    return series


def _value_slope(series: Series, time: Scalar) -> tuple[Scalar, Scalar]:
    value, slope = series[-1], jnp.zeros_like(series[-1])
    for coefficient in series[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def _root(series: Series, limit: Scalar) -> Scalar:
    """Return the root of a series between the time 0 (value ≥ 0) and `limit` (value ≤ 0)."""
    end, _ = _value_slope(series, limit)

    # `fori_loop` prevents that XLA recomputes these operations for every use of the root.
    def newton(_, time):
        value, slope = _value_slope(series, time)
        return jnp.clip(time - value / nonzero(slope), 0.0, limit)

    first = limit * jnp.clip(series[0] / nonzero(series[0] - end), 0.0, 1.0)
    return jax.lax.fori_loop(0, _NEWTON, newton, first)


def _flight(press: Press, pull: Scalar, time: Scalar) -> Press:
    return Press(press.depth + time * (press.rate + 0.5 * time * pull), press.rate + time * pull)


def _arrival(press: Press, pull: Scalar) -> Scalar:
    """Return the time (1/ω) until a body in flight from depth ≤ 0 enters the flank; ∞ if never."""
    square = press.rate**2 - 2 * pull * press.depth
    root = _sqrt(square)
    inwards = press.rate > 0
    above = jnp.where(inwards, -2 * press.depth, root - press.rate)
    below = jnp.where(inwards, press.rate + root, pull)
    comes = (square >= 0) & (below > 0)
    return jnp.where(comes, jnp.maximum(above, 0.0) / jnp.where(comes, below, 1.0), jnp.inf)


def _sqrt(value: Scalar) -> Scalar:
    """Return the square root, or 0 for values ≤ 0; its derivative is finite everywhere."""
    positive = value > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)
