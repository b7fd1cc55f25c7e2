"""First contact of flanks with waves, against every point of both flanks in NumPy.

Waves make many hills of nearly the same height, so a search that stays on one of them may be late.
The brute force takes a dense grid of flank and face for every tooth pair and zooms into each hill
that comes close to the highest point; it follows no slope.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.deviations import Deviations, FlankMap
from vttig_jax.pair.gear_pair import Flank

TEETH, DISTANCE, WIDTH = (45, 80), 125.12, 20.0
BASE = tuple(count * math.cos(math.radians(20.0)) for count in TEETH)
PAIR = pair_of((0.0, 0.0), widths=(WIDTH, WIDTH), distance=DISTANCE)
PITCH = 2 * math.pi / TEETH[0]
MEASURED = {
    "whole": (33, 33, 10.0, ((3.0, 24.0), (12.0, 38.0))),
    "inner": (6, 5, 8.0, ((8.0, 20.0), (18.0, 32.0))),
}
"""Rows and columns of the maps, half their width, and their first and last rows, mm."""


pytestmark = pytest.mark.slow  # the brute force takes half a minute a map


def waves(random: np.random.Generator, measured: str) -> list[FlankMap]:
    """Of 1 to 10 µm, with 1 to 8 periods along the profile and along the face, on both gears."""
    rows, columns, half, spans = MEASURED[measured]
    maps = []
    for span in spans:
        along, across = 2 * math.pi * random.uniform(1, 8, 2)
        profile = np.linspace(0, along, rows) + random.uniform(0, 2 * math.pi)
        lead = np.linspace(0, across, columns) + random.uniform(0, 2 * math.pi)
        share, high = random.uniform(0, 1), random.uniform(1, 10)
        um = high * (share * np.sin(profile)[:, None] + (1 - share) * np.sin(lead))
        maps.append(FlankMap(np.linspace(*span, rows), np.linspace(-half, half, columns), um))
    return maps


def flat(maps: list[FlankMap]) -> list[FlankMap]:
    return [FlankMap(one.roll_mm, one.z_mm, np.zeros(one.deviation_um.shape)) for one in maps]


def first_contact(
    maps: list[FlankMap], angles: np.ndarray, flank: Flank, **grid: Any
) -> np.ndarray:
    """TE in rad; both flanks of a gear have the same map."""
    deviations = Deviations(*((one, one) for one in maps))
    model = contact_model(PAIR, deviations=deviations, **grid)
    return np.asarray(model.transmission_error(angles, flank))


@dataclass(frozen=True)
class EveryPoint:
    """Driven angle, in the sense in which the larger one touches first, over all points."""

    maps: list[FlankMap]
    sense: int

    @cached_property
    def splines(self) -> Any:
        return [RectBivariateSpline(one.roll_mm, one.z_mm, one.deviation_um) for one in self.maps]

    @cached_property
    def limits(self) -> np.ndarray:
        """Roll angles at the start of each flank and at its tip."""
        tips = [
            math.sqrt(((count + 2) / base) ** 2 - 1)
            for count, base in zip(TEETH, BASE, strict=True)
        ]
        starts = np.asarray(contact_model(PAIR).starts)[:, (1 - self.sense) // 2]
        return np.stack([starts, tips], axis=-1)

    def half(self, gear: int, roll: Any, z: Any) -> Any:
        alpha = math.radians(20.0)
        rolls, heights = (self.maps[gear].roll_mm, self.maps[gear].z_mm)
        inside = np.clip(BASE[gear] * roll, *rolls[[0, -1]]), np.clip(z, *heights[[0, -1]])
        moved = self.splines[gear].ev(*inside) * 1e-3 / BASE[gear]
        return math.pi / 2 / TEETH[gear] + math.tan(alpha) - alpha + moved

    def met(self, tooth: float, roll: Any, z: Any) -> tuple[Any, Any]:
        """Points of the driving flank from the driven axis, and the driven roll angles there."""
        turn = np.exp(1j * self.sense * (self.half(0, roll, z) - roll) + 1j * tooth)
        point = BASE[0] * (1 + 1j * self.sense * roll) * turn - DISTANCE
        return point, np.sqrt(np.maximum((np.abs(point) / BASE[1]) ** 2 - 1, 0.0))

    def span(self, tooth: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Driving roll angles between which the driven flank reaches from tip to start."""
        ends = []
        for side in (1, 0):
            low, high = (np.full(z.shape, end) for end in self.limits[0])
            for _ in range(52):
                middle = (low + high) / 2
                outside = self.met(tooth, middle, z)[1] > self.limits[1, side]
                low, high = np.where(outside, middle, low), np.where(outside, high, middle)
            ends.append(high if side else low)
        return ends[0], ends[1]

    def heights(self, tooth: float, share: np.ndarray, z: np.ndarray) -> np.ndarray:
        """At shares of the span and heights z, when the driving tooth has turned by an angle."""
        first, last = self.span(tooth, z)
        roll, z = np.broadcast_arrays(first + share[:, None] * (last - first), z)
        point, mate = self.met(tooth, roll, z)
        angle = self.half(1, mate, -z) - (mate - np.arctan(mate)) - self.sense * np.angle(-point)
        touches = np.abs(mate - np.clip(mate, *self.limits[1])) < 1e-12
        return np.where(touches, angle - self.sense * TEETH[0] / TEETH[1] * tooth, -np.inf)

    def highest(self, angle: float) -> float:
        turned = (angle + PITCH / 2) % PITCH - PITCH / 2
        return max(self.of_tooth(turned + number * PITCH) for number in (-1, 0, 1))

    def of_tooth(self, tooth: float) -> float:
        share, z = np.linspace(0.0, 1.0, 161), np.linspace(-WIDTH / 2, WIDTH / 2, 81)
        heights = self.heights(tooth, share, z)
        around = np.pad(heights, 1, constant_values=-np.inf)
        neighbours = [around[i : i + 161, j : j + 81] for i in range(3) for j in range(3)]
        hills = (heights >= np.max(neighbours, axis=0)) & (heights > heights.max() - 1e-5)
        return max(
            (self.zoomed(tooth, share[i], z[j]) for i, j in np.argwhere(hills)), default=-np.inf
        )

    def zoomed(self, tooth: float, share: Any, z: Any) -> float:
        best, wide, long = -np.inf, 1 / 160, WIDTH / 80
        for _ in range(48):
            steps = np.linspace(-1, 1, 15)
            shares = np.clip(share + wide * steps, 0.0, 1.0)
            rows = np.clip(z + long * steps, -WIDTH / 2, WIDTH / 2)
            heights = self.heights(tooth, shares, rows)
            first, second = np.unravel_index(np.argmax(heights), heights.shape)
            best = max(best, heights[first, second])
            share, z, wide, long = shares[first], rows[second], wide / 1.5, long / 1.5
        return best


def lateness(seed: int, measured: str, flank: Flank, count: int, **grid: Any) -> np.ndarray:
    """By how much the search is behind the brute force, rad of the driven gear."""
    random = np.random.default_rng(seed)
    maps = waves(random, measured)
    angles = random.uniform(-PITCH, PITCH, count)
    sense = 1 if flank == "A" else -1
    found = first_contact(maps, angles, flank, **grid) - first_contact(flat(maps), angles, flank)
    expected = np.array([EveryPoint(maps, sense).highest(angle) for angle in angles])
    return expected - EveryPoint(flat(maps), sense).highest(0.0) - sense * found


@pytest.mark.parametrize("flank", FLANKS)
@pytest.mark.parametrize("measured", MEASURED)
@pytest.mark.parametrize("seed", range(1))
def test_first_contact_is_the_highest_of_all_points(seed, measured, flank):
    late = lateness(10 * FLANKS.index(flank) + seed, measured, flank, 4)
    np.testing.assert_allclose(late, 0.0, atol=1e-10)


def test_the_middle_of_the_face_alone_is_late():
    late = lateness(0, "whole", "A", 4, sections=1)
    assert late.min() > -1e-10
    assert late.max() > 1e-7
