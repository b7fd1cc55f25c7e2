"""Error tables in LinuxCNC: it moves axes, and the exact gears say where they stand."""

from dataclasses import replace
from fractions import Fraction

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


def worm() -> AxisError:
    """A worm drive 1 : 90 with an error of 8″ once per turn of the worm."""
    ratio = float(Fraction(1, 90))

    def error(angle):
        return (8 * np.sin(angle) + 25 * np.sin(ratio * angle + 0.4)) * ARCSEC

    return AxisError({"A": error, "B": lambda angle: error(angle) + 40 * ARCSEC}, ratio, ratio)


PACE, STEADY_S = 120.0, 2.5
"""Speed of an axis over a turn, °/s; how long it must be seen there, of the 3 s of a turn."""

CASES = {
    "whole number": (gears(40, 80), 0.005, 0.0),
    "worm over a turn": (worm(), 0.10, 0.2),
    "45 / 80, its first turn": (gears(45, 80), 0.10, 0.2),
}


TURNS = 9
"""Turns of the driven gear of 45/80 until the same teeth meet."""


@pytest.fixture(scope="module")
def hunting():
    """Axes X, Y and Z, tables of them, and the fit of Z.

    X and Y are 45/80, with a table of nine turns and with the mean of all turns; Z is a pair with a
    whole-number ratio whose table comes from the fit of a noisy log of 20 turns each way. Its pitch
    errors are drawn: a fit that expects orders where there are none says too much of its noise.
    """
    axis = gears(45, 80)
    unknown = replace(axis, turns=tuple(range(TURNS)))
    pair = paper_like(40, 80)
    motion = PassMotion(speed_rpm=60.0, reversal_deg=20 * 360.0)
    noise = Noise(0.002, 0.00475)
    orders = random_orders(np.random.default_rng(0), pitch_rms_deg=0.002, mesh_amplitude_deg=0.0)
    rig = SyntheticRig(pair, paper_eccentricities(), motion, orders, noise=noise, rate_hz=500.0)
    fitted = axis_table(fit(rig.log(0), pair, delay="off"), None, AxisSetting())
    tables = [
        correction_table(axis, 0.0, TURNS * REV, TURNS * REV / 255),
        correction_table(unknown, 0.0, REV, REV / 255),
        fitted.table,
    ]
    return (axis, unknown, axis_of(rig.flank_model(), pair)), tables, fitted


REVERSALS, STILL_S = 50, 0.1
"""Random places at which the motor turns back, and how long it stands there at least, s."""


@pytest.fixture(scope="module")
def run(hunting, tmp_path_factory):
    """Tables of all axes, and their samples: a turn there and back, and reversals on the way.

    The axes of the cases are A, B and C. X makes its nine turns meanwhile.
    """
    tables = [correction_table(axis, 0.0, REV, REV / 255) for axis, *_ in CASES.values()]
    tables += hunting[1]
    ends = np.random.default_rng(7).uniform([150, 100], [200, 150], (REVERSALS // 2, 2)).round(3)
    to = lambda where: f"A{where} B{where} C{where}"  # noqa: E731
    feed = f"F{60 * PACE * (TURNS**2 + 2) ** 0.5:.1f}"  # of X, Y and Z together
    moves = [f"G1 {feed} {to(360)} X{TURNS * 360} Y360 Z360", "G4 P0.2"]
    moves += [f"G1 {feed} {to(0)} X0 Y0 Z0", "G4 P0.3"]
    moves += [move for end in ends.ravel() for move in (f"G0 {to(end)}", f"G4 P{STILL_S}")]
    texts = [linuxcnc(table, ("a test",)) for table in tables]
    return tables, moved(tmp_path_factory.mktemp("linuxcnc"), texts, moves)


@pytest.mark.parametrize("name", CASES)
def test_the_axis_stands_where_linuxcnc_was_told(run, name):
    tables, (command, motor, speed) = run
    place = list(CASES).index(name)
    (axis, share, least), table = CASES[name], tables[place].in_float32()
    asked, stood, pace = (values[:, place] for values in (command * DEG, motor * DEG, speed))
    steady = np.abs(np.abs(pace) - PACE) < 0.01
    found = {}
    for direction, flank in axis.directions.items():
        own = steady & (np.sign(pace) == (1 if direction == "forward" else -1))
        assert own.sum() * SERVO_S > STEADY_S
        left = stood[own] + axis.at(flank, stood[own]) - asked[own]
        before = size(left_over(axis, None, direction, asked[own])).rms
        promised = size(left_over(axis, table, direction, asked[own])).rms
        found[direction] = np.sqrt(np.mean(left**2))
        if least:
            assert abs(found[direction] - promised) < max(share * promised, least * ARCSEC)
        else:
            assert found[direction] < share * before


def test_no_motion_is_lost_at_reversals(run):
    _, (command, motor, speed) = run
    axis = CASES["whole number"][0]
    asked, stood, pace = command[:, 0] * DEG, motor[:, 0] * DEG, speed[:, 0]
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
    lost = np.sqrt(np.mean(np.square(left)))
    assert lost < 0.005 * np.sqrt(np.mean(np.square(gaps)))


def rests(samples, place: int, error: AxisError, pace: float):
    """Yield direction, commands and turn → what the exact gears leave there, at a steady pace."""
    asked, stood, speed = (values[:, place] for values in samples)
    for direction, flank in error.directions.items():
        sign = 1 if direction == "forward" else -1
        own = np.abs(speed - sign * pace) < 0.01
        assert own.sum() * SERVO_S > STEADY_S
        where, there = asked[own] * DEG, stood[own] * DEG
        left = [there + error.at(flank, there, turn) - where for turn in error.turns]
        yield direction, where, left


def test_a_table_of_nine_turns(hunting, run):
    ((axis, *_), (table, *_), _), (_, samples) = hunting, run
    for direction, where, (left,) in rests(samples, 3, axis, TURNS * PACE):
        promised = size(left_over(axis, table.in_float32(), direction, where)).rms
        assert abs(size(left).rms - promised) < max(0.1 * promised, 0.2 * ARCSEC)
        assert promised < 0.1 * size(left_over(axis, None, direction, where)).rms


def test_the_mean_curve_leaves_what_is_predicted_in_each_of_nine_turns(hunting, run):
    ((_, unknown, _), (_, table, _), _), (_, samples) = hunting, run
    for direction, where, left in rests(samples, 4, unknown, PACE):
        promised = left_over(unknown, table.in_float32(), direction, where)
        for found, expected in zip(left, promised, strict=True):
            off = abs(size(found).rms - size(expected).rms)
            assert off < max(0.1 * size(expected).rms, 0.2 * ARCSEC)
        # Orders of the driven gear alone are taken out.
        assert size(np.array(left)).rms < size(left_over(unknown, None, direction, where)).rms


def test_a_table_from_a_noisy_log_leaves_what_its_band_says(hunting, run):
    ((*_, truth), _, fitted), (_, samples) = hunting, run
    for direction, where, (left,) in rests(samples, 5, truth, PACE):
        low, high = fitted.after95[direction]
        assert low <= size(left).rms <= high
        assert size(left).rms < 0.05 * size(left_over(truth, None, direction, where)).rms


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
