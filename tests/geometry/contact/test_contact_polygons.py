"""First touch against two polygons that are turned until they meet: tip edges, eccentric gears.

Flanks are strings unwound from their base circles, sampled into polygons y(x). The driven gear is
turned by a root finder until the smallest distance along y of the two polygons is zero, for every
pair of teeth by itself. Nothing is known of lines of action, roll angles of contact or inv α.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import root_scalar

from vttig_jax.geometry.contact import Place, contact_model
from vttig_jax.geometry.contact_report import contact_at
from vttig_jax.pair.gear_pair import Eccentricities, Flank, Gear, GearPair, Rack

FLANKS: tuple[Flank, Flank] = ("A", "B")
_POINTS = 8001
_CLOSE = 5e-10
"""rad by which polygons of so many points stay behind their curves."""


@dataclass(frozen=True)
class Gears:
    """m = 2 mm, 20°; the tooth of a gear points along x, its thickness there is half a pitch."""

    teeth: tuple[int, int] = (45, 80)
    distance: float = 125.12
    addendum: float = 1.0
    offsets: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))

    def flank(self, gear: int) -> tuple[np.ndarray, np.ndarray]:
        """The flank at positive y, from the base circle to the tip."""
        reference = self.teeth[gear] * 1.0
        base = reference * math.cos(math.radians(20.0))
        last = math.sqrt(((reference + 2 * self.addendum) / base) ** 2 - 1)
        string = np.linspace(1e-3, last, _POINTS)
        # From the foot at bearing 0 the flank falls towards the middle of the tooth.
        x = base * (np.cos(string) + string * np.sin(string))
        y = base * (string * np.cos(string) - np.sin(string))
        at_reference = np.interp(reference, np.hypot(x, y), np.arctan2(y, x))
        half_a_tooth = math.pi / (2 * self.teeth[gear])
        return turned(x, y, half_a_tooth - at_reference)

    def touch(self, driving: float, side: int, standing: float = 0.0) -> float:
        """TE at first touch, the driven gear's zero turned by `standing`."""
        ratio, sense = self.teeth[0] / self.teeth[1], 1 - 2 * side
        nearest = round(driving * self.teeth[0] / (2 * math.pi))
        found = []
        for number in range(nearest - 2, nearest + 3):
            first = self._driving(driving, number, side)

            def distance(angle: float, number: int = number, first=first) -> float:
                second = self._driven(angle, standing, number + side, side)
                low = max(first[0].min(), second[0].min())
                high = min(first[0].max(), second[0].max())
                if low >= high:
                    return math.nan
                both = np.concatenate([first[0], second[0]])
                x = np.append(both[(both >= low) & (both <= high)], (low, high))
                gap = (np.interp(x, *second) - np.interp(x, *first)) * sense
                return float(gap.min())

            middle = ratio * driving + standing
            ends = [middle - 0.02 * sense, middle + 0.02 * sense]
            free, touching = (distance(end) for end in ends[::-1])
            if math.isnan(free * touching) or touching > 0:
                continue  # out of reach, or touched only by a driven gear far behind
            assert free > 0
            root = root_scalar(distance, bracket=ends, xtol=1e-14, rtol=1e-14).root
            found.append(root - ratio * driving)
        return max(found) if side == 0 else min(found)

    def _driving(self, angle: float, number: int, side: int):
        x, y = self.flank(0)
        tooth = angle - 2 * math.pi * number / self.teeth[0]
        x, y = turned(x, y if side == 0 else -y, tooth)
        e, phase = self.offsets[0]
        return _sorted(x + e * math.cos(angle + phase), y + e * math.sin(angle + phase))

    def _driven(self, angle: float, standing: float, number: int, side: int):
        x, y = self.flank(1)
        tooth = math.pi + standing - angle + 2 * math.pi * (number - 0.5) / self.teeth[1]
        x, y = turned(x, y if side == 0 else -y, tooth)
        e, phase = self.offsets[1]
        across = y - e * math.sin(angle + phase)
        return _sorted(x + self.distance + e * math.cos(angle + phase), across)

    def standing(self) -> float:
        """Turns the zero of φ₂ so that concentric gears touch at 0 where a flank is on the axes."""
        true = Gears(self.teeth, self.distance, self.addendum)
        x, y = true.flank(0)
        working = self.distance * self.teeth[0] / sum(self.teeth)
        angle = -float(np.interp(working, np.hypot(x, y), np.arctan2(y, x)))
        return -true.touch(angle, 0)


def turned(x, y, angle):
    cosine, sine = math.cos(angle), math.sin(angle)
    return x * cosine - y * sine, x * sine + y * cosine


def _sorted(x, y):
    """As a function of x."""
    return (x, y) if x[0] < x[-1] else (x[::-1], y[::-1])


def same_gears(gears: Gears) -> tuple[GearPair, Eccentricities]:
    pair = GearPair(
        *(Gear(count, face_width_mm=20.0) for count in gears.teeth),
        module_mm=2.0,
        pressure_angles_deg=20.0,
        centre_distance_mm=gears.distance,
        rack=Rack(addendum=gears.addendum),
    )
    (e1, phase1), (e2, phase2) = gears.offsets
    return pair, Eccentricities(e1, math.degrees(phase1), e2, math.degrees(phase2))


def model_of(gears: Gears):
    return contact_model(*same_gears(gears), sections=1)


PITCH = 2 * math.pi / 45
ANGLES = np.array([0.0, 0.11, 0.23, 0.36, 0.48, 0.61, 0.73, 0.88, 9.3, 313.4]) * PITCH
CASES = {
    "whole teeth": Gears(),
    "eccentric": Gears(offsets=((0.2, 1.0), (0.15, 2.0))),
    "short teeth": Gears(addendum=0.5),
    "short and eccentric": Gears(addendum=0.5, offsets=((0.05, 1.0), (0.06, 2.0))),
    "few teeth": Gears(teeth=(17, 20), distance=37.1, addendum=0.8, offsets=((0.01, 0), (0.02, 1))),
}


@pytest.mark.parametrize("flank", FLANKS)
@pytest.mark.parametrize("name", CASES)
def test_polygons_touch_where_the_surfaces_do(name, flank):
    gears = CASES[name]
    side, standing = "AB".index(flank), gears.standing()
    touched = [gears.touch(angle, side, standing) for angle in ANGLES]
    found = np.asarray(model_of(gears).transmission_error(ANGLES, flank))
    np.testing.assert_allclose(found, touched, rtol=0, atol=_CLOSE)
    (e, phase), driven = gears.offsets
    other = model_of(replace(gears, offsets=((e + 1e-5, phase), driven)))
    moved = np.abs(np.asarray(other.transmission_error(ANGLES, flank)) - touched).max()
    assert moved > 20 * _CLOSE  # the comparison can fail


def test_short_teeth_touch_at_their_tips():
    """Contact ratio 0.87: between two pairs on the flanks, first the one, then the other tip."""
    pair, _ = same_gears(CASES["short teeth"])
    assert 0.8 < float(pair.contact_ratios[0]) < 0.95
    angles = np.linspace(0.0, PITCH, 181)
    for flank in FLANKS:
        contacts = contact_at(contact_model(pair, sections=1), angles, flank, sections=1)
        places, error = contacts.place, contacts.transmission_error
        on_flank = places == Place.FLANK
        assert abs(on_flank.mean() - float(pair.contact_ratios[0])) < 0.02
        assert set(places) == {Place.FLANK, Place.DRIVING_TIP, Place.DRIVEN_TIP}
        rest = 0.0 if flank == "A" else float(pair.drawing_backlash)
        behind = (error - rest) * (1 if flank == "A" else -1)
        assert np.abs(behind[on_flank]).max() < 1e-14
        assert behind[~on_flank].max() < -1e-8 and behind.min() < -2e-6
        edge = contacts.radius_mm[places == Place.DRIVING_TIP, 0]
        np.testing.assert_allclose(edge, pair.tip_radii[0], rtol=1e-14)
        edge = contacts.radius_mm[places == Place.DRIVEN_TIP, 1]
        np.testing.assert_allclose(edge, pair.tip_radii[1], rtol=1e-12)
        inside = contacts.radius_mm[on_flank]
        assert (inside < np.asarray(pair.tip_radii) * (1 + 1e-12)).all()
