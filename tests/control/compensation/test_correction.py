"""Error tables: the correction, its polygon, what it leaves, and the files of controls."""

import re
from typing import get_args

import numpy as np
import pytest

from tests.control.headers import TABLE, called, compiled, needs_cc
from vttig_jax.base.errors import NoAnswerError, UsageError
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.control.compensation.c_header import table_header
from vttig_jax.control.compensation.correction import (
    AxisError,
    CorrectionTable,
    Curve,
    correction_table,
    left_over,
    size,
)
from vttig_jax.control.compensation.table_formats import (
    csv,
    linuxcnc,
    plain,
    read_linuxcnc,
    twincat,
)
from vttig_jax.pair.gear_pair import Flank

FLANKS: tuple[Flank, ...] = get_args(Flank)


def series(rng, orders, arcsec=30.0):
    """A transmission error of random harmonics of the driving angle."""
    amplitude = rng.normal(0, arcsec, len(orders)) * ARCSEC
    phase = rng.uniform(0, REV, len(orders))
    return lambda angle: np.sin(np.multiply.outer(angle, orders) + phase) @ amplitude


def axis_of(seed, **changes) -> AxisError:
    rng = np.random.default_rng(seed)
    ratio = float(rng.choice([1 / 90, 0.5, 1.0, 2.5]))
    orders = np.array([1.0, 2.0, ratio, 5 * ratio])
    gain = rng.choice([-1.0, 1.0]) * rng.choice([ratio, 1.0])
    errors: dict[Flank, Curve] = {"A": series(rng, orders), "B": series(rng, orders)}
    return AxisError(errors, ratio, gain, rng.uniform(-REV, REV), **changes)


@pytest.mark.parametrize("seed", range(8))
def test_the_corrected_axis_stands_where_it_is_told(seed):
    axis = axis_of(seed)
    asked = np.linspace(-3.0, 9.0, 1001)
    for flank in FLANKS:
        added = axis.correction(flank, asked)
        np.testing.assert_allclose(added + axis.at(flank, asked + added), 0.0, atol=1e-12)
        far = 1e5 + asked  # angles of few digits
        added = axis.correction(flank, far)
        np.testing.assert_allclose(added + axis.at(flank, far + added), 0.0, atol=1e-10)


@pytest.mark.parametrize("seed", range(10))
def test_a_table_never_makes_the_axis_worse(seed):
    axis, rng = axis_of(seed), np.random.default_rng(1000 + seed)
    start = rng.uniform(-REV, REV)
    stop = start + rng.uniform(0.3, 1.0) * REV
    table = correction_table(
        axis, start, stop, (stop - start) / rng.integers(150, 1500)
    ).in_float32()
    where = np.linspace(start, stop, 5003)
    for direction in axis.directions:
        before, after = (size(left_over(axis, one, direction, where)) for one in (None, table))
        assert after.rms < 0.5 * before.rms and after.peak < before.peak


def test_the_flank_of_a_direction_follows_the_sense_of_the_axis():
    errors: dict[Flank, Curve] = {"A": np.zeros_like, "B": np.ones_like}
    ahead, behind = AxisError(errors, 0.5, 0.5), AxisError(errors, 0.5, -0.5)
    assert ahead.directions == {"forward": "A", "reverse": "B"}
    assert behind.directions == {"forward": "B", "reverse": "A"}
    assert AxisError({"B": np.ones_like}, 0.5, 0.5).directions == {"reverse": "B"}
    # What the driven gear is ahead, an axis that counts the other way is behind.
    np.testing.assert_allclose(ahead.at("B", np.zeros(1)), 1.0)
    np.testing.assert_allclose(behind.at("B", np.zeros(1)), -1.0)


@pytest.mark.parametrize(("order", "fitted", "sampled"), [(30, 0.03, 0.05), (43, 0.055, 0.09)])
def test_fitted_nodes_hold_shorter_waves_than_sampled_ones(order, fitted, sampled):
    """255 intervals a turn; both limits are computed facts of linear interpolation."""
    axis = AxisError({"A": lambda angle: ARCSEC * np.sin(order * angle)}, 1.0, 1.0)
    table = correction_table(axis, 0.0, REV, REV / 255)
    where = np.linspace(0, REV, 40_001)
    whole = size(left_over(axis, None, "forward", where)).rms
    exact = CorrectionTable(table.positions, {"forward": axis.correction("A", table.positions)})
    least, plainly = (
        size(left_over(axis, one, "forward", where)).rms / whole for one in (table, exact)
    )
    assert least < fitted < plainly and plainly > sampled * 0.9


def test_the_mean_of_turns_that_a_control_cannot_tell():
    errors: dict[Flank, Curve] = {
        "A": lambda angle: ARCSEC * (3 * np.sin(angle / 2) + 5 * np.sin(angle))
    }
    axis = AxisError(errors, 1.0, 1.0, turns=(0, 1))
    asked = np.linspace(0, REV, 100)
    np.testing.assert_allclose(axis.mean("A", asked), 5 * ARCSEC * np.sin(asked), atol=1e-15)
    table = correction_table(axis, 0.0, REV, REV / 255)
    left = left_over(axis, table, "forward", asked)
    assert left.shape == (2, 100)
    np.testing.assert_allclose(size(left).rms, 3 * ARCSEC / np.sqrt(2), rtol=0.02)


def test_steps_and_slopes_that_make_no_table():
    axis = axis_of(0)
    with pytest.raises(UsageError, match="does not divide"):
        correction_table(axis, 0.0, 1.0, 0.3)
    steep = AxisError({"A": lambda angle: np.sin(angle)}, 1.0, 1.0)
    with pytest.raises(NoAnswerError, match="one to one"):
        correction_table(steep, 0.0, REV, REV / 100)


@pytest.fixture(scope="module")
def table() -> CorrectionTable:
    return correction_table(axis_of(3), 0.25, 0.25 + REV, REV / 255).in_float32()


def test_a_linuxcnc_file_gives_the_curve(table):
    text = linuxcnc(table, ("pair *) G0 A0 ; of\nÖ", "x" * 400, "2026-11-28 1 2 3"))
    rows, kind, faults = read_linuxcnc(text)
    assert (rows.shape, kind, faults) == ((256, 3), 1, {})
    assert all(line.startswith(";") for line in text.splitlines()[256:])
    assert max(map(len, text.splitlines())) < 255 and text.isascii()
    np.testing.assert_allclose(rows[:, 0] * DEG, table.positions, atol=0.5e-7 * DEG)
    for column, name in ((1, "forward"), (2, "reverse")):
        np.testing.assert_allclose(rows[:, column] * DEG, table.values[name], atol=0.5e-9 * DEG)
    alone = CorrectionTable(table.positions, {"reverse": table.values["reverse"]})
    rows, *_ = read_linuxcnc(linuxcnc(alone, ()))  # one direction has the values of the other
    np.testing.assert_array_equal(rows[:, 1], rows[:, 2])


ROWS = [f"{10 * k} 0.0{k} -0.0{k}" for k in range(1, 7)]
"""Six rows of corrections; those below are what stands at a line, and what LinuxCNC makes of it."""

FOREIGN = {
    "a comment first": (0, "# angle forward reverse", 0, "no-numbers", 1),
    "letters in between": (3, "deg deg deg", 3, "no-numbers", 4),
    "a blank line": (3, "", 3, "blank-line", 4),
    "blanks alone": (3, "  \t", 3, "blank-line", 4),
    "a long line": (3, "35 0 0 ; " + "x" * 250, 4, "long-line", 4),
    "a long comment": (0, "# " + "x" * 300, 0, "no-numbers", 1),
    "commas": (2, "25, 0.01, 0.02", 2, "comma", 3),
    "decimal commas": (2, "25,5 0,01 0,02", 2, "comma", 3),
    "twice": (3, ROWS[2], 6, "not-increasing", 4),
    "back": (3, "5 0 0", 6, "not-increasing", 4),
    "the same in single precision": (3, "30.0000001 0 0", 6, "not-increasing", 4),
    "no number": (3, "35 nan 0", 6, "not-finite", 4),
    "no end": (6, "inf 0 0", 6, "not-finite", 7),
    "byte order mark": (0, "\ufeff5 0.01 0.02", 0, "byte-order-mark", 1),
    "carriage returns": (6, "70 0.01 0.02\r80 0.01 0.02\r", 7, "carriage-return", 7),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_what_linuxcnc_does_without_a_word_is_named(name):
    place, line, rows, slug, number = FOREIGN[name]
    found = read_linuxcnc("\n".join([*ROWS[:place], line, *ROWS[place:], ""]))
    assert len(found.rows) == rows
    assert found.faults == {slug: [number]}
    (said,) = found.sentences
    assert said.startswith(f"Line {number} ")


@pytest.mark.parametrize("end", ["", "; made by hand", "\n\nmade in 2026\n", " \r"])
def test_what_stands_behind_the_rows_does_no_harm(end):
    lines = [f"  {row} ; {'x' * 200}\r" for row in ROWS]
    found = read_linuxcnc("\n".join([*lines, end]))
    assert (len(found.rows), found.type, found.faults) == (6, 1, {})


def test_what_the_rows_say_of_a_file():
    # A date is three numbers, as `sscanf` reads it.
    found = read_linuxcnc("\n".join([*ROWS, "2026-11-28"]))
    np.testing.assert_array_equal(found.rows[-1], [2026, -11, -28])
    positions = "\n".join(f"{10 * k} {10 * k}.01 {10 * k - 0.01}" for k in range(1, 7))
    assert read_linuxcnc(positions).type == 0
    assert list(read_linuxcnc("1 0.5 0.5\n2 1.0 1.0\n").faults) == ["type-unclear"]
    for text in ("", "\n", "no table"):
        assert list(read_linuxcnc(text).faults) == ["no-rows"]
    many = read_linuxcnc("\n".join(f"{k} 0.001 0.002" for k in range(1, 300)))
    assert len(many.rows) == 256 and many.faults == {"too-many-rows": list(range(257, 300))}


def test_structured_text_and_csv_give_the_curve(table):
    text = twincat(table, ("*) evil := 1;",), "axis 2; END_VAR")
    assert re.search(r"axis_axis_2_END_VAR_last : UDINT := 255;", text)
    for name, values in (("positions", table.positions), *table.values.items()):
        (held,) = re.findall(rf"_{name}_deg : ARRAY\[0\.\.255\] OF LREAL := \[([^]]*)\];", text)
        found = np.array(held.split(","), float) * DEG
        np.testing.assert_allclose(found, values, atol=0.5e-9 * DEG)
    head, *rows = csv(table).splitlines()
    assert head == "position_deg,forward_correction_deg,reverse_correction_deg"
    found = np.array([row.split(",") for row in rows], float) * DEG
    np.testing.assert_allclose(found[:, 2], table.values["reverse"], atol=0.5e-9 * DEG)


@needs_cc
def test_c_gives_the_curve(table, tmp_path):
    text = table_header(table, ("*/ int evil; /*", "Ö"), name="axis")
    program = compiled(tmp_path, text, "axis", TABLE)
    start, stop = np.degrees(table.positions[[0, -1]])
    asked = np.linspace(start - 20, stop + 20, 20_001)
    found = called(program, asked, 0.0, 0.0)
    for row, name in zip(found[:2], ("forward", "reverse"), strict=True):
        # Equal steps are within half a digit of single precision of the positions.
        np.testing.assert_allclose(row, np.degrees(table.at(name, asked * DEG)), atol=1e-7)
    assert not called(program, np.nan, 0.0, 0.0).any()
    far = called(program, [-np.inf, np.inf], 0.0, 0.0)
    np.testing.assert_array_equal(far[0], np.degrees(table.values["forward"][[0, -1]]))
    alone = CorrectionTable(table.positions, {"reverse": table.values["reverse"]})
    assert "axis_forward_deg" not in table_header(alone, (), name="axis")
    with pytest.raises(UsageError):
        table_header(table, (), name="2x")


def test_no_name_becomes_code():
    assert "*)" not in plain("a *) b") and "\n" not in plain("a\nb")
    assert "*/" not in plain("**/ /*/") and "/*" not in plain("**/ /*/")
    assert plain("3″ at 5°") == "3arcsec at 5 deg"
