"""Contact of gears on axes that are not parallel, against surfaces moved in space until they touch.

The driven surface is sampled as points, turned about its own tilted axis by SciPy's rotations to
the angle that is found, and its distance from the driving surface is taken along y. Flanks are
strings unwound from base circles. The smallest distance, which has to vanish, is found by zooming
into a box of flank and face.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.contact_report import contact_at
from vttig_jax.geometry.mounting import Misalignment
from vttig_jax.pair.gear_pair import Eccentricities

TEETH = (45, 80)
BASE = tuple(count * math.cos(math.radians(20.0)) for count in TEETH)


@dataclass(frozen=True)
class Case:
    """The paper's gears; crowning in mm, widths b₁ and b₂, tilt (ι, η) in rad."""

    tilt: tuple[float, float]
    crowning: tuple[float, float] = (0.0, 0.0)
    widths: tuple[float, float] = (20.0, 20.0)
    axial: float = 0.0
    helix: float = 3.0
    offsets: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))

    def recession(self, gear: int, z):
        share = 2 * z / self.widths[gear]
        return z * math.tan(math.radians(self.helix)) + self.crowning[gear] * share**2

    def flank(self, gear: int, string, z, side: int):
        """In the frame of a tooth along x, z towards its thin end; side 0 lies at positive y."""
        base, reference = BASE[gear], float(TEETH[gear])
        tangent = math.tan(math.radians(20.0))
        bearing = math.atan(tangent) - tangent  # of the flank at R, seen from its foot
        foot = (math.pi / 2 - self.recession(gear, z)) / reference - bearing
        x = base * (np.cos(foot - string) - string * np.sin(foot - string))
        y = base * (np.sin(foot - string) + string * np.cos(foot - string))
        return x, y if side == 0 else -y

    def driving_y(self, angle: float, number: int, side: int, x, z):
        """y of the driving flank over x and z, by Newton's method along the string; NaN off it."""
        string = np.full(x.shape, 0.36)
        for _ in range(12):
            there = self.driving(angle, number, side, string, z)[0]
            ahead = self.driving(angle, number, side, string + 1e-6, z)[0]
            string = string - (there - x) / (ahead - there) * 1e-6
        y = self.driving(angle, number, side, string, z)[1]
        return np.where(string**2 <= (47.0 / BASE[0]) ** 2 - 1, y, np.nan)

    def driving(self, angle: float, number: int, side: int, string, z):
        x, y = self.flank(0, string, z, side)
        tooth = angle - 2 * math.pi * number / TEETH[0]
        e, phase = self.offsets[0]
        turn = complex(math.cos(tooth), math.sin(tooth))
        point = (x + 1j * y) * turn + e * np.exp(1j * (angle + phase))
        return point.real, point.imag

    def driven(self, angle: float, standing: float, number: int, side: int, string, own_z):
        """Points in space; the gear is mounted the other way round."""
        x, y = self.flank(1, string, own_z, side)
        tooth = math.pi + standing - 2 * math.pi * (0.5 - number) / TEETH[1]
        e, phase = self.offsets[1]
        body = (x + 1j * y) * np.exp(1j * tooth) + e * np.exp(-1j * phase)
        points = np.stack([body.real, body.imag, -own_z], axis=-1)
        axis = np.array([math.tan(self.tilt[0]), math.tan(self.tilt[1]), 1.0])
        axis /= np.linalg.norm(axis)
        sine = np.linalg.norm(axis[:2])
        lean = np.array([-axis[1], axis[0], 0.0]) / (sine or 1.0) * math.asin(sine)
        moved = Rotation.from_rotvec(lean) * Rotation.from_rotvec([0.0, 0.0, -angle])
        flat = moved.apply(points.reshape(-1, 3)).reshape(points.shape)
        return flat + np.array([125.12, 0.0, -self.axial])

    def own_height(self, angle, standing, number, side, string, share):
        """Own z at a share of the common face, found in space."""
        own = self.widths[1] / 2 + 0 * string
        ends = []
        for limit in (-self.widths[0] / 2, self.widths[0] / 2):
            for _ in range(8):
                z = self.driven(angle, standing, number, side, string, own)[..., 2]
                own = own + (z - limit)
            ends.append(np.clip(own, -self.widths[1] / 2, self.widths[1] / 2))
        return ends[0] + share * (ends[1] - ends[0])

    def distance(self, driving: float, angle: float, standing: float, number: int, side: int):
        """Smallest distance along y between the flanks of one pair of teeth."""
        tip = math.sqrt((82.0 / BASE[1]) ** 2 - 1)
        low, high = np.array([0.15, 0.0]), np.array([tip, 1.0])
        best = math.inf
        for _ in range(7):
            string, share = np.meshgrid(
                *(np.linspace(a, b, 17) for a, b in zip(low, high, strict=True)), indexing="ij"
            )
            own = self.own_height(angle, standing, number + side, side, string, share)
            x, y, z = np.moveaxis(
                self.driven(angle, standing, number + side, side, string, own), -1, 0
            )
            gap = (y - self.driving_y(driving, number, side, x, z)) * (1 - 2 * side)
            gap = np.where(np.isnan(gap), math.inf, gap)
            place = np.unravel_index(np.argmin(gap), gap.shape)
            best = min(best, float(gap[place]))
            centre = np.array([string[place], share[place]])
            half = (high - low) / 5
            low = np.maximum(centre - half, [0.15, 0.0])
            high = np.minimum(centre + half, [tip, 1.0])
        return best


CASES = {
    "inclined": Case((1e-3, 0.0)),
    "out of plane": Case((0.0, -8e-4), axial=0.4),
    "both, narrow driving gear": Case((6e-4, 5e-4), widths=(12.0, 20.0)),
    "narrow driven gear": Case((6e-4, 5e-4), widths=(20.0, 14.0)),
    "crowned": Case((2e-4, 3e-4), crowning=(0.012, 0.008), axial=0.2),
    "untapered, eccentric": Case(
        (0.0, 5e-4), helix=0.0, crowning=(0.01, 0.0), offsets=((0.05, 1.0), (0.04, 2.0))
    ),
}
ANGLES = np.array([0.06, 0.0, 0.03, 0.09, 0.12])
"""Of the driving gear, within a pitch."""


def same_gears(case: Case):
    crowning = 1e3 * case.crowning[0], 1e3 * case.crowning[1]
    pair = pair_of((case.helix, case.helix), crowning, case.widths)
    (e1, phase1), (e2, phase2) = case.offsets
    rig = Eccentricities(e1, math.degrees(phase1), e2, math.degrees(phase2), axial_mm=case.axial)
    return contact_model(pair, rig, misalignment=Misalignment(*case.tilt), sections=9)


@pytest.mark.slow
@pytest.mark.parametrize("flank", FLANKS)
@pytest.mark.parametrize("name", CASES)
def test_surfaces_in_space_touch_at_the_same_angle(name, flank):
    case, side, ratio = CASES[name], FLANKS.index(flank), TEETH[0] / TEETH[1]
    angle, standing = ANGLES[0], float(pair_of().drawing_backlash) / 2

    def apart(case_found: Case) -> float:
        """Smallest distance of all pairs of teeth where first contact of a case is found, mm."""
        error = float(same_gears(case_found).transmission_error(ANGLES, flank)[0])
        turned = ratio * angle + error
        return min(case.distance(angle, turned, standing, number, side) for number in (-1, 0, 1))

    assert abs(apart(case)) < 1e-9 * BASE[1]
    tilt = tuple(slope + 1e-6 for slope in case.tilt)
    assert abs(apart(replace(case, tilt=tilt))) > 3e-9 * BASE[1]  # a microradian is seen


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [(1e-5, 0.0), (0.0, 1e-5), (-1e-5, 2e-5)])
def test_small_tilts_by_first_order(tilt):
    """Sections of the driven gear move by (ι, η) ζ across the axes; the nearest ones touch."""
    alpha = math.acos(sum(BASE) / 125.12)
    tilted, straight = (same_gears(Case(slopes, helix=0.0)) for slopes in (tilt, (0.0, 0.0)))
    for side, flank in enumerate(FLANKS):
        sense = 1 - 2 * side
        across = tilt[0] * math.sin(alpha) + sense * tilt[1] * math.cos(alpha)
        moved = (
            np.asarray(model.transmission_error(ANGLES, flank)) for model in (tilted, straight)
        )
        found = np.subtract(*moved) * sense
        np.testing.assert_allclose(found, abs(across) * 10.0 / BASE[1], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tilt", "ends"),
    [
        ((1e-4, 0.0), {"A": "lower", "B": "lower"}),
        ((-1e-4, 0.0), {"A": "upper", "B": "upper"}),
        ((0.0, 1e-4), {"A": "lower", "B": "upper"}),
    ],
)
def test_tilted_flanks_touch_at_an_end_of_the_face(tilt, ends):
    """Where the axes come nearer, and out of plane at opposite ends on both flanks."""
    for flank in FLANKS:
        contacts = contact_at(same_gears(Case(tilt)), ANGLES, flank)
        assert contacts.kind(0) == f"point, flank, {ends[flank]} end of the face"
        assert abs(contacts.z_mm[0]) == pytest.approx(10.0, abs=0.02)
        assert contacts.section_misfit[0].max() > 1e-6


@pytest.mark.slow
def test_crowning_keeps_contact_off_the_ends():
    contacts = contact_at(same_gears(CASES["crowned"]), ANGLES, "A")
    assert contacts.kind(0) == "point, flank"
    assert 0.5 < abs(contacts.z_mm[0]) < 9.0
