"""First contact of flanks with waves: no point of both flanks lies beyond it.

Waves make many hills of nearly the same height, so a search that stays on one of them may be late.
The points are those of a dense grid in NumPy; between them a finer grid of the search is asked.
"""

import math
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.deviations import Deviations, FlankMap

TEETH, DISTANCE = (45, 80), 125.12
BASE = tuple(count * math.cos(math.radians(20.0)) for count in TEETH)
PAIR = pair_of((0.0, 0.0), distance=DISTANCE)
PITCH = 2 * math.pi / TEETH[0]
MEASURED = {
    "whole": (33, 33, 10.0, ((3.0, 24.0), (12.0, 38.0))),
    "inner": (6, 5, 8.0, ((8.0, 20.0), (18.0, 32.0))),
}
"""Rows and columns of the maps, half their width, and their first and last rows, mm."""

pytestmark = pytest.mark.slow


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


def highest(maps, sense: int, tooth: float, roll: np.ndarray, z: np.ndarray) -> float:
    """Largest σ φ₂ − i σ φ₁ over points of a driving tooth that has turned by an angle, rad."""
    alpha = math.radians(20.0)

    def half(gear: int, roll: np.ndarray, z: np.ndarray) -> np.ndarray:
        plain = math.pi / 2 / TEETH[gear] + math.tan(alpha) - alpha
        if maps is None:
            return np.full(roll.shape, plain)
        rolls, heights, um = maps[gear].roll_mm, maps[gear].z_mm, maps[gear].deviation_um
        inside = np.clip(BASE[gear] * roll, *rolls[[0, -1]]), np.clip(z, *heights[[0, -1]])
        return plain + RectBivariateSpline(rolls, heights, um).ev(*inside) * 1e-3 / BASE[gear]

    roll, z = (axis.ravel() for axis in np.meshgrid(roll, z, indexing="ij"))
    turn = np.exp(1j * sense * (half(0, roll, z) - roll) + 1j * tooth)
    point = BASE[0] * (1 + 1j * sense * roll) * turn - DISTANCE  # from the driven axis
    mate = np.sqrt(np.maximum((np.abs(point) / BASE[1]) ** 2 - 1, 0.0))
    angle = half(1, mate, -z) - (mate - np.arctan(mate)) - sense * np.angle(-point)
    start, tip = contact_model(PAIR).starts[1, (1 - sense) // 2], rolls_at_tips()[1]
    touches = (mate >= start) & (mate <= tip)
    return float(np.where(touches, angle - sense * TEETH[0] / TEETH[1] * tooth, -np.inf).max())


def rolls_at_tips() -> list[float]:
    return [math.sqrt(((n + 2) / base) ** 2 - 1) for n, base in zip(TEETH, BASE, strict=True)]


@pytest.mark.parametrize("flank", FLANKS)
@pytest.mark.parametrize("measured", MEASURED)
def test_first_contact_is_the_highest_of_all_points(measured, flank):
    side, sense = FLANKS.index(flank), 1 - 2 * FLANKS.index(flank)
    random = np.random.default_rng(10 * side)
    maps = waves(random, measured)
    angles = random.uniform(-PITCH, PITCH, 4)
    drawn = side * float(PAIR.drawing_backlash)

    def found(**grid: Any) -> np.ndarray:
        model = contact_model(PAIR, deviations=Deviations(*((m, m) for m in maps)), **grid)
        return sense * (np.asarray(model.transmission_error(angles, flank)) - drawn)

    first = found()
    np.testing.assert_allclose(first, found(points=81, sections=41), rtol=0, atol=1e-10)
    if (measured, flank) == ("whole", "A"):
        assert (first - found(sections=1)).max() > 1e-7  # the middle of the face alone is late
    ends = np.asarray(contact_model(PAIR).starts)[0, side], rolls_at_tips()[0]
    plain = highest(None, sense, 0.0, np.linspace(*ends, 200_001), np.zeros(1))
    turned = (angles + PITCH / 2) % PITCH - PITCH / 2
    grid = np.linspace(*ends, 401), np.linspace(-10.0, 10.0, 201)
    every = [max(highest(maps, sense, at + k * PITCH, *grid) for k in (-1, 0, 1)) for at in turned]
    beyond = np.array(every) - plain - first
    # First contact lies between points of the grid, at a tip edge up to a spacing beyond the last.
    assert beyond.max() < 1e-10 and beyond.min() > -3e-6
