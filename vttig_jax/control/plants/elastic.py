"""Plant with elastic teeth: free flight through the gap, spring and damper at the flanks."""

import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ...base.errors import ScenarioError
from ...kinematics.flank_table import Bounds
from ...pair.gear_pair import GearPair
from ..fields import Quantity, is_known, number, positive
from ..hermite import cubic
from ..motion.motion import MotionPoint
from .elastic_impact import Press, Pulls, impact, longest_contact
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


class Elastic(Plant):
    """Plant with inertia and friction in the gap, stiffness and damping at the flanks.

    At a penetration p of the driven shaft, the flank exerts the torque (d = 2 ζ √(c J₂))

        T₂ = max(0, c p + clip(d ṗ, ±c p))

    One time step covers a whole impact (see `elastic_impact`). In the step the flanks have constant
    acceleration, and friction is constant before, during and after the contact. A step of any
    length is stable, and the mesh never returns more energy than it has absorbed. At most one
    impact per step is computed: if the contact persists, or if the shaft would meet the flank again
    within the step, the shaft ends at rest relative to the flank. In a closed gap the shaft rests
    between both springs.

    **Arguments**
    - `stiffness_N_mm_um`: c_γ of ISO 6336. - `damping_ratio`: ζ; if the driving motion is
      prescribed, it is defined with J₂ alone.
    - `drag`: inertia and friction of the driven shaft. - `stiffness`: c, N m/rad at the driven
      shaft; see `mesh_stiffness`. `run` fills in both.
    - `effective`: inertia of the relative motion of both shafts, kg m², if the driving shaft can
      move (`coupled`); it replaces J₂ in the contact law and in the definition of ζ.
    """

    stiffness_N_mm_um: Quantity = positive(
        20.0, "elastic: mesh stiffness per face width, ISO 6336", "N/(mm um)"
    )
    damping_ratio: Quantity = number(
        0.1, "elastic: damping over critical damping", "1", ge=0, le=100
    )
    drag: Drag = Drag(1.0)
    stiffness: Float[Number, ""] = eqx.field(converter=float64, default=1.0)
    effective: Float[Number, ""] | None = None

    def with_shaft(self, drag: Drag, pair: Any) -> "Elastic":
        """See `Plant.with_shaft`.

        **Raises** `ScenarioError` for gears without face width.
        """
        width = pair.driven.face_width_mm if isinstance(pair, GearPair) else np.nan
        if is_known(width) and np.isnan(width):
            cure = "add `face_width_mm` to [driven] of the pair file"
            if not isinstance(pair, GearPair):
                cure = "a [drive] has none, so choose the rigid plant"
            raise ScenarioError(
                f"the elastic plant needs the face width of the driven gear; {cure}.", where="plant"
            )
        radius = pair.base_radii[1].mean()
        stiffness = mesh_stiffness(self.stiffness_N_mm_um, width, radius)
        return replace(self, drag=drag, stiffness=stiffness)

    def coupled(self, effective: Float[Number, ""]) -> "Elastic":
        """Return the same plant for a driving shaft that the teeth can move.

        `effective` is the inertia of the relative motion of both shafts, kg m². In this plant
        friction is constant over the whole step, including impacts, so the acceleration differs
        from `slowing` by the contact torque alone.
        """
        return replace(self, effective=effective)

    def torque(self, shafts: Shafts, now: Walls) -> Scalar:
        """Return the torque of both flanks on the driven shaft, N m; flank A acts positively.

        `now` holds the position and the rate of both flanks.
        """
        depths = _depths(now, shafts.offset, shafts.drift)
        return self._torque(depths.a) - self._torque(depths.b)

    def slowing(self, shafts: Shafts, now: Walls, ratio: Scalar, step: Scalar) -> Scalar:
        """Return the acceleration of the driven shaft by friction and load, rad/s².

        It is the mean over a time step (`step`, s), and negative where it slows a positive speed.
        The acceleration by the contact torque is not included, but friction and load oppose the
        contact torque as far as they can balance it at standstill. `ratio` is i.
        """
        force = self.torque(shafts, now)
        push = jnp.where(force == 0, 0.0, self._friction_limited(force))
        driven_speed = ratio * shafts.speed + shafts.drift
        return self.drag.acceleration(driven_speed, push, step) - push / self.drag.inertia

    def _friction_limited(self, torque: Scalar) -> Scalar:
        """Return `torque` (N m), limited to what friction and the load can balance at standstill.

        The range is T_load ± (T_c + T_s).
        """
        limit = jnp.asarray(self.drag.coulomb) + self.drag.stribeck
        return jnp.clip(torque, self.drag.load - limit, self.drag.load + limit)

    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """See `Plant.step`."""
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        step = jnp.asarray(step)
        flanks = bounds.at(driving.angle)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        then = walls(flanks, driving.speed, closing, slide.end, slide.end_rate)
        driven_speed = ratio * shafts.speed + shafts.drift
        if self.effective is None:
            slowing = self.drag.acceleration(driven_speed, 0.0, step)
        else:
            slowing = self.slowing(shafts, now, ratio, step)
        free = shafts.offset + step * (driven_speed + 0.5 * step * slowing)
        free -= ratio * (driving.angle - shafts.angle)
        drift = shafts.drift + step * slowing - ratio * (driving.speed - shafts.speed)

        flight = _Flight(
            start=shafts.offset,
            start_rate=shafts.drift,
            end=free,
            end_rate=drift,
            driven_speed=driven_speed,
            slowing=slowing,
        )
        landing = self._landing(now, then, flight, step)
        offset, share = landing.offset, landing.share
        met = jnp.where(landing.met & (landing.flank != shafts.side), landing.flank, FREE)
        # As with rigid teeth: when the gap closes, the flank opposite to `side` is newly loaded.
        met = jnp.where(then.lower > then.upper, -shafts.side, met)
        side = touching(offset < then.lower, offset > then.upper, shafts.side)
        low = cubic(now.lower, then.lower, now.lower_rate, then.lower_rate, step)
        high = cubic(now.upper, then.upper, now.upper_rate, then.upper_rate, step)
        way = cubic(shafts.angle, driving.angle, shafts.speed, driving.speed, step)
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share), share)
        return Shafts(
            angle=driving.angle,
            speed=driving.speed,
            offset=offset,
            drift=landing.drift,
            side=side,
            flanks=flanks,
        ), touch

    def _landing(self, now: Walls, then: Walls, flight: "_Flight", step: Scalar) -> "_Landing":
        """Return the driven shaft at the end of a step, from the flight without contact.

        `now` and `then` are the flanks at the start and the end of the step (s).
        """
        rate = jnp.sqrt(jnp.asarray(self.stiffness) / self._inertia)
        starts = _depths(now, flight.start, flight.start_rate)
        ends = _depths(then, flight.end, flight.end_rate)
        nearer_a = (starts.b.depth <= 0) & (ends.a.depth > ends.b.depth)
        on_a = (starts.a.depth > 0) | nearer_a
        sense = jnp.where(on_a, 1.0, -1.0)
        start, end = (
            jax.tree.map(lambda a, b: jnp.where(on_a, a, b), both.a, both.b)
            for both in (starts, ends)
        )
        free = loaded = (end.rate - start.rate) / step
        if self.effective is None:
            change = self._friction_change(flight, start, sense * end.rate, sense, step)
            loaded = free - sense * change
        pulls = Pulls(free, loaded, jnp.where(start.depth > 0, free, loaded))
        result = impact(
            Press(start.depth, start.rate / rate),
            jax.tree.map(lambda pull: pull / rate**2, pulls),
            rate * step,
            jnp.asarray(self.damping_ratio),
        )
        depth, speed = result.press.depth, rate * result.press.rate
        offset = jnp.where(on_a, then.lower - depth, then.upper + depth)
        offset = jnp.where(result.met, offset, flight.end)
        # If the rebound also reaches the other flank, the shaft stops there until the next step.
        offset = jnp.where(on_a, jnp.minimum(offset, then.upper), jnp.maximum(offset, then.lower))
        drift = jnp.where(on_a, then.lower_rate - speed, then.upper_rate + speed)
        drift = jnp.where(result.met, drift, flight.end_rate)
        share = jnp.minimum(result.entry / (rate * step), 1.0)
        landing = _Landing(offset, drift, jnp.where(on_a, ON_A, ON_B), result.met, share)
        return _wedged(then, (ends.a.rate - starts.a.rate) / (step * rate**2), landing)

    def _friction_change(
        self, flight: "_Flight", start: Press, lag: Scalar, sense: Scalar, step: Scalar
    ) -> Scalar:
        """Return the acceleration by friction with contact minus that in flight, rad/s².

        If the flank is loaded at the start of the step, friction opposes the contact torque up to
        the friction limit. If the impact occurs within the step, friction opposes the motion after
        the rebound; 1/(1 + 3 ζ) approximates the coefficient of restitution.

        **Arguments**
        - `start`: penetration at the start. - `sense`: 1 for flank A, −1 for flank B.
        - `lag`: rate of the flank minus rate of the shaft at the end of the flight, rad/s.
        """
        pressed = start.depth > 0
        rebound = (1 + 1 / (1 + 3 * jnp.asarray(self.damping_ratio))) * lag
        later = jnp.where(pressed, 0.0, step * flight.slowing + rebound)
        push = jnp.where(pressed, sense * self._torque(start), 0.0)
        push = jnp.where(pressed, self._friction_limited(push), 0.0)
        slowing = self.drag.acceleration(flight.driven_speed + later, push, step)
        return slowing - push / self.drag.inertia - flight.slowing

    def _torque(self, press: Press) -> Scalar:
        stiffness = jnp.asarray(self.stiffness)
        spring = stiffness * jnp.maximum(press.depth, 0.0)
        damping = 2 * self.damping_ratio * jnp.sqrt(stiffness * self._inertia)
        return spring + jnp.clip(damping * press.rate, -spring, spring)

    @property
    def _inertia(self) -> Float[Number, ""]:
        return self.drag.inertia if self.effective is None else self.effective


def mesh_stiffness(c_gamma_N_mm_um: Any, face_width_mm: Any, base_radius_mm: Any) -> Any:
    """Return the torsional mesh stiffness c (N m/rad at the driven shaft) from that of ISO 6336.

        c = c_γ b r_b2²

    **Arguments**
    - `c_gamma_N_mm_um`: c_γ, N per mm of face width and µm on the line of action.
    - `face_width_mm`: b. - `base_radius_mm`: base circle radius r_b2 of the driven gear.

    **Example**
    ```python
    >>> from vttig_jax.control import mesh_stiffness
    >>> round(mesh_stiffness(20.0, 20.0, 75.18))
    2260813

    ```
    """
    return c_gamma_N_mm_um * face_width_mm * base_radius_mm**2


def largest_step(stiffness: float, damping_ratio: float, inertia: float) -> float:
    """Return the longest time step (s) that resolves the oscillation in a lasting contact.

    Longer steps are stable too, but then a shaft in lasting contact is set to rest, and its
    oscillation is lost. Positions stay accurate to an arcsecond with much longer steps.

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


class _Depths(eqx.Module):
    """Penetration of the driven shaft into flanks A and B, rad, and its rate, rad/s."""

    a: Press
    b: Press


class _Flight(eqx.Module):
    """Motion of the driven shaft in a step without contact; units rad and s.

    - `start`, `start_rate`, `end`, `end_rate`: x and dx/dt at the start and the end of the step.
    - `driven_speed`: φ̇₂ at the start. - `slowing`: φ̈₂ by friction and load.
    """

    start: Scalar
    start_rate: Scalar
    end: Scalar
    end_rate: Scalar
    driven_speed: Scalar
    slowing: Scalar


class _Landing(eqx.Module):
    """Driven shaft at the end of a step.

    - `offset`, `drift`: x and its rate, rad and rad/s. - `met`: whether the shaft touched `flank`.
    - `share`: elapsed fraction of the step at the first contact.
    """

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


def _wedged(then: Walls, pull: Scalar, landing: _Landing) -> _Landing:
    """Place the driven shaft of a closed gap in equilibrium; leave it unchanged in an open gap.

    The spring forces of both flanks balance `pull`, the acceleration towards flank A divided by
    c/J (rad).
    """
    overlap = then.lower - then.upper
    # If the pull exceeds the overlap, one of the flanks is unloaded.
    depth = jnp.minimum(jnp.maximum(0.5 * (overlap + pull), pull), overlap + pull)
    drift = 0.5 * (then.lower_rate + then.upper_rate)
    closed = overlap > 0
    return replace(
        landing,
        offset=jnp.where(closed, then.lower - depth, landing.offset),
        drift=jnp.where(closed, drift, landing.drift),
        share=jnp.where(closed, 1.0, landing.share),
    )
