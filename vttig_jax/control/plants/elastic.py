"""Elastic teeth: the driven shaft flies through the gap and springs back from a flank."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ..hermite import cubic
from ..motion.motion import MotionPoint
from .elastic_impact import Press, Pulls, impact, longest_contact
from .flank_bounds import Bounds
from .plant import (
    FREE,
    ON_A,
    ON_B,
    ContactEvent,
    Drag,
    Plant,
    Shafts,
    Slide,
    Walls,
    touching,
    walls,
)

Scalar = Float[Array, ""]


class ElasticPlant(Plant):
    """Inertia and friction in the gap, stiffness and damping at the flanks.

    A flank that the driven shaft is p deep in turns it, with d = 2 ζ √(c J₂), by

        T₂ = max(0, c p + clip(d ṗ, ±c p))

    A step goes through a whole impact (see `elastic_impact`) with walls that accelerate evenly and
    constant friction. Any step is stable, and the mesh never gives back energy that it has not
    taken. What comes after one impact is at rest in the flank: a contact that lasts on, and a
    bounce so low that it would come back within the same step. A gap that is forced shut holds the
    shaft at rest between both springs.

    **Arguments**
    - `drag`: inertia and friction of the driven shaft.
    - `stiffness`: c, N m/rad at the driven shaft; see `mesh_stiffness`.
    - `damping_ratio`: ζ. It refers to J₂ alone where the driving motion is prescribed.
    - `effective`: inertia of both shafts against each other, kg m², where the driving one gives way
      (`against`); it stands for J₂ in all that the flank does, and ζ refers to it.
    """

    drag: Drag
    stiffness: Float[Number, ""] = eqx.field(converter=float64)
    damping_ratio: Float[Number, ""] = eqx.field(converter=float64)
    effective: Float[Number, ""] | None = None

    def against(self, effective: Float[Number, ""]) -> "ElasticPlant":
        """The same teeth between two shafts that move each other.

        Friction is then constant over a whole step, an impact in it included, so that what differs
        from `slowing` is the flank's doing alone.
        """
        return ElasticPlant(self.drag, self.stiffness, self.damping_ratio, effective)

    def torque(self, shafts: Shafts, now: Walls) -> Scalar:
        """Of the flanks on the driven shaft, N m: positive that of A."""
        depths = _depths(now, shafts.offset, shafts.drift)
        return self._torque(depths.a) - self._torque(depths.b)

    def slowing(self, shafts: Shafts, now: Walls, ratio: Scalar, step: Scalar) -> Scalar:
        """What friction and load do to a driven shaft that the flanks press, rad/s²."""
        force = self.torque(shafts, now)
        hold = jnp.asarray(self.drag.coulomb) + self.drag.stribeck
        push = jnp.clip(force, self.drag.load - hold, self.drag.load + hold)
        push = jnp.where(force == 0, 0.0, push)
        turning = ratio * shafts.speed + shafts.drift
        return self.drag.acceleration(turning, push, step) - push / self.drag.inertia

    def step(
        self, shafts: Shafts, ahead: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """See `Plant.step`."""
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        step = jnp.asarray(step)
        flanks = bounds.at(ahead.angle)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        then = walls(flanks, ahead.speed, closing, slide.end, slide.end_rate)
        turning = ratio * shafts.speed + shafts.drift
        if self.effective is None:
            slowing = self.drag.acceleration(turning, 0.0, step)
        else:
            slowing = self.slowing(shafts, now, ratio, step)
        free = shafts.offset + step * (turning + 0.5 * step * slowing)
        free -= ratio * (ahead.angle - shafts.angle)
        drift = shafts.drift + step * slowing - ratio * (ahead.speed - shafts.speed)

        flight = _Flight(shafts.offset, shafts.drift, free, drift, turning, slowing)
        landing = self._landing(now, then, flight, step)
        offset, share = landing.offset, landing.share
        met = jnp.where(landing.met & (landing.flank != shafts.side), landing.flank, FREE)
        # As of rigid teeth: a gap that has closed meets the flank that did not carry.
        met = jnp.where(then.lower > then.upper, -shafts.side, met)
        side = touching(offset < then.lower, offset > then.upper, shafts.side)
        low = cubic(now.lower, then.lower, now.lower_rate, then.lower_rate, step)
        high = cubic(now.upper, then.upper, now.upper_rate, then.upper_rate, step)
        way = cubic(shafts.angle, ahead.angle, shafts.speed, ahead.speed, step)
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share), share)
        return Shafts(ahead.angle, ahead.speed, offset, landing.drift, side, flanks), touch

    def _landing(self, now: Walls, then: Walls, flight: "_Flight", step: Scalar) -> "_Landing":
        """Where a flight leads once the flanks have their say."""
        rate = jnp.sqrt(jnp.asarray(self.stiffness) / self._inertia)
        starts = _depths(now, flight.start, flight.start_rate)
        ends = _depths(then, flight.end, flight.end_rate)
        nearer_a = (starts.b.depth <= 0) & (ends.a.depth > ends.b.depth)
        on_a = (starts.a.depth > 0) | nearer_a
        sense = jnp.where(on_a, 1.0, -1.0)
        start, end = (
            Press(*(jnp.where(on_a, a, b) for a, b in zip(*both, strict=True)))
            for both in (starts, ends)
        )
        free = held = (end.rate - start.rate) / step
        if self.effective is None:
            held = free - sense * self._held(flight, start, sense * end.rate, sense, step)
        pulls = Pulls(free, held, jnp.where(start.depth > 0, free, held))
        one = impact(
            Press(start.depth, start.rate / rate),
            Pulls(*(pull / rate**2 for pull in pulls)),
            rate * step,
            jnp.asarray(self.damping_ratio),
        )
        depth, speed = one.press.depth, rate * one.press.rate
        offset = jnp.where(on_a, then.lower - depth, then.upper + depth)
        offset = jnp.where(one.met, offset, flight.end)
        # The other flank, where it is reached as well, is met at the start of the next step.
        offset = jnp.where(on_a, jnp.minimum(offset, then.upper), jnp.maximum(offset, then.lower))
        drift = jnp.where(on_a, then.lower_rate - speed, then.upper_rate + speed)
        drift = jnp.where(one.met, drift, flight.end_rate)
        share = jnp.minimum(one.entry / (rate * step), 1.0)
        landing = _Landing(offset, drift, jnp.where(on_a, ON_A, ON_B), one.met, share)
        return _shut(then, (ends.a.rate - starts.a.rate) / (step * rate**2), landing)

    def _held(
        self, flight: "_Flight", start: Press, lag: Scalar, sense: Scalar, step: Scalar
    ) -> Scalar:
        """How much more friction accelerates the shaft on a flank than in flight, rad/s².

        On a flank that presses at the start it stands up to its torque, as far as it can: in an
        impact, which is shorter than the step, no more. After one that is still to come it acts
        against the sense of the rebound: 1/(1 + 3 ζ) is close to the restitution.
        """
        pressed = start.depth > 0
        bounce = (1 + 1 / (1 + 3 * jnp.asarray(self.damping_ratio))) * lag
        turning = flight.turning + jnp.where(pressed, 0.0, step * flight.slowing + bounce)
        hold = jnp.asarray(self.drag.coulomb) + self.drag.stribeck
        push = jnp.where(pressed, sense * self._torque(start), 0.0)
        push = jnp.clip(push, self.drag.load - hold, self.drag.load + hold)
        push = jnp.where(pressed, push, 0.0)
        slowing = self.drag.acceleration(turning, push, step) - push / self.drag.inertia
        return slowing - flight.slowing

    def _torque(self, press: Press) -> Scalar:
        stiffness = jnp.asarray(self.stiffness)
        spring = stiffness * jnp.maximum(press.depth, 0.0)
        damping = 2 * self.damping_ratio * jnp.sqrt(stiffness * self._inertia)
        return spring + jnp.clip(damping * press.rate, -spring, spring)

    @property
    def _inertia(self) -> Float[Number, ""]:
        return self.drag.inertia if self.effective is None else self.effective


def mesh_stiffness(c_gamma_N_mm_um: float, face_width_mm: float, base_radius_mm: float) -> float:
    """c in N m/rad at the driven shaft from the mesh stiffness of ISO 6336.

        c = c_γ b r_b2²

    **Arguments**
    - `c_gamma_N_mm_um`: c_γ, N per mm of face width and µm on the line of action.
    - `face_width_mm`: b. - `base_radius_mm`: r_b2.

    **Example**
    ```python
    >>> from vttig_jax.control import mesh_stiffness
    >>> round(mesh_stiffness(20.0, 20.0, 75.18))
    2260813

    ```
    """
    return c_gamma_N_mm_um * face_width_mm * base_radius_mm**2


def largest_step(stiffness: float, damping_ratio: float, inertia: float) -> float:
    """Longest step in s that resolves the contact; any step is stable.

    Up to it a contact is followed to the end of the step; beyond it one that lasts on is taken as
    at rest, and its ringing is lost. The positions keep to a second of arc far beyond.

    **Arguments**
    - `stiffness`: c, N m/rad. - `damping_ratio`: ζ. - `inertia`: J₂, kg m².

    **Example**
    ```python
    >>> from vttig_jax.control.plants.elastic import largest_step
    >>> round(largest_step(2.26e6, 0.1, 0.01), 6)
    0.000259

    ```
    """
    return longest_contact(damping_ratio) * math.sqrt(inertia / stiffness)


class _Depths(NamedTuple):
    """How deep the driven shaft is in flank A and B, rad and rad/s."""

    a: Press
    b: Press


class _Flight(NamedTuple):
    """A step without flanks: x and its rate at both ends, φ̇₂ at the start and φ̈₂; rad and s."""

    start: Scalar
    start_rate: Scalar
    end: Scalar
    end_rate: Scalar
    turning: Scalar
    slowing: Scalar


class _Landing(NamedTuple):
    """x and its rate at the end of a step; whether `flank` was met in it, and at what share."""

    offset: Scalar
    drift: Scalar
    flank: Scalar
    met: Bool[Array, ""]
    share: Scalar


def _depths(bounds: Walls, offset: Scalar, drift: Scalar) -> _Depths:
    return _Depths(
        Press(bounds.lower - offset, bounds.lower_rate - drift),
        Press(offset - bounds.upper, drift - bounds.upper_rate),
    )


def _shut(then: Walls, pull: Scalar, landing: _Landing) -> _Landing:
    """Between two springs that overlap: at rest where they and the pull onto A balance."""
    overlap = then.lower - then.upper
    # Beyond an overlap's worth of pull the other flank carries nothing.
    depth = jnp.minimum(jnp.maximum(0.5 * (overlap + pull), pull), overlap + pull)
    drift = 0.5 * (then.lower_rate + then.upper_rate)
    shut = overlap > 0
    return landing._replace(
        offset=jnp.where(shut, then.lower - depth, landing.offset),
        drift=jnp.where(shut, drift, landing.drift),
        share=jnp.where(shut, 1.0, landing.share),
    )
