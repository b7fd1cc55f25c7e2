"""Brute-force contact of sampled involutes: an oracle that knows no gear formula but the involute.

Both flanks of a tooth of each gear are curves built from their definition: a string unwinding from
the base circle, turned so that the tooth has its thickness at the reference circle. Gear 2 is a
rigid body on its axis O₂, so every point P of a flank of gear 1 that lies within its reach tells
the φ₂ at which gear 2's flank would pass through P. Gear 1 cannot pass through gear 2, so contact
is the extreme of those φ₂ over the flank and over all tooth pairs: the largest on flank A (gear 1
pushes), the smallest on flank B. The extreme is taken by sampling and then zooming. No working
pressure angle, no line of action, no conjugacy anywhere.

Standard teeth (half a pitch at the reference circle) are thinned, or thickened, flank by flank:
once so that without eccentricity flank A touches at φ₂ = 0 and flank B at φ₂ = j_c when φ₁ = 0 at
the nominal centre distance (found by the same search), and by s tan β for the axial shift.
"""

from dataclasses import dataclass, replace

import numpy as np

_SAMPLES = 257
_ZOOMS = 4
_NEIGHBOURS = np.arange(-3, 4)


@dataclass(frozen=True)
class Rig:
    """Two gears on axes O₁ = (0, 0) and O₂ = (centre_distance, 0); lengths mm, angles rad.

    `offsets` are the eccentricities (e, θ) of gear 1 and 2; `slopes` are tan β of flanks A and B.
    `addendum` is that of both gears in modules.
    """

    teeth: tuple[int, int]
    module: float
    pressure_angles: tuple[float, float]
    centre_distance: float
    offsets: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    constant_backlash: float = 0.0
    axial: float = 0.0
    slopes: tuple[float, float] = (0.0, 0.0)
    addendum: float = 1.0


def transmission_error(rig: Rig, driving_angle: float, flank: str) -> float:
    """TE = φ₂ − i φ₁ at first touch on `flank`, rad."""
    side = "AB".index(flank)
    # Whole teeth, which touch on their flanks there.
    centred = replace(rig, offsets=((0.0, 0.0), (0.0, 0.0)), addendum=1.0)
    wanted = rig.constant_backlash if side else 0.0
    sense = 1 - 2 * side
    thicker = sense * (wanted - _touch(centred, 0.0, side, 0.0))
    thicker += rig.axial * rig.slopes[side] / (rig.module * rig.teeth[1] / 2)
    return _touch(rig, driving_angle, side, thicker)


def _touch(rig: Rig, driving_angle: float, side: int, thicker: float) -> float:
    """Extreme of TE over the flank of gear 1 and all tooth pairs; `thicker`: rad of gear 2."""
    sense = 1 - 2 * side
    number = np.round(driving_angle * rig.teeth[0] / (2 * np.pi)) + _NEIGHBOURS
    low, high = 0.0, _roll_at(rig, 0, side, rig.module * (rig.teeth[0] / 2 + rig.addendum))
    roll = np.broadcast_to(np.linspace(low, high, _SAMPLES), (len(number), _SAMPLES))
    spacing = (high - low) / (_SAMPLES - 1)
    for zoom in range(_ZOOMS + 1):
        errors = _errors(rig, driving_angle, side, thicker, number[:, None], roll)
        scores = np.where(np.isnan(errors), -np.inf, sense * errors)
        if zoom == _ZOOMS:
            return float(sense * scores.max())
        best = np.take_along_axis(roll, scores.argmax(axis=1)[:, None], axis=1)
        roll = np.clip(best + spacing * np.linspace(-1, 1, 65), low, high)
        spacing /= 32
    raise AssertionError


def _errors(rig, driving_angle, side, thicker, number, roll):
    """TE at which gear 2's tooth passes through the points of gear 1's flank; NaN out of reach.

    Tooth `number` of gear 1 is the one that stands on the line of centres after so many pitches.
    """
    sense = 1 - 2 * side
    turned = driving_angle - 2 * np.pi * number / rig.teeth[0]
    eccentricity, phase = rig.offsets[0]
    point = eccentricity * np.exp(1j * (driving_angle + phase)) + np.exp(1j * turned) * _flank(
        rig, 0, side, roll, 0.0
    )
    from_axis = point - rig.centre_distance

    # Gear 2 in the frame of its own tooth, which points along +x; the body turns by −φ₂.
    standing = np.pi - sense * np.pi / rig.teeth[1]
    eccentricity, phase = rig.offsets[1]
    tooth = standing + 2 * np.pi * number / rig.teeth[1]
    centre = eccentricity * np.exp(-1j * (phase + tooth))
    reached = _meet_radius(rig, side, thicker, centre, np.abs(from_axis))
    bearing = np.angle(-from_axis) + np.pi
    return standing + np.angle(reached) - bearing - rig.teeth[0] / rig.teeth[1] * turned


def _meet_radius(rig, side, thicker, centre, radius):
    """Point of gear 2's flank at `radius` from O₂ by Newton's method; NaN beyond its ends."""
    base = _base_radius(rig, 1, side)
    with np.errstate(invalid="ignore", divide="ignore"):
        roll = np.sqrt((radius / base) ** 2 - 1)
        for _ in range(12):
            point = centre + _flank(rig, 1, side, roll, thicker)
            along = _flank_tangent(rig, 1, side, roll, thicker)
            slope = (np.conj(point) * along).real
            roll = roll - (np.abs(point) ** 2 - radius**2) / (2 * slope)
        point = centre + _flank(rig, 1, side, roll, thicker)
        last = _roll_at(rig, 1, side, rig.module * (rig.teeth[1] / 2 + rig.addendum))
        good = (np.abs(np.abs(point) - radius) < 1e-11 * radius) & (roll >= 0) & (roll <= last)
    return np.where(good, point, np.nan)


def _base_radius(rig: Rig, gear: int, side: int) -> float:
    return rig.module * rig.teeth[gear] / 2 * np.cos(rig.pressure_angles[side])


def _roll_at(rig: Rig, gear: int, side: int, radius: float) -> float:
    """String unwound where the flank reaches `radius`, in radians of the base circle."""
    return np.sqrt((radius / _base_radius(rig, gear, side)) ** 2 - 1)


def _start(rig: Rig, gear: int, side: int, thicker: float) -> complex:
    """Direction of the flank's first point, seen from the tooth's middle, times the base radius."""
    roll = _roll_at(rig, gear, side, rig.module * rig.teeth[gear] / 2)
    half = np.pi / (2 * rig.teeth[gear]) + thicker
    sense = 1 - 2 * side
    # At the reference circle the string has carried the flank round by this bearing.
    carried = np.angle(np.exp(1j * roll) * (1 - 1j * roll))
    return _base_radius(rig, gear, side) * np.exp(1j * sense * (half + carried))


def _flank(rig: Rig, gear: int, side: int, roll, thicker: float):
    """Flank of a tooth that points along +x: the left one (side 0) lies at positive y."""
    turn = -1j if side == 0 else 1j
    return _start(rig, gear, side, thicker) * np.exp(turn * roll) * (1 - turn * roll)


def _flank_tangent(rig: Rig, gear: int, side: int, roll, thicker: float):
    """Derivative of `_flank` with respect to the roll: the string's length, square to it."""
    turn = -1j if side == 0 else 1j
    return _start(rig, gear, side, thicker) * np.exp(turn * roll) * roll
