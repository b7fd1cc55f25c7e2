"""Layouts of recording programs: the same numbers as the angles from which they were written."""

import re

import numpy as np
import pytest

from tests.logs.rig_log import angles_deg, csv
from vttig_jax.base.errors import LogError
from vttig_jax.logs import read_log

T, X, Y = angles_deg(turns=2)
SIZE = len(T)


@pytest.fixture
def read(tmp_path):
    """Write a text and read it as a log of ratio 16:9."""

    def from_text(text, encoding="utf-8", name="log.txt", **options):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return read_log(path, ratio="16:9", **options)

    return from_text


def comma(value, digits=6):
    return f"{value:.{digits}f}".replace(".", ",")


def deviation_deg(log, shift_s=0.0):
    """Largest deviation of the driven angle from the rig's, at the stamps of the log, in deg."""
    time, x, y = angles_deg(shift_s, turns=2)
    inner = slice(2, -2)
    driving = np.interp(log.time, time, x)[inner]
    driven = np.interp(log.time, time, y)[inner]
    seen = np.degrees(log.driving.reading * log.driving.radians_per_unit)[inner]
    other = np.degrees(log.driven.reading * log.driven.radians_per_unit)[inner]
    return np.quantile(np.abs(seen - driving), 0.9), np.quantile(np.abs(other - driven), 0.9)


def units_row():
    rows = (
        f"{comma(t, 3)};{comma(x)};{comma(y)};{comma(1.5)}" for t, x, y in zip(T, X, Y, strict=True)
    )
    return "\r\n".join(["Zeit;Antrieb;Abtrieb;Moment", "s;°;°;Nm", *rows, ""])


def preamble():
    head = "Geraet:;Scope 12\r\nDatum:;2026-11-01\r\nKanaele:;3\r\nBemerkung:;kalt; lang\r\n\r\n"
    rows = (f"{comma(1000 * t, 1)};{comma(x)};{comma(y)}" for t, x, y in zip(T, X, Y, strict=True))
    return head + "\r\n".join(["Zeit [ms];Winkel Antrieb [°];Winkel Abtrieb [°]", *rows, ""])


def twincat(mark="\t"):
    def row(*fields):
        return mark.join(fields)

    head = [
        row("Name", "axis_test"),
        row("Starttime of export", "132959733843760000", "Montag"),
        "",
        row("Name", "ActPos motor", "temp", "Name", "ActPos load"),
        row("SymbolComment", "", "", "SymbolComment", ""),
        row("Data-Type", "REAL64", "REAL32", "Data-Type", "REAL64"),
        row("SampleTime[ms]", "10", "10", "SampleTime[ms]", "20"),
        row("Unit", "° (Angle)", "(None)", "Unit", "° (Angle)"),
        row("ScaleFactor", "1", "1", "ScaleFactor", "1"),
        "",
    ]
    rows = []
    for k in range(SIZE):
        fields = [f"{10 * k}", comma(X[k]), "21,5"]
        if 2 * k < SIZE:
            fields += [f"{20 * k}", comma(Y[2 * k])]
        rows.append(row(*fields))
    return "\r\n".join([*head, *rows, "EOF", ""])


def cantools(*, single: bool, shift_s: float = 3e-4):
    y = angles_deg(shift_s, turns=2)[2]
    before, between, after = ("(", ", ", ")") if single else ("(\n    ", ",\n    ", "\n)")
    lines = []
    for k in range(SIZE):
        a, b = 1436509052.25 + T[k], 1436509052.25 + T[k] + shift_s
        lines.append(
            f" ({a:.6f})  can0  1A0   [8]  10 27 00 00 0C 00 00 00 :: MotorPos{before}Motor_Pos:"
            f" {X[k]:.4f} deg{between}Motor_Cur: 0.12 A{after}\n"
            f" ({b:.6f})  can0  1A1   [8]  F9 15 00 00 00 00 00 00 :: LoadPos{before}Load_Pos:"
            f" {y[k]:.4f} deg{after}\n"
        )
    return "".join(lines)


def camonitor(shift_s: float = 1e-4, *, changes_only: bool = False):
    y = angles_deg(shift_s, turns=2)[2]
    lines, last = ["RIG:OTHER *** Not connected (PV not found)\n"], ""
    for k in range(SIZE):
        for name, value, at in (("RIG:MOT", X[k], T[k]), ("RIG:LOAD", y[k], T[k] + shift_s)):
            line = f"{name:<30s} 2026-11-01 00:29:{at:09.6f} {value:.6f}  \n"
            if not (changes_only and line.split()[-1] == last):
                lines.append(line)
    return "".join(lines)


def long_csv():
    lines = ["time_s,channel,value"]
    for k in range(SIZE):
        lines += [f"{T[k]:.4f},motor_deg,{X[k]:.6f}", f"{T[k]:.4f},load_deg,{Y[k]:.6f}"]
    return "\n".join(lines) + "\n"


def late(text: str, old: str, new: str) -> str:
    """Replace the first `old` in the second half of a text."""
    half = len(text) // 2
    return text[:half] + text[half:].replace(old, new, 1)


@pytest.mark.parametrize(
    "row", ["ScaleFactor\t0,001\t1\tScaleFactor\t1", "Offset\t7\t0\tOffset\t0"]
)
def test_a_scale_or_an_offset_of_twincat_is_asked_for(read, row):
    """Exports do not say whether their numbers contain it."""
    key = row.split("\t")[0]
    text = re.sub(r"(?m)^ScaleFactor.*$", row.replace("\t", "\\t"), twincat())
    with pytest.raises(LogError, match=r"with ScaleFactor .*Offset.*names no unit") as caught:
        read(text)
    assert key in str(caught.value)
    assert len(read(text, unit="deg")) == SIZE // 2  # the user says what the numbers are
    plain = row.replace("0,001", "1,0").replace("7", "0,0")
    assert len(read(text.replace(row, plain))) == SIZE // 2


@pytest.mark.parametrize(
    ("text", "options", "size"),
    [
        (units_row(), {}, SIZE),
        (preamble(), {}, SIZE),
        (twincat(), {}, SIZE // 2),
        (twincat(";"), {}, SIZE // 2),
        (cantools(single=True), {}, SIZE - 1),
        (cantools(single=False), {}, SIZE - 1),
        (
            camonitor(),
            {"unit": "deg", "columns": {"driving": "RIG:MOT", "driven": "RIG:LOAD"}},
            SIZE - 1,
        ),
        (long_csv(), {}, SIZE),
    ],
    ids=["units row", "preamble", "twincat", "twincat ;", "can", "can lines", "camonitor", "long"],
)
def test_layouts(read, text, options, size):
    log = read(text, **options)
    assert abs(len(log) - size) <= 1
    assert max(deviation_deg(log)) < 1e-4 + 1.1e-4  # four digits, and interpolation


def test_a_time_with_a_decimal_comma_is_no_description(read):
    """Sample times below 1 ms are written as `0,2`; every row of them is kept."""
    with_comma = re.sub(r"(?m)^(\d+)\t", r"\1,0\t", twincat())
    assert with_comma != twincat()
    log, plain = read(with_comma), read(twincat())
    np.testing.assert_array_equal(log.driven.reading, plain.driven.reading)
    np.testing.assert_array_equal(log.time, plain.time)


def test_twincat_with_filetime_is_twincat_with_milliseconds(read):
    """FILETIME has 18 digits; a float holds it to 1.6 µs only."""
    start = 132_959_733_843_760_000

    def stamped(match):
        return f"{match[1]}{start + 10_000 * int(match[2])}"

    text = twincat().replace("SampleTime[ms]", "SampleTime")
    text = re.sub(r"(?m)^()(\d+)(?=\t)", stamped, text)
    text = re.sub(r"(?m)(\t21,5\t)(\d+)(?=\t)", stamped, text)
    assert text.count(str(start)) == 3  # with the start of the export
    log, plain = read(text), read(twincat())
    np.testing.assert_allclose(log.time, plain.time, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(log.driving_angle, plain.driving_angle)
    np.testing.assert_array_equal(log.driven_angle, plain.driven_angle)


def test_a_cut_row_of_twincat_is_left_out(read):
    whole = twincat().removesuffix("EOF\r\n")
    log = read(whole + f"{10 * SIZE}\t")
    assert "is cut off and left out" in " ".join(log.notes)
    np.testing.assert_array_equal(log.driving.reading, read(whole).driving.reading)


def test_empty_rows_and_columns_of_a_sheet(read):
    lines = units_row().splitlines()
    sheet = "\r\n".join([*(f"{line};;" for line in lines), ";;;;;", ";;;;;", ""])
    log = read(sheet)
    assert len(log) == SIZE and log.spec.log.driven == "Abtrieb [°]"


def test_a_preamble_of_pairs_is_skipped(read):
    """Several lines of a word and a number above the table are no rows of it."""
    table = csv("Time\tMotor\tLoad\n[s]\t[deg]\t[deg]", T, X, Y, mark="\t")
    log = read(f"Device:\tXYZ\nDate:\t2026-11-01 10:00\nChannels\t2\n\n{table}")
    assert len(log) == SIZE and log.spec.log.driving == "Motor [deg]"


def test_stamps_of_their_own_matter(read):
    """The driven readings are those 0.3 ms later; without interpolation they are 0.06° off."""
    log = read(cantools(single=True))
    raw = angles_deg(3e-4, turns=2)[2]
    assert np.median(np.abs(raw - Y)) > 0.03
    assert deviation_deg(log)[1] < 2e-4
    assert any("|a|h²/8" in note for note in log.notes)
    assert any("part of the delay" in note for note in log.notes)


def test_samples_at_the_same_times_are_taken_and_not_interpolated(read):
    """Every second sample of the driving shaft lies at the time of one of the driven shaft."""
    log = read(twincat())
    assert log.driving.step == 0 and any("only its samples at the times" in n for n in log.notes)
    assert not any("offset between the clocks" in one for one in log.notes)
    written = np.array([float(f"{one:.6f}") for one in X[::2]])
    assert np.array_equal(np.asarray(log.driving.reading), written)


def test_a_value_of_which_only_changes_are_logged_is_held(read):
    """The shafts rest for 3 s; a straight line through the rest would be degrees off."""
    lines = []
    for name, factor, late in (("MOT:POS", 1.0, 0.0), ("LOAD:POS", 9 / 16, 0.004)):
        for k in range(200):
            at = k / 100 + (3.0 if k >= 100 else 0.0)
            stamp = f"2026-11-01 00:29:{at + late:09.6f}"
            lines.append((at + late, f"{name:<30s} {stamp} {factor * 4 * (k + 1):.6f}  \n"))
    text = "".join(line for _, line in sorted(lines))
    log = read(text, unit="deg", columns={"driving": "MOT:POS", "driven": "LOAD:POS"})
    error = np.degrees(log.driven_angle) - 9 / 16 * np.degrees(log.driving_angle)
    assert np.ptp(error[5:95]) < 1e-6 and np.ptp(error[105:195]) < 1e-6
    assert np.ptp(error) < 2.4  # one step; 3 s of interpolation would put samples in between


@pytest.mark.parametrize("numbered", [False, True])
def test_halsampler_gaps(read, numbered):
    counts = np.rint(X * 250).astype(int), np.rint(Y * 250).astype(int)
    rows = []
    for k in range(SIZE):
        if 200 <= k < 260:
            continue
        if k == 260:
            rows.append("overrun\n")
        first = f"{(k + 65000) % 65536} " if numbered else ""
        rows.append(f"{first}{counts[0][k]} {counts[1][k]} \n")
    log = read("".join(rows), counts=90000, sample_rate_hz=100.0)
    gap = np.diff(log.time).max()
    assert gap == pytest.approx(0.61 if numbered else 0.11)
    assert any("1 gaps where samples were lost" in note for note in log.notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (camonitor().replace("RIG:LOAD", "RIG LOAD"), "--column|no table"),
        (camonitor().replace("00:29:05.000000", "???"), "none of `camonitor`"),
        (twincat().split("° (Angle)")[0] + "\r\n", "no rows of numbers|no table|certainly"),
        (twincat().replace("21,5", "oops", 3), "no channel|oops"),
        (late(long_csv(), "load_deg,", "load_deg,x"), "no number"),
        (late(long_csv(), ",load_deg,", ",load_deg"), "too few fields"),
        (units_row().split("\r\n")[0], "no table|header"),
    ],
)
def test_damaged_layouts_are_one_sentence(read, text, words):
    options = {"unit": "deg"} if "RIG" in text else {}
    with pytest.raises(LogError, match=words):
        read(text, **options)


@pytest.mark.parametrize("make", [lambda: cantools(single=False), camonitor, long_csv])
def test_a_cut_end_is_left_out(read, make):
    text = make()
    options = {}
    if "RIG" in text:
        options = {"unit": "deg", "columns": {"driving": "RIG:MOT", "driven": "RIG:LOAD"}}
    log = read(text[:-17], **options)
    assert len(log) > SIZE - 4
    assert any("cut off" in note for note in log.notes)


def test_unnamed_channels_that_end_at_different_times(read):
    """The ratio is looked for where both channels have samples."""
    lines = ["time_s,channel,value"]
    for k in range(SIZE):
        lines.append(f"{T[k]:.4f},a [deg],{X[k]:.6f}")
        if k < 0.8 * SIZE:
            lines.append(f"{T[k] + 1e-3:.4f},b [deg],{Y[k]:.6f}")
    log = read("\n".join(lines) + "\n")
    assert log.spec is not None and log.spec.log.driving == "a [deg]"


def test_channels_without_a_common_time(read):
    lines = [f"{k / 10:.1f},motor_deg,{k}\n" for k in range(50)]
    lines += [f"{100 + k / 10:.1f},load_deg,{k}\n" for k in range(50)]
    pairs = zip(lines[:50], lines[50:], strict=True)
    mixed = "time_s,channel,value\n" + "".join(line for pair in pairs for line in pair)
    with pytest.raises(LogError, match="no common time"):
        read(mixed)
