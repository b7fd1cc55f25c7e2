"""Logs that can be read in two ways end in a question that names the option which decides."""

from typing import Any

import numpy as np
import pytest

from tests.logs.rig_log import angles_deg, csv
from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.logs import read_log
from vttig_jax.logs.read import open_log
from vttig_jax.logs.recognition.questions import GUESSES, QUESTIONS, Question
from vttig_jax.logs.recognition.request import DriveRequest
from vttig_jax.pair.pair_file import parse_pair_spec

T, X, Y = angles_deg()
DEFAULT: dict[str, Any] = {"ratio": "16:9"}


@pytest.fixture
def ask(tmp_path):
    """Write a log, read it, and return the error with the words of its question."""

    def read(text: str, **options: Any):
        path = tmp_path / "log.csv"
        path.write_text(text, encoding="utf-8")
        with pytest.raises((LogError, UsageError)) as caught:
            read_log(path, **DEFAULT | options)
        return str(caught.value)

    return read


@pytest.fixture
def question(tmp_path):
    """Write a log, read it, and return the question."""

    def read(text: str, *pair, **options: Any) -> Question:
        path = tmp_path / "log.csv"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(Question) as caught:
            read_log(path, *pair, **options)
        return caught.value

    return read


@pytest.fixture
def columns(tmp_path):
    """Write a log, read it, and return role → name."""

    def read(text: str, **options: Any):
        path = tmp_path / "log.csv"
        path.write_text(text, encoding="utf-8")
        spec = read_log(path, **DEFAULT | options).spec
        assert spec is not None
        return spec.log

    return read


def test_equal_shafts_without_names(ask, columns):
    text = csv("t,a,b", T, X, X + 0.01 * np.sin(np.radians(X)))
    told = ask(text, ratio="1:1", unit="deg")
    assert "`a` drives `b`, or `b` drives `a`" in told and "--column driving='a'" in told
    named = csv("t,a,load", T, X, X + 0.01 * np.sin(np.radians(X)))
    assert columns(named, ratio="1:1", unit="deg").driving == "a"


def test_one_encoder_in_two_units_is_no_pair_of_shafts(ask):
    wave = X + 0.01 * np.sin(np.radians(X))

    def exact(head: str, *columns: np.ndarray) -> str:
        rows = np.stack([T, *columns], axis=1).tolist()
        return "\n".join([head, *(",".join(map(repr, row)) for row in rows)]) + "\n"

    text = exact("t,p [rad],q [rev],r [rev]", np.radians(X), X / 360, wave / 360)
    told = ask(text, ratio="1:1")
    assert "`p [rad]` drives `r [rev]`" in told and "`q [rev]` drives `r [rev]`" in told
    assert "`p [rad]` drives `q [rev]`" not in told and "`q [rev]` drives `p [rad]`" not in told
    only = ask(exact("t,p [rad],q [rev]", np.radians(X), X / 360), ratio="1:1")
    assert "`p [rad]` drives `q [rev]`" in only


def test_columns_with_a_unit_of_angles_are_listed_first(ask):
    told = ask(csv("t,u,p cmd [rad],q [rad]", T, X, X, X), ratio="7:5", unit="deg")
    told = told[told.index("there are") :]
    assert told.index("`q [rad]`") < told.index("`p cmd [rad]`") < told.index("`u`")


def test_setpoint_and_actual(ask, columns):
    head = "t [s],Motor Soll [°],Motor Ist [°],Last [°]"
    told = ask(csv(head, T, X, X, Y))
    assert "2 columns can be driving" in told and "--column driving='Motor Ist [°]'" in told
    assert "1, 2" not in told and "3.6, 7.2" in told  # the first values
    picked = columns(csv(head, T, X, X, Y), columns={"driving": "Motor Ist"})
    assert (picked.driving, picked.driven) == ("Motor Ist [°]", "Last [°]")


def test_a_refusal_states_slopes(ask):
    """Beside first values and range; angles that wrap have the slope of the motion."""
    told = ask(csv("zeit [s],a,b,c,d", T, X, X % 360, Y, -2 * X), ratio="7:5", unit="deg")
    assert "`a` 3.6, 7.2, 10.8, … (" in told and "`a`, slope" not in told
    assert "), slope 1 over `a`; `c`" in told
    assert "slope 0.56" in told and "slope -2 over `a`" in told
    counted = csv("a,b,c", T, 36 * T, 20.25 * T)
    assert "0.02, … (0 … 19.99), 0.01 from row to row" in ask(counted, unit="deg")


def test_only_a_setpoint(ask):
    told = ask(csv("t [s],motor_target_deg,load_deg", T, X, Y))
    assert "`target` says a setpoint" in told and "--column driving=NAME" in told


def test_position_and_speed_alike(ask):
    speeds = np.gradient(X, T), np.gradient(X * 9 / 16, T)
    told = ask(csv("t,a,b,c,d", T, X, Y, *speeds), unit="deg")
    assert "2 pairs of columns have the given ratio" in told
    assert "`a` drives `b`" in told and "`c` drives `d`" in told


def test_one_direction_without_names(ask):
    one_way = csv("a,b,c", T, 36 * T, 20.25 * T)
    told = ask(one_way, unit="deg")
    assert "no column is certainly the time" in told and "--column time=NAME" in told
    assert all(f"`{name}`" in told for name in "abc")


def test_time_and_unit_are_asked_for_together(ask):
    plain = csv("a,b,c", np.arange(len(T)), X, Y)
    told = ask(plain)
    assert "--sample-rate" in told and "No name states the unit" in told and "--counts A,B" in told
    assert "No name states" not in ask(plain, unit="deg")
    assert "No name states" not in ask(csv("a,b [deg],c", np.arange(len(T)), X, Y))


def test_a_table_of_one_column(ask):
    told = ask("\n".join(f"{angle:.2f}" for angle in Y % 360), ratio="1:1", sample_rate_hz=100.0)
    assert "--column driving='#1' --column driven=#row" in told
    assert "#row" not in ask(csv("a,b", X, X**2), sample_rate_hz=100.0)


def test_no_ratio(ask, tmp_path):
    assert "the ratio of the drive is missing" in ask(csv("t,a,b", T, X, Y), ratio=None)


def test_two_time_columns(ask, columns):
    text = csv("time_s,stamp_s,motor_deg,load_deg", T, T + 7, X, Y)
    assert columns(text).time == "time_s"  # the name that this package itself writes
    told = ask(text.replace("time_s", "Zeit [s]"))
    assert "2 columns can be time" in told and "--column time='stamp_s'" in told
    assert "2 columns can be time" in ask(csv("clock,x [s],motor_deg,load_deg", T, T + 7, X, Y))
    assert columns(csv("x [s],y,motor_deg,load_deg", T, 2 * T, X, Y)).time == "x [s]"


def test_two_time_columns_of_the_same_stamps_are_one(ask, columns):
    names = "motor time [s],motor [°],load time [s],load [°]"
    assert columns(csv(names, T, X, T, Y)).time == "motor time [s]"
    assert "2 columns can be time" in ask(csv(names, T, X, T + 0.001, Y))
    assert "2 columns can be time" in ask(csv(names.replace("load time [s]", "t [ms]"), T, X, T, Y))


def test_counts_without_counts_a_turn(ask):
    counts = np.rint(X * 100).astype(int), np.rint(Y * 100).astype(int)
    told = ask(csv("t,motor_counts,load_counts", T, *counts))
    assert "in counts" in told and "--counts A,B" in told
    assert "in counts" in ask(csv("t,a,b", T, *counts), unit="counts")


def test_no_unit(ask):
    told = ask(csv("t,motor,load", T, X, Y))
    assert "names no unit" in told and "--unit deg" in told
    assert "`load`" in ask(csv("t,motor_deg,load", T, X, Y))


def test_whole_stamps_without_a_unit(ask, columns):
    whole = np.arange(len(T)) * 10
    told = ask(csv("time,motor_deg,load_deg", whole, X, Y))
    assert "seconds and milliseconds look the same" in told and "--unit time=s" in told
    assert columns(csv("time,motor_deg,load_deg", whole, X, Y), unit={"time": "ms"}).driving


@pytest.mark.parametrize("ratio", ["9/16", "16/9", "0.5625", 50])
def test_a_ratio_of_two_readings(ask, ratio):
    told = ask(csv("t,a,b", T, X, Y), unit="deg", ratio=ratio)
    if ratio == 50:
        assert "no columns turn as given" in told
    elif ratio == "0.5625":
        assert "--ratio 1:0.5625 if the driving shaft turns 16 times" in told
    else:
        assert "--ratio 16:9 if the driving shaft turns 16 times" in told
        assert "--ratio 9:16 if the driving shaft turns 9 times" in told


def test_a_number_beside_an_error_curve_has_two_readings(question, columns):
    curve = csv("time_s,driving_deg,transmission_error_arcsec", T, X, 3600 * (Y - 9 / 16 * X))
    asked = question(curve, ratio="0.5625")
    assert (asked.slug, asked.exit_code) == ("bare-ratio", 2)
    for ratio in ("9/16", "16:9"):
        assert columns(curve, ratio=ratio).driving == "driving_deg"


def test_the_ratio_is_that_of_scaled_readings(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(csv("t,a [deg],b [deg]", T, X, Y / 7))
    with pytest.raises(Question) as caught:
        open_log(path, DriveRequest(ratio="16:9"))
    assert caught.value.slug == "shafts-open"
    found = open_log(path, DriveRequest(ratio="16:9", driven_scale="7")).spec.log
    assert (found.driving, found.driven, found.driven_scale) == ("a [deg]", "b [deg]", "7")


def test_equal_speeds_have_one_reading(columns):
    text = csv("t,motor,b", T, X, X + 0.01 * np.sin(np.radians(X)))
    assert columns(text, ratio="1", unit="deg").driven == "b"


def test_columns_of_another_unit_are_named(ask):
    told = ask(csv("t,motor [mil],load [mil]", T, X / 0.9, Y / 0.9))
    assert "left out, as their names say another quantity: `motor [mil]` (mil)" in told


@pytest.mark.parametrize("first_day", [46327.25, 739922.25])
def test_days_without_a_unit(ask, columns, first_day):
    stamps = [f"{first_day + t / 86400:.10f}" for t in T]
    text = csv("time,motor_deg,load_deg", stamps, X, Y)
    assert "give --unit time=d or --unit time=s" in ask(text)
    assert columns(text, unit={"time": "d"}).time == "time"
    later = csv("time,motor_deg,load_deg", first_day + T, X, Y)
    assert columns(later).time == "time"  # steps of 10 ms are no parts of a day


def test_stamps_that_cannot_be_read(ask):
    stamps = [f"2026-305T00:00:{t:06.3f}" for t in T]
    told = ask(csv("time,motor_deg,load_deg", stamps, X, Y))
    assert "must be numbers, or dates" in told and "--sample-rate" in told


def test_a_row_below_the_table_is_named_with_its_line(ask):
    rows = csv("time_s,motor_deg,load_deg", T, X, Y)
    told = ask(rows + "METADATA\n" + rows.splitlines()[-1] + "\n")
    assert f"line {len(T) + 2}, column `time_s`" in told and "`METADATA` is no number" in told


def test_a_slash_with_named_columns(columns):
    assert columns(csv("t,motor,load", T, X, Y), unit="deg", ratio="9/16").driven == "load"


def test_one_encoder_counts_backwards(ask, columns):
    text = csv("t,a,b", T, X, -Y)
    assert "--invert driven" in ask(text, unit="deg")
    assert columns(text, unit="deg", invert="driven").driven == "b"


@pytest.mark.parametrize(
    "header", ["t,motor_deg [rad],load_deg", "t,motor [deg],load [deg]\ns,rad,rad"]
)
def test_units_that_disagree(ask, header):
    assert "the units deg and rad" in ask(csv(header, T, X, Y))


@pytest.mark.parametrize("name", ["giri motor", "obroty motor", "motor"])
def test_a_speed_with_the_name_of_a_shaft_is_asked_for(ask, columns, name):
    speeds = [np.gradient(angle, T) for angle in (X, Y)]
    text = csv(f"t,{name},load,a,b", T, *speeds, X, Y)
    told = ask(text, unit="deg")
    assert f"`{name}` says driving" in told and "the speed of `a`" in told
    stated = {"driving": "a", "driven": "b"}
    assert columns(text, unit="deg", columns=stated).driving == "a"
    assert columns(csv("t,motor,load,a,b", T, X, Y, *speeds), unit="deg").driving == "motor"


@pytest.mark.parametrize(
    "name",
    ["motor_milli_deg", "motor milli [deg]", "motor_x1000_deg", "motor_1e-3_deg", "1000*motor_deg"],
)
def test_a_scale_in_a_name_is_no_unit(ask, columns, name):
    text = csv(f"t,{name},{name.replace('motor', 'load')}", T, 1000 * X, 1000 * Y)
    told = ask(text)
    assert "holds a scale" in told and "--unit driving=mdeg" in told
    assert columns(text, unit="mdeg").driving == name


@pytest.mark.parametrize(
    "name", ["motor 1 [deg]", "motor_x2_deg", "motor_100_deg", "m10 motor_deg"]
)
def test_numbers_that_are_no_scale(columns, name):
    assert columns(csv(f"t,{name},load_deg", T, X, Y)).driving == name


@pytest.mark.parametrize("name", ["motor Vorgabe [deg]", "motor NC [deg]"])
def test_two_columns_of_one_angle_are_asked_for(ask, columns, name):
    planned = X + 0.05 * np.sin(np.arange(len(T)) / 30)
    text = csv(f"t,{name},encoder 1 [deg],load [deg]", T, planned, X, Y)
    told = ask(text)
    assert "hold nearly the same angle" in told and "--column driving='encoder 1 [deg]'" in told
    stated = {"driving": "encoder 1 [deg]"}
    assert columns(text, columns=stated).driving == "encoder 1 [deg]"


def test_one_reading_in_two_units_is_not_asked_for(columns):
    rows = np.stack([T, X, np.radians(X), Y], axis=1).tolist()
    text = "\n".join(["t,motor [deg],e1 [rad],load [deg]", *(",".join(map(repr, r)) for r in rows)])
    assert columns(text + "\n").driving == "motor [deg]"


@pytest.mark.parametrize("chosen", ["time motor [s]", "time load [s]"])
def test_two_clocks_side_by_side(ask, columns, chosen):
    head = "time motor [s],motor [deg],time load [s],load [deg]"
    told = ask(csv(head, T, X, 1.001 * T, Y), columns={"time": chosen})
    assert "`motor [deg]` has the stamps `time motor [s]`" in told and "long table" in told
    same = csv(head, T, X, T + 5.0, Y)
    assert columns(same, columns={"time": chosen}).time == chosen
    apart = csv("time [s],motor [deg],load [deg],gps time [s]", T, X, Y, 1.001 * T)
    assert columns(apart, columns={"time": "time [s]"}).time == "time [s]"


def test_two_inputs_of_which_one_is_the_driven_shaft(ask, columns):
    text = csv("t,input 1 [deg],input 2 [deg]", T, X, Y)
    assert "--column driving='input 1 [deg]'" in ask(text)
    assert columns(text, columns={"driving": "input 1 [deg]"}).driven == "input 2 [deg]"


def test_names_that_do_not_turn_as_given_beside_columns_that_do(ask, columns):
    shifted = 1.2 * X + 3.0 * np.sin(np.arange(len(T)) / 40)
    told = ask(csv("t,motor,load,a,b", T, shifted, 0.9 * Y, X, Y), unit="deg")
    assert "the names say that `motor` drives `load`" in told and "`a` and `b` do" in told
    text = csv("t,motor,load,a,b", T, shifted, 0.9 * Y, X, Y)
    stated = {"driving": "motor", "driven": "load"}
    assert columns(text, columns=stated, unit="deg").driven == "load"  # the user said so
    # Without other columns that turn as given, the fit itself judges the ratio.
    assert columns(csv("t,motor,load", T, shifted, 0.9 * Y), unit="deg").driving == "motor"


def test_counts_that_no_column_has(ask):
    assert "leave it out" in ask(csv("t,motor_deg,load_deg", T, X, Y), counts=100)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ratio": "16:9", "teeth": "45/80"}, "both state the ratio"),
        ({"ratio": "0:9"}, "--ratio"),
        ({"ratio": None, "teeth": "45:80"}, "teeth of the driving and driven gear"),
        ({"counts": "1,2,3"}, "--counts"),
        ({"unit": "furlong"}, "is no unit"),
        ({"unit": {"load": "deg"}}, "is none of"),
        ({"invert": "load"}, "must be driving or driven"),
        ({"driving_rpm": "fast"}, "--driving-rpm"),
    ],
)
def test_wrong_statements(ask, options, words):
    assert words in ask(csv("t,motor_deg,load_deg", T, X, Y), **options)


def test_a_question_says_which_columns_do_not_change(ask):
    still = np.full(len(T), 7.25)
    told = ask(csv("t [s],p [deg],q [deg]", T, X, still), ratio="16:9")
    assert "left out, as they do not change: `q [deg]` (always 7.25)" in told
    several = ask(csv("t [s],motor a [deg],motor b [deg]", T, still, still), ratio="16:9")
    assert "`motor a [deg]` 7.25 in every row, a constant" in several


@pytest.mark.parametrize("slug", [*QUESTIONS])
def test_every_question_has_a_sentence_with_a_cure(slug):
    cures = ("give ", "--", "{options}", "write ", "interpolate ", "leave it out")
    assert any(cure in QUESTIONS[slug] for cure in cures)
    assert QUESTIONS[slug].endswith(".")


def test_every_guess_says_what_was_taken_and_why():
    assert all(", " in words for words in GUESSES.values())


def test_a_wrong_ratio_is_answered_with_that_of_the_columns(question):
    asked = question(csv("t,p_deg,q_deg", T, X, X / 150), ratio="100:1")
    assert asked.slug == "shafts-open" and asked.columns == ("p_deg", "q_deg")
    assert "--ratio 150:1 where `p_deg` drives `q_deg`" in asked.message
    known = question(csv("t,motor_deg,q_deg", T, X, X / 150), ratio="100:1")
    assert "--ratio 150:1 where `motor_deg` drives `q_deg`" in known.message
    assert "--ratio" not in question(csv("t,p_deg,q_deg", T, X, X**2), ratio="3:1").message


@pytest.mark.parametrize("word", ["joint", "link", "arm", "axis", "output", "secondary", "load"])
def test_words_for_the_side_of_the_output(columns, word):
    assert columns(csv(f"t,motor_deg,{word}_deg", T, X, Y)).driven == f"{word}_deg"
    assert columns(csv(f"t,{word} 1 motor_deg,x_deg", T, X, Y)).driven == "x_deg"


def test_two_words_for_the_side_of_the_output_say_nothing(columns):
    text = csv("t,motor_deg,axis 1_deg,axis 2_deg", T, X, 3 * X, Y)
    assert columns(text).driven == "axis 2_deg"


def test_equal_shafts_of_an_uncertain_slope(question, columns):
    """Over half a turn an error of order 4 makes the slope 2 % wrong, one way or the other."""
    x = 180 * np.abs((T / 4.6) % 2 - 1)
    y = x + 7.5 * np.sin(np.radians(4 * x) + 2.2)
    asked = question(csv("t_s,p_deg,q_deg", T, x, y), ratio="1:1")
    assert asked.slug == "several-pairs" and set(asked.columns) == {"p_deg", "q_deg"}
    assert "`p_deg` drives `q_deg`" in asked.message and "`q_deg` drives `p_deg`" in asked.message
    assert columns(csv("t_s,motor_deg,q_deg", T, x, y), ratio="1:1").driven == "q_deg"


PAIR = {"drive": {"ratio": "16:9"}}


def test_a_pair_file_has_the_same_recognition(tmp_path, question):
    path = tmp_path / "log.csv"
    path.write_text(csv("zeit,motor_deg,x9,load_deg", T, X, T**2, Y))
    log = read_log(path, parse_pair_spec(PAIR))
    assert dict(log.place.columns) == {"time": "zeit", "driving": "motor_deg", "driven": "load_deg"}
    assert log.spec is None and len(log.notes) >= 3
    twins = csv("t_s,motor a_deg,motor b_deg,load_deg", T, X, X, Y)
    assert question(twins, parse_pair_spec(PAIR)).slug == "several-columns"
    asked = question(csv("t_s,motor,load", T, X, Y), parse_pair_spec(PAIR))
    assert asked.slug == "no-unit" and "[unit]" in asked.message and "--unit" not in asked.message
