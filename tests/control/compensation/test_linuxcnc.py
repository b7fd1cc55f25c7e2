"""Error tables in LinuxCNC: it moves axes, and the exact gears say where they stand."""

from fractions import Fraction

import numpy as np
import pytest

from tests.control.compensation.linuxcnc import moved, why_not
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.control.compensation.correction import (
    AxisError,
    Curve,
    correction_table,
    left_over,
    size,
)
from vttig_jax.control.compensation.table_formats import linuxcnc
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.flank_error import errors_at
from vttig_jax.pair.gear_pair import Flank, Gear, GearPair
from vttig_jax.rig.paper import paper_eccentricities

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(why_not() is not None, reason=f"LinuxCNC: {why_not()}"),
]


def gears(driving_teeth: int, driven_teeth: int) -> AxisError:
    """The axis of the paper's gears with other teeth and the exact relation of two involutes."""
    wheels = [Gear(teeth, 3.0, 3.0, 20.0) for teeth in (driving_teeth, driven_teeth)]
    distance = driving_teeth + driven_teeth + 0.12
    pair = GearPair(*wheels, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=distance)
    model, ratio = exact_model(pair, paper_eccentricities()), float(pair.ratio)
    level = errors_at(model, "A", np.linspace(0, REV * driven_teeth, 4096)).mean()

    def error_on(flank: Flank) -> Curve:
        return lambda angle: errors_at(model, flank, angle) - level

    return AxisError({"A": error_on("A"), "B": error_on("B")}, ratio, ratio)


def worm() -> AxisError:
    """A worm drive 1 : 90 with an error of 8″ once per turn of the worm."""
    ratio = float(Fraction(1, 90))

    def error(angle):
        return (8 * np.sin(angle) + 25 * np.sin(ratio * angle + 0.4)) * ARCSEC

    return AxisError({"A": error, "B": lambda angle: error(angle) + 40 * ARCSEC}, ratio, ratio)


CASES = {
    "whole number": (gears(40, 80), 0.005, 0.0),
    "worm over a turn": (worm(), 0.10, 0.2),
    "45 / 80, its first turn": (gears(45, 80), 0.10, 0.2),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Tables of the cases, and the samples of one turn there and back with stops on the way."""
    tables = [correction_table(axis, 0.0, REV, REV / 255) for axis, *_ in CASES.values()]
    stops = np.random.default_rng(7).uniform(100, 200, 16).round(3)
    to = lambda where: f"A{where} B{where} C{where}"  # noqa: E731
    feed = f"F{60 * 30 * 3**0.5:.1f}"  # 30 °/s of each axis
    moves = [f"G1 {feed} {to(360)}", f"G1 {feed} {to(0)}", "G4 P0.3"]
    moves += [move for stop in stops for move in (f"G0 {to(stop)}", "G4 P0.3")]
    texts = [linuxcnc(table, ("a test",)) for table in tables]
    return tables, moved(tmp_path_factory.mktemp("linuxcnc"), texts, moves)


@pytest.mark.parametrize("name", CASES)
def test_the_axis_stands_where_linuxcnc_was_told(run, name):
    tables, (command, motor, speed) = run
    place = list(CASES).index(name)
    (axis, share, least), table = CASES[name], tables[place].in_float32()
    asked, stood, pace = (values[:, place] for values in (command * DEG, motor * DEG, speed))
    steady = np.abs(np.abs(pace) - 30.0) < 0.01
    found = {}
    for direction, flank in axis.directions.items():
        own = steady & (np.sign(pace) == (1 if direction == "forward" else -1))
        assert own.sum() > 5000
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
    ends = [*(moving[np.flatnonzero(np.diff(moving) > 50)]), moving[-1]]
    sides = [np.sign(pace[end]) for end in ends]
    assert len(ends) >= 12 and len(set(sides)) == 2
    left, gaps = [], []
    for end, side in zip(ends, sides, strict=True):
        still = slice(end + 150, end + 160)
        flank = axis.directions["forward" if side > 0 else "reverse"]
        left.append(np.mean(stood[still] + axis.at(flank, stood[still]) - asked[still]))
        where = np.atleast_1d(asked[end])
        gaps.append(float((axis.at("B", where) - axis.at("A", where))[0]))
    lost = np.sqrt(np.mean(np.square(left)))
    assert lost < 0.005 * np.sqrt(np.mean(np.square(gaps)))
