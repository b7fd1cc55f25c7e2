"""JSON, pairs, brackets, tables on their side and oscilloscopes hold the log of a plain table."""

import json
from datetime import datetime, timedelta

import numpy as np
import pytest

from tests.logs.rig_log import angles_deg, csv
from vttig_jax.base.errors import LogError
from vttig_jax.logs import read_log
from vttig_jax.logs.readers.open_table import open_table

T, X, Y = (one.round(5) for one in angles_deg(turns=2))
NAMES = ("time_s", "motor_deg", "load_deg")
ROWS = list(zip(T.tolist(), X.tolist(), Y.tolist(), strict=True))
OBJECTS = [dict(zip(NAMES, row, strict=True)) for row in ROWS]
NUMBERED = {"unit": "deg", "columns": {"time": "#1", "driving": "#2", "driven": "#3"}}
DATES = [(datetime(2026, 11, 1, 23, 59, 58) + timedelta(seconds=float(t))).isoformat() for t in T]


def lines(form, *columns) -> str:
    return "".join(form(*row) + "\n" for row in zip(*columns, strict=True))


def transposed(*heads: str, mark: str = ",") -> str:
    rows = (
        mark.join([*head.split(" "), *(f"{v:.5f}" for v in values)]).replace(
            ".", "," if mark == ";" else "."
        )
        for head, values in zip(heads, (T, X, Y), strict=True)
    )
    return "\n".join(rows) + "\n"


def long() -> list[dict]:
    return [
        {"t_s": t, "channel": name, "value": value}
        for t, x, y in ROWS
        for name, value in (("motor_deg", x), ("load_deg", y))
    ]


FORMS = {
    "objects": (json.dumps(OBJECTS), {}),
    "indented": (json.dumps({"rig": "A", "rate": 100, "data": OBJECTS}, indent=1), {}),
    "lists": (json.dumps(dict(zip(NAMES, (T.tolist(), X.tolist(), Y.tolist()), strict=True))), {}),
    "texts": (json.dumps([{k: str(v) for k, v in one.items()} for one in OBJECTS]), {}),
    "nested": (
        lines(lambda t, x, y: json.dumps({"t": t, "motor": {"x_deg": x}, "load_deg": y}), T, X, Y),
        {},
    ),
    "dated": (
        lines(lambda t, x, y: json.dumps({"at": t, "motor_deg": x, "load_deg": y}), DATES, X, Y),
        {},
    ),
    "long": (lines(json.dumps, long()), {}),
    "rows": (json.dumps(ROWS), NUMBERED),
    "row lines": (lines(json.dumps, ROWS), NUMBERED),
    "pairs": (lines("time_s={} motor_deg={} load_deg={}".format, T, X, Y), {}),
    "plotter": (lines("time_s:{},motor_deg:{},load_deg:{}".format, T, X, Y), {}),
    "units": (lines("t = {} s; motor = {} deg; load = {} deg".format, T, X, Y), {}),
    "dated pairs": (lines("[{}] motor_deg={}, load_deg={}".format, DATES, X, Y), {}),
    "yarp": (lines("{} ({} {})".format, T, X, Y), NUMBERED),
    "tuples": (lines("({}, {}, {})".format, T, X, Y), NUMBERED),
    "on its side": (transposed(*NAMES), {}),
    "side and units": (transposed("Zeit s", "Antrieb °", "Abtrieb °", mark=";"), {}),
    "below a title": ("Bench 7\n\n" + transposed(*NAMES, mark="\t"), {}),
}  # fmt: skip


@pytest.fixture
def save(tmp_path):
    def write(text: str, name: str = "log.txt"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize("form", FORMS)
def test_the_same_log(save, form):
    text, options = FORMS[form]
    log = read_log(save(text), ratio="16:9", **options)
    np.testing.assert_allclose(log.driving.reading, X, atol=1e-9)
    np.testing.assert_allclose(log.driven.reading, Y, atol=1e-9)
    np.testing.assert_allclose(np.diff(log.time), np.diff(T), atol=1e-9)


@pytest.mark.parametrize("form", ["nested", "pairs", "dated pairs", "yarp"])
def test_a_cut_line_is_left_out_and_a_damaged_one_is_named(save, form):
    text, options = FORMS[form]
    log = read_log(save(text[:-12]), ratio="16:9", **options)
    assert len(log) == len(T) - 1 and any("left out" in note for note in log.notes)
    whole = text.splitlines()
    whole[40] = whole[40][:-9]
    with pytest.raises(LogError, match="line 41"):
        read_log(save("\n".join(whole)), ratio="16:9", **options)


def test_lines_between_pairs_are_left_out(save):
    whole = FORMS["pairs"][0].splitlines()
    log = read_log(save("\n".join([*whole[:40], "INFO homed", *whole[40:], ""])), ratio="16:9")
    assert len(log) == len(T) and any("1 lines with other names" in note for note in log.notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"a": [1, 2', "damaged or cut off"),
        ('[{"a": "x"}, {"a": "y"}]', "no lists of numbers"),
        ("{}", "no lists of numbers"),
        (transposed(*NAMES)[:-30], "line 3: .* cut off"),
        (transposed(*NAMES).rstrip().rpartition("load_deg")[0] + "load", "no table|cut off"),
        ("\ufeff\n", "no table"),
        (json.dumps({f"k{k}": [1, 2] for k in range(3000)}), "3000 lists of numbers"),
        ("a," + "b " * 9000 + "\n1,2\n3,4\n", "name of a column"),
        (json.dumps({"a": [10**400, 1, 2]}), "--column time"),
        ('{"a":' * 50_000, "damaged|no lists"),
        ("[" * 50_000, "damaged|no table|no lists"),
        (
            "\n".join(",".join(map(str, X)) for _ in range(3)),
            f"its side .3 rows of {len(X)} columns",
        ),
    ],
)
def test_what_is_no_log(save, text, words):
    with pytest.raises(LogError, match=words):
        read_log(save(text), ratio="16:9")


@pytest.mark.parametrize(
    "head",
    [
        "x-axis,1,2\nsecond,Volt,Volt",
        "Source,CH1,CH2\nSecond,Volt,Volt",
        "Time,Channel A,Channel B\n(s),(V),(V)\n",
        '"in s","C1 in V","C2 in V"',
        "Model,MSO24\n\nSample Interval,0.01,,\n\nTIME,CH1,CH2",
    ],
)
def test_headers_of_oscilloscopes(save, head):
    table = open_table(save(csv(head, T, X / 72, Y / 72)))
    assert all(any(name in line for line in head.splitlines()) for name in names_of(table))
    time, first, second = table.columns([0, 1, 2])
    np.testing.assert_allclose([time, first, second], [T, X / 72, Y / 72], atol=1e-6)


def names_of(table) -> list[str]:
    return [name.split(" [")[0] for name in table.names]


@pytest.mark.parametrize("end", ["", ","])
def test_start_and_increment_of_an_oscilloscope(save, end):
    head = f"X,CH1,CH2,Start,Increment{end}\nSequence,Volt,Volt,-5.0e-01,1.0e-02{end}"
    named = csv(head, np.arange(len(T)), X, Y).replace("\n", ",\n")
    inline = csv("CH1V,CH2V,t0 =-5.0e-01, tInc = 1.0e-02,", X, Y)
    for text, names in ((named, ("CH1 [Volt]", "CH2 [Volt]")), (inline, ("CH1 [V]", "CH2 [V]"))):
        table = open_table(save(text))
        assert table.names == ("time [s]", *names)
        time, *channels = table.columns([0, 1, 2])
        np.testing.assert_allclose(time, T - 0.5, atol=1e-9)
        np.testing.assert_allclose(channels, [X, Y], atol=1e-6)
    with pytest.raises(LogError, match="no start and increment"):
        open_table(save(named.replace("1.0e-02", "?")))


def levels(angle_deg: np.ndarray, lines: int) -> tuple[np.ndarray, np.ndarray]:
    state = np.floor(angle_deg / 360 * 4 * lines).astype(int) % 4
    return np.isin(state, (1, 2)) * 3.3, np.isin(state, (2, 3)) * 3.3


def levels_text() -> str:
    noise = np.random.default_rng(3).normal(0, 0.1, (2, len(T)))
    step, way = (np.floor(X / 7.2) % 2), np.gradient(X) > 0
    a, b = levels(Y, 20)
    digital = (one.astype(int) for one in (step, way, 0 * T))
    return csv("Time [s],STEP,DIR,Index,1,2", T, *digital, a + noise[0], b + noise[1])


def test_counts_of_two_levels(save):
    options = {"driving": "quadrature(STEP,DIR)", "driven": "quadrature(1, 2)"}
    log = read_log(save(levels_text()), ratio="16:9", columns=options, counts=(25, 80))
    driven = log.driven.reading / 80 * 360
    assert np.ptp(driven - (Y - Y[0])) < 2 * 360 / 80
    assert np.ptp(log.driving.reading / 25 * 360 - (X - X[0])) < 3 * 360 / 25
    again = read_log(save(levels_text()), log.spec)
    np.testing.assert_array_equal(again.driven.reading, log.driven.reading)


@pytest.mark.parametrize(
    ("pair", "words"), [("1,3", "no column 3"), ("1,1", "at once"), ("1,Index", "never changes")]
)
def test_levels_that_count_nothing(save, pair, words):
    with pytest.raises(LogError, match=words):
        open_table(save(levels_text()), requested=[f"quadrature({pair})"])
