"""First touches of two tooth surfaces per second, beside the same search written in NumPy.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 taskset -c 0 python -m benchmarks.contact_speed

The gears of the paper with the eccentricities of Table 2 and an axial shift, flank A, over the
hunting period. Both ways look at three pairs of teeth and nine roll angles on each, climb from the
best of them (by Newton's and by the secant method), stay within both flanks and take the first of
all touches. No row is timed before it agrees with the exact relation. Rounds alternate. Writes
results/contact_speed.json.
"""

import argparse
import math
import statistics
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import vttig_jax
from vttig_jax.geometry.contact import ContactModel, contact_model, mates_on
from vttig_jax.geometry.contact_report import contact_at
from vttig_jax.geometry.mounting import Misalignment
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig.paper import paper_pair

from .environment import write

ANGLES = 65_536
CLOSE = 1e-12
"""rad by which a search may differ from the exact relation."""

_CLIMBS, _STEPS, _POINTS, _PAIRS = 8, 6, 9, 3
_AT_ONCE = 4096
"""Angles that NumPy takes at once; from 512 to 16 384 it makes a tenth of difference."""


@dataclass(frozen=True)
class NumPySearch:
    """Flank A in the section z = 0 on parallel axes, all in complex numbers.

    **Arguments**
    - `base`, `start`, `tip`, `foot`: of both gears: base radius, roll angles at the ends of the
      flank, and the angle from the centre line of the tooth to the foot of the involute.
    - `offsets`: e·exp(jθ) of both base circles.
    - `middle`: angle of the driving tooth in the middle of the path of contact.
    - `standing`: zero of φ₂.
    """

    ratio: float
    pitch: float
    distance: float
    base: tuple[float, float]
    start: tuple[float, float]
    tip: tuple[float, float]
    foot: tuple[float, float]
    offsets: tuple[complex, complex]
    middle: float
    standing: float

    def reach(self, roll, turned, centres):
        """TE at which the driven flank passes through a point, that point, its change, its roll."""
        arm = np.exp(1j * (turned + self.foot[0] - roll))
        point = centres[0] + self.base[0] * (1 + 1j * roll) * arm - self.distance - centres[1]
        mate = np.sqrt(np.maximum(np.abs(point) ** 2 / self.base[1] ** 2 - 1, 0.0))
        angle = self.standing + self.foot[1] - mate + np.arctan(mate) - np.angle(-point)
        return angle - self.ratio * turned, point, self.base[0] * roll * arm, mate

    def change(self, point, by, mate):
        """Of TE and of the radius on the driven gear where the point moves."""
        outward = (np.conj(point) * by).real
        unwound = outward / self.base[1] ** 2 * mate / (1 + mate**2)
        return -unwound - (by / point).imag, outward / np.abs(point)

    def settled(self, roll, turned, centres, guess):
        """TE and radius with the driven centre moved to where it is at that TE."""
        error, point, _, mate = self.reach(roll, turned, centres)
        lag, drift = self.change(point, 1j * centres[1], mate)
        off = (error - guess) / (1 - lag)
        return guess + off, np.abs(point) + drift * off

    def slopes(self, roll, turned, centres, guess):
        """Change of TE and of the radius with the roll angle."""
        _, point, along, mate = self.reach(roll, turned, centres)
        return self.change(point, along, mate)

    def transmission_error(self, driving):
        """At any number of driving angles."""
        pieces = np.array_split(driving, -(-len(driving) // _AT_ONCE))
        return np.concatenate([self._some(piece) for piece in pieces])

    def _some(self, driving):
        nearest = np.floor((driving - self.middle) / self.pitch + 0.5)
        turned = driving - (nearest + np.arange(-1, _PAIRS - 1)[:, None]) * self.pitch
        centres = (
            self.offsets[0] * np.exp(1j * driving),
            np.conj(self.offsets[1] * np.exp(1j * self.ratio * driving)),
        )
        scene = turned, centres, 0.0
        low, high = self.start[0], self.tip[0]
        spacing = (high - low) / (_POINTS - 1)
        grid = low + spacing * np.arange(_POINTS)[:, None, None]
        error, radius = self.settled(grid, *scene)
        ends = [self.base[1] * math.sqrt(1 + end**2) for end in (self.start[1], self.tip[1])]
        beside = np.maximum(radius - ends[1], ends[0] - radius)
        height = np.where(beside > 0, -1e6 - beside, error)
        begin = low + spacing * np.argmax(height, axis=0)
        limits = np.maximum(begin - spacing, low), np.minimum(begin + spacing, high)
        roll = self._climbed(begin, *limits, scene)
        roll = self._within_mate(roll, ends, scene)
        error, radius = self.settled(roll, *scene)
        inside = np.minimum(np.maximum(radius, ends[0]), ends[1])
        error = np.where(np.abs(radius - inside) > 1e-9 * ends[1], -np.inf, error)
        best = np.argmax(error, axis=0)[None]
        roll, turned = (np.take_along_axis(values, best, 0)[0] for values in (roll, turned))
        found = np.take_along_axis(error, best, 0)[0]
        for _ in range(3):
            centre = np.conj(self.offsets[1] * np.exp(1j * (self.ratio * driving + found)))
            found = self.reach(roll, turned, (centres[0], centre))[0]
        return found

    def _climbed(self, roll, low, high, scene):
        rise = self.slopes(roll, *scene)[0]
        bend = np.full_like(roll, np.nan)
        for _ in range(_CLIMBS - 1):
            low, high = np.where(rise > 0, roll, low), np.where(rise < 0, roll, high)
            hollow = ~(bend < 0)
            uphill = np.where(rise > 0, roll + high, roll + low) / 2
            secant = np.clip(roll - rise / np.where(hollow, 1.0, bend), low, high)
            ahead = np.where(hollow, uphill, secant)
            slope, moved = self.slopes(ahead, *scene)[0], ahead - roll
            far = np.abs(moved) > 1e-5
            bend = np.where(far, (slope - rise) / np.where(far, moved, 1.0), bend)
            roll, rise = ahead, slope
        return roll

    def _within_mate(self, roll, ends, scene):
        radius = self.settled(roll, *scene)[1]
        goal = np.minimum(np.maximum(radius, ends[0]), ends[1])
        for _ in range(_STEPS):
            radius, slope = self.settled(roll, *scene)[1], self.slopes(roll, *scene)[1]
            step = (radius - goal) / np.where(slope == 0, 1.0, slope)
            roll = np.clip(roll - step, self.start[0], self.tip[0])
        return roll


def numpy_search(model: ContactModel) -> NumPySearch:
    """The numbers of a model on flank A."""
    mates, mounting = mates_on(model, 0), model.mounting
    gears = mates.driving, mates.driven
    z = np.array([0.0, -float(mounting.axial)])
    feet = [
        float(gear.base_half_angle) - float(gear.recession(height)) / float(gear.reference_radius)
        for gear, height in zip(gears, z, strict=True)
    ]
    base, start, tip = (
        tuple(float(getattr(gear, name)) for gear in gears)
        for name in ("base_radius", "start", "tip")
    )
    distance = float(mounting.centre_distance)
    alpha = math.acos(sum(base) / distance)
    roll = math.tan(alpha)
    middle = roll - alpha - feet[0]
    middle += (tip[0] - roll - (tip[1] - roll) * base[1] / base[0]) / 2
    return NumPySearch(
        ratio=float(model.ratio),
        pitch=float(mates.pitch),
        distance=distance,
        base=(base[0], base[1]),
        start=(start[0], start[1]),
        tip=(tip[0], tip[1]),
        foot=(feet[0], feet[1]),
        offsets=(complex(mounting.driving_offset), complex(mounting.driven_offset)),
        middle=middle,
        standing=float(mates.standing),
    )


def seconds(run) -> tuple[float, Any]:
    start = time.perf_counter()
    result = run()
    return time.perf_counter() - start, result


def measure(rounds: int) -> dict[str, Any]:
    """Medians of alternating rounds, after one that compiles."""
    vttig_jax.enable_x64()
    pair = paper_pair()
    drawn = math.degrees(float(pair.drawing_backlash))
    rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, drawn, 0.2)
    driving = np.linspace(0.0, 2 * math.pi * pair.hunting_turns, ANGLES)
    model, tilt = contact_model(pair, rig), Misalignment(1e-4, -2e-4)
    tilted, search = contact_model(pair, rig, misalignment=tilt), numpy_search(model)
    few = driving[:: ANGLES // 4096]
    runs = {
        "numpy": (ANGLES, lambda: search.transmission_error(driving)),
        "one section": (ANGLES, lambda: np.asarray(model.transmission_error(driving, "A"))),
        "tilted, nine sections": (
            len(few),
            lambda: np.asarray(tilted.transmission_error(few, "A")),
        ),
        "report of it": (len(few), lambda: contact_at(tilted, few, "A").transmission_error),
    }
    first = {name: seconds(run) for name, (_, run) in runs.items()}
    exact = np.asarray(exact_model(pair, rig).transmission_error(driving, "A"))
    apart = {name: float(np.abs(first[name][1] - exact).max()) for name in ("numpy", "one section")}
    if max(apart.values()) > CLOSE:
        raise SystemExit(f"The searches differ from the exact relation: {apart}")
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, (count, run) in runs.items():
            times[name].append(1e6 * seconds(run)[0] / count)
    median = {name: statistics.median(values) for name, values in times.items()}
    pairs = zip(times["numpy"], times["one section"], strict=True)
    return {
        "angles": {name: count for name, (count, _) in runs.items()},
        "rounds": rounds,
        "apart_from_the_exact_relation_rad": apart,
        "us_per_contact": {name: round(value, 3) for name, value in median.items()},
        "contacts_per_second": {name: round(1e6 / value) for name, value in median.items()},
        "numpy_over_one_section": round(statistics.median(a / b for a, b in pairs), 2),
        "first_call_s": {name: round(taken, 2) for name, (taken, _) in first.items()},
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    record = measure(parser.parse_args().rounds)
    write("contact_speed.json", record)
    for key, value in record["us_per_contact"].items():
        print(f"{key:24} {value:8.3f} µs a contact, first call {record['first_call_s'][key]} s")
    print(f"NumPy over one section: {record['numpy_over_one_section']}")
