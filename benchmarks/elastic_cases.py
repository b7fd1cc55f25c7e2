"""The rigs of `elastic_accuracy`, and the law of elastic teeth sampled by two explicit methods."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from tests.oracles.elastic_contact import Contact
from tests.oracles.flank_formulas import PAPER, closed, steady
from tests.oracles.trapezoid_corners import Corners
from vttig_jax.base.arrays import Number
from vttig_jax.control.hermite import cubic
from vttig_jax.control.motion.motion import MotionPoint
from vttig_jax.control.plants.plant import (
    FREE,
    ON_A,
    ContactEvent,
    Drag,
    Plant,
    Shafts,
    Slide,
    walls,
)
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.kinematics.flank_table import Bounds, FirstOrderBounds
from vttig_jax.rig.paper import paper_eccentricities, paper_pair

SPEED, SAMPLE = 2 * math.pi, 1e-3
OPEN = Slide(*[jnp.zeros(())] * 4)


@dataclass(frozen=True)
class Case:
    """N m/rad, kg m², N m, degrees of the driving shaft; walls of the paper's rig or at rest."""

    stiffness: float = 2.3e6
    damping_ratio: float = 0.1
    inertia: float = 0.01
    coulomb: float = 0.05
    turn_deg: float = 540.0
    moving: bool = True

    @property
    def turn_s(self) -> float:
        """The ramps together cover what half a second of steady motion does."""
        return self.turn_deg / 360.0 + 0.5

    @property
    def contact(self) -> Contact:
        turn = self.turn_s
        corners = Corners(
            [0, 0.5, turn - 0.5, turn, turn + 0.5, turn + 1], [0, SPEED, SPEED, 0, -SPEED, -SPEED]
        )
        damping = 2 * self.damping_ratio * math.sqrt(self.stiffness * self.inertia)
        sides = closed() if self.moving else steady(0.0, PAPER.constant_backlash)
        numbers = PAPER.ratio, self.inertia, self.stiffness, damping, self.coulomb
        return Contact(sides, corners, *numbers)

    @property
    def bounds(self) -> Bounds:
        if self.moving:
            return closed_model(paper_pair(), paper_eccentricities())
        zero = np.zeros((2, 2))
        gap = np.array([0.0, PAPER.constant_backlash])
        return FirstOrderBounds(ratio=PAPER.ratio, offset=gap, cosine=zero, sine=zero)

    def plant(self, kind: Callable[..., Plant]) -> Plant:
        return kind(Drag(self.inertia, self.coulomb), self.stiffness, self.damping_ratio)

    @property
    def times(self) -> np.ndarray:
        return self.turn_s - 0.5 + SAMPLE * np.arange(1001)


class SampledPlant(Plant):
    """The law of `Elastic`, sampled; x stands for φ₂ less what it was at the step's start."""

    drag: Drag
    stiffness: Number
    damping_ratio: Number

    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        flanks = bounds.at(driving.angle)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        then = walls(flanks, driving.speed, closing, slide.end, slide.end_rate)
        turned = ratio * (driving.angle - shafts.angle)
        base = ratio * shafts.speed, ratio * driving.speed
        low, high = (
            cubic(a - shafts.offset, b + turned - shafts.offset, v + base[0], w + base[1], step)
            for a, b, v, w in (
                (now.lower, then.lower, now.lower_rate, then.lower_rate),
                (now.upper, then.upper, now.upper_rate, then.upper_rate),
            )
        )

        def force(at: Any, place: Any, speed: Any) -> Any:
            at = jnp.asarray(at)
            push = self.push(low.at(at) - place, low.slope(at) / step - speed)
            push -= self.push(place - high.at(at), speed - high.slope(at) / step)
            return self.drag.acceleration(speed, push, jnp.asarray(step))

        place, speed = self.advanced(force, shafts.drift + base[0], jnp.asarray(step))
        offset = shafts.offset + place - turned
        none = ContactEvent(*[jnp.zeros_like(offset)] * len(dataclasses.fields(ContactEvent)))
        ended = Shafts(
            driving.angle, driving.speed, offset, speed - base[1], none.side + FREE, flanks
        )
        return ended, none

    def push(self, depth: Any, rate: Any) -> Any:
        spring = self.stiffness * jnp.maximum(depth, 0.0)
        damping = 2 * self.damping_ratio * jnp.sqrt(self.stiffness * self.drag.inertia)
        return spring + jnp.clip(damping * rate, -spring, spring)

    def advanced(self, force: Callable[..., Any], speed: Any, step: Any) -> tuple[Any, Any]:
        raise NotImplementedError


class EulerPlant(SampledPlant):
    """Semi-implicit Euler."""

    def advanced(self, force: Callable[..., Any], speed: Any, step: Any) -> tuple[Any, Any]:
        speed = speed + step * force(0.0, jnp.zeros_like(speed), speed)
        return step * speed, speed


class RungeKuttaPlant(SampledPlant):
    """The classical fourth order."""

    def advanced(self, force: Callable[..., Any], speed: Any, step: Any) -> tuple[Any, Any]:
        a1 = force(0.0, jnp.zeros_like(speed), speed)
        v2 = speed + 0.5 * step * a1
        a2 = force(0.5, 0.5 * step * speed, v2)
        v3 = speed + 0.5 * step * a2
        a3 = force(0.5, 0.5 * step * v2, v3)
        v4 = speed + step * a3
        a4 = force(1.0, step * v3, v4)
        return (
            step / 6 * (speed + 2 * v2 + 2 * v3 + v4),
            speed + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4),
        )


def started(case: Case) -> Shafts:
    """In steady contact on flank A, half a second before the turn."""
    angle, speed, _ = case.contact.motion.at(case.times[0])
    offset, drift = case.contact.resting(case.times[0])
    flanks = case.bounds.at(jnp.asarray(angle))
    places = map(jnp.asarray, (angle, speed, float(offset), float(drift), ON_A))
    return Shafts(*places, flanks=flanks)


def random_rigs(count: int, seed: int) -> list[Case]:
    """Stiffness within a factor of 2.2, damping ratios and frictions of any common size."""
    generator = np.random.default_rng(seed)
    return [
        Case(
            stiffness=2.3e6 * math.exp(generator.uniform(-0.8, 0.8)),
            damping_ratio=float(generator.choice([0.02, 0.05, 0.1, 0.2, 0.4])),
            coulomb=float(generator.uniform(0.02, 0.12)),
            turn_deg=float(generator.uniform(400.0, 7560.0)),
        )
        for _ in range(count)
    ]
