"""Error tables in LinuxCNC: it moves axes, and the exact gears say where they stand."""

from dataclasses import replace

import numpy as np
import pytest

from tests.control.compensation.linuxcnc import (
    HOME_HERE,
    SERVO_S,
    home_at,
    home_at_index,
    moved,
    why_not,
)
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.control.compensation.correction import (
    AxisError,
    CorrectionTable,
    Curve,
    correction_table,
    left_over,
    size,
)
from vttig_jax.control.compensation.table_formats import linuxcnc, read_linuxcnc
from vttig_jax.identify.identification import fit
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.flank_error import errors_at
from vttig_jax.kinematics.flank_model import FlankModel
from vttig_jax.pair.gear_pair import Eccentricities, Flank, Gear, GearPair
from vttig_jax.rig.imperfections import Noise, random_orders
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_eccentricities
from vttig_jax.rig.synthetic import SyntheticRig
from vttig_jax.runs.axis_table import AxisSetting, axis_table

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(why_not() is not None, reason=f"LinuxCNC: {why_not()}"),
]


def paper_like(driving_teeth: int, driven_teeth: int) -> GearPair:
    """The paper's gears with other teeth."""
    wheels = [Gear(teeth, 3.0, 3.0, 20.0) for teeth in (driving_teeth, driven_teeth)]
    distance = driving_teeth + driven_teeth + 0.12
    return GearPair(*wheels, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=distance)


def axis_of(model: FlankModel, pair: GearPair) -> AxisError:
    """The driven axis of a flank model, whose flank A has the mean zero."""
    ratio, turns = float(pair.ratio), pair.hunting_turns
    level = errors_at(model, "A", np.arange(4096 * turns) * (REV / 4096)).mean()

    def error_on(flank: Flank) -> Curve:
        return lambda angle: errors_at(model, flank, angle) - level

    return AxisError({"A": error_on("A"), "B": error_on("B")}, ratio, ratio)


def gears(
    driving_teeth: int, driven_teeth: int, eccentric: Eccentricities = paper_eccentricities()
) -> AxisError:
    """The axis of the paper's gears with other teeth and the exact relation of two involutes."""
    pair = paper_like(driving_teeth, driven_teeth)
    return axis_of(exact_model(pair, eccentric), pair)


PACE, STEADY_S = 120.0, 2.5
"""Speed of an axis over a turn, °/s; how long it must be seen there, of the 3 s of a turn."""
REVERSALS, STILL_S = 50, 0.1
"""Random places at which the motor turns back, and how long it stands there at least, s."""


@pytest.fixture(scope="module")
def fitted():
    """A pair with a whole-number ratio, whose table comes from a noisy log of 20 turns each way.

    Its pitch errors are drawn: a fit that expects orders where there are none says too much of its
    noise.
    """
    pair, motion = paper_like(40, 80), PassMotion(speed_rpm=60.0, reversal_deg=20 * 360.0)
    orders = random_orders(np.random.default_rng(0), pitch_rms_deg=0.002, mesh_amplitude_deg=0.0)
    noise = Noise(0.002, 0.00475)
    rig = SyntheticRig(pair, paper_eccentricities(), motion, orders, noise=noise, rate_hz=500.0)
    found = axis_table(fit(rig.log(0), pair, delay="off"), None, AxisSetting())
    return axis_of(rig.flank_model(), pair), found


@pytest.fixture(scope="module")
def run(fitted, tmp_path_factory):
    """Axes A, B and C, their tables and their samples: a turn there and back, then reversals.

    A has a whole-number ratio, B the mean of the nine turns of 45/80, C the fitted table.
    """
    axes = gears(40, 80), replace(gears(45, 80), turns=tuple(range(9))), fitted[0]
    tables = [correction_table(axis, 0.0, REV, REV / 255) for axis in axes[:2]] + [fitted[1].table]
    ends = np.random.default_rng(7).uniform([150, 100], [200, 150], (REVERSALS // 2, 2)).round(3)
    moves = [f"G1 F{60 * PACE * 3**0.5:.1f} A360 B360 C360", "G4 P0.2", "G1 A0 B0 C0", "G4 P0.3"]
    for end in ends.ravel():
        moves += [f"G0 A{end} B{end} C{end}", f"G4 P{STILL_S}"]
    texts = [linuxcnc(table, ("a test",)) for table in tables]
    samples = moved(tmp_path_factory.mktemp("linuxcnc"), texts, moves)
    tables = [table.in_float32() for table in tables]
    return [(*both, samples, place) for place, both in enumerate(zip(axes, tables, strict=True))]


def rests(axis: AxisError, table: CorrectionTable, samples, place: int):
    """What the exact gears leave at a steady pace: direction, in each turn, foreseen, untreated."""
    asked, stood, speed = (values[:, place] for values in samples)
    for direction, flank in axis.directions.items():
        own = np.abs(speed - (PACE if direction == "forward" else -PACE)) < 0.01
        assert own.sum() * SERVO_S > STEADY_S
        where, there = asked[own] * DEG, stood[own] * DEG
        left = [there + axis.at(flank, there, turn) - where for turn in axis.turns]
        yield direction, left, *(left_over(axis, one, direction, where) for one in (table, None))


def test_a_table_leaves_what_is_foreseen_in_each_turn(run):
    for axis in run[:2]:
        for _, left, foreseen, before in rests(*axis):
            for found, expected in zip(left, np.atleast_2d(foreseen), strict=True):
                most = max(0.1 * size(expected).rms, 0.2 * ARCSEC)
                assert abs(size(found).rms - size(expected).rms) < most
            assert size(np.array(left)).rms < (0.005 if axis is run[0] else 1.0) * size(before).rms


def test_no_motion_is_lost_at_reversals(run):
    axis, _, samples, _ = run[0]
    command, motor, pace = (values[:, 0] for values in samples)
    asked, stood = command * DEG, motor * DEG
    moving = np.flatnonzero(np.abs(pace) > 1e-6)
    ends = [*(moving[np.flatnonzero(np.diff(moving) > 50)]), moving[-1]][-REVERSALS:]
    sides = [np.sign(pace[end]) for end in ends]
    assert sides[1:] == [-side for side in sides[:-1]]
    left, gaps = [], []
    for end, side in zip(ends, sides, strict=True):
        still = slice(end + 70, end + 80)
        flank = axis.directions["forward" if side > 0 else "reverse"]
        left.append(np.mean(stood[still] + axis.at(flank, stood[still]) - asked[still]))
        where = np.atleast_1d(asked[end])
        gaps.append(float((axis.at("B", where) - axis.at("A", where))[0]))
    assert np.sqrt(np.mean(np.square(left))) < 0.005 * np.sqrt(np.mean(np.square(gaps)))


def test_a_table_from_a_noisy_log_leaves_what_its_band_says(fitted, run):
    for direction, (left,), _, before in rests(*run[2]):
        low, high = fitted[1].after95[direction]
        assert low <= size(left).rms <= high and size(left).rms < 0.05 * size(before).rms


def test_linuxcnc_reads_of_a_file_what_the_check_says(tmp_path):
    """A comment first, a blank line, and lines of the longest length and one character more."""
    rows = [f"{10 * k} 0.0{k} -0.0{k}" for k in range(1, 7)]
    long = [
        f"{row} ; ".ljust(length, "x") for row, length in zip(rows[2:4], (253, 254), strict=True)
    ]
    files = [["# angle", *rows], [*rows[:3], "", *rows[3:]], [*rows[:2], *long, *rows[4:]]]
    texts = ["\n".join([*lines, "70+.01-.02", "end"]) + "\n" for lines in files]
    moves = ["G1 F6000 A80 B80 C80", "G4 P0.2"]
    command, motor, speed = moved(tmp_path, texts, moves)
    steady = speed[:, 0] > 0.999 * speed[:, 0].max()
    assert steady.sum() > 500
    for text, rows, asked, stood in zip(texts, (0, 3, 4), command.T, motor.T, strict=True):
        held = read_linuxcnc(text).rows
        assert len(held) == rows
        added = np.interp(asked[steady], held[:, 0], held[:, 1]) if rows else 0.0
        np.testing.assert_allclose(stood[steady] - asked[steady], added, atol=2e-6)


SWITCH = 10.0
"""Where the motor trips the switch of an axis, °."""


def test_where_an_axis_is_that_is_homed_with_its_table(tmp_path):
    """The table acts before homing too, and what it adds then goes into the zero.

    An axis with a switch is at the place of its switch when it latches it, however it came there.
    One that is homed where it stands has what the table adds at its position before. With an index
    the encoder alone says where the axis is: the table adds nothing to the zero.
    """
    error = gears(40, 80)
    table = correction_table(error, -0.5 * REV, 0.5 * REV, REV / 255).in_float32()

    def added(position: float) -> float:
        return float(table.at("forward", np.radians([position]))[0]) / DEG

    offset = SWITCH - added(SWITCH)
    here = added(-17.3) - added(0.0)  # where the mark is then
    again = [f"G0 B{here - 1:.6f}", f"G1 F600 B{here:.6f}", "G4 P0.2", "HOME"]
    to, stop = "G0 A20 B20 C20", "G4 P0.3"
    moves = ["HOME", to, stop, "JOG -37.3", "HOME", to, stop, *again, to, stop]
    homing = [home_at(SWITCH, offset), HOME_HERE, home_at_index(5.0)]
    command, motor, speed = moved(tmp_path, [linuxcnc(table, ())] * 3, moves, homing)
    still = np.all(speed == 0.0, axis=1) & np.all(np.abs(command - 20) < 1e-9, axis=1)
    ends = np.append(np.flatnonzero(np.diff(np.flatnonzero(still)) > 1), -1)
    switch, mark, index = motor[np.flatnonzero(still)[ends]].T
    assert len(switch) == 3
    # The axis with the switch stands where the motor is as its table says, within a period's way.
    np.testing.assert_allclose(switch, 20 + added(20), atol=1.0 / 3600)
    np.testing.assert_allclose(index, 20 + added(20) - 5.0, atol=0.01 / 3600)
    place = 20 + added(20) - 37.3 + added(-17.3) - added(20)
    right = place + 20 + added(20) - added(0)
    off = added(-17.3) - added(0)
    assert abs(off) > 20 / 3600
    assert mark[1] - right == pytest.approx(-off, abs=0.5 / 3600)
    assert mark[2] - right == pytest.approx(0.0, abs=0.5 / 3600)
