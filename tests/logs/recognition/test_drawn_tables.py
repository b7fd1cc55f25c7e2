"""Drawn tables end in the right roles and units or in a question, never in a wrong answer."""

import numpy as np
import pytest

from tests.logs.recognition.draws import LANGUAGES, drawn_table
from tests.logs.rig_log import csv
from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.base.units import ANGLE_UNITS, DEG
from vttig_jax.logs import read_log
from vttig_jax.logs.recognition.names import read_name

NAMES = (
    ("driving", "driven"),
    ("motor", "load"),
    ("input shaft", "output shaft"),
    ("Antrieb", "Abtrieb"),
    ("Motorwinkel", "Lastwinkel"),
    ("Winkel_Eingang", "Winkel_Ausgang"),
    ("entrée", "sortie"),
    ("moteur", "charge"),
    ("entrada", "salida"),
    ("ingresso", "uscita"),
    ("ingaande as", "uitgaande as"),
    ("silnik", "wyjście"),
    ("電机", "负载"),
    ("駆動角", "被駆動角"),
    ("入力角度", "出力角度"),
    ("двигатель", "выход"),
    ("theta_in", "theta_out"),
    ("MotPos", "LoadPos"),
    ("MAIN.fbMotor.ActPos", "MAIN.fbLoad.ActPos"),
    ("a", "b"),
    ("enc1", "enc2"),
    ("phi", "psi"),
    ("motor output", "load output"),
    ("drive motor", "x2"),
)
TIMES = ("time", "t", "Zeit", "temps", "zzz", "timestamp", "时间")
SHAPES = {
    "suffix": "{}_{}",
    "bracket": "{} [{}]",
    "round": "{} ({})",
    "none": "{}",
}
COUNTS = 14400


def drawn(seed: int) -> tuple[str, dict, dict]:
    """The text of a log, keywords of `read_log`, and its truth: column → role and unit."""
    rng = np.random.default_rng(seed)
    turns = int(rng.integers(1, 40)), int(rng.integers(1, 40))
    equal = rng.random() < 0.15
    driving_turns, driven_turns = (1, 1) if equal else turns
    ratio = driven_turns / driving_turns
    size = int(rng.integers(300, 700))
    time = np.arange(size) * float(rng.choice([0.002, 0.01, 0.0125]))
    one_way = rng.random() < 0.25
    shape = np.linspace(0, 1, size) if one_way else 1 - np.abs(np.linspace(-1, 1, size))
    x = 360 * rng.uniform(3, 12) * max(1.0, 1 / ratio) * shape
    y = ratio * x + 0.02 * np.sin(np.radians(x) + 1) + 0.03 * np.sin(np.radians(ratio * x))
    unit = str(rng.choice(["deg", "rad", "rev", "counts"]))
    inverted = rng.random() < 0.1
    if inverted:
        y = -y
    wrapped = rng.random() < 0.3 and unit != "counts"
    shafts = [np.mod(one, 360) if wrapped else one for one in (x, y)]
    if unit == "counts":
        shafts = [np.rint(one / 360 * COUNTS).astype(int) for one in shafts]
    else:
        shafts = [one * DEG / ANGLE_UNITS[unit] for one in shafts]
    form = SHAPES[str(rng.choice([*SHAPES]))]
    first, second = NAMES[int(rng.integers(len(NAMES)))]
    stamp = str(rng.choice(TIMES)) + str(rng.choice(["", "_s", " [s]"]))
    named = [form.format(name, unit) for name in (first, second)]
    columns = {stamp: time, named[0]: shafts[0], named[1]: shafts[1]}
    noise = rng.normal(0, 1, size)
    distractors = {
        "Moment [Nm]": noise,
        "motor_temp": 20 + 0.1 * noise,
        "row": np.arange(size),
        "noise": noise,
        "load_torque_nm": noise,
        "Motor Soll [°]": x,
        "x9": np.cumsum(np.abs(noise)),
        "motor_speed_rpm": np.gradient(x, time) / 6,
        "copy": shafts[0],
    }
    for name in rng.permutation([*distractors])[: int(rng.integers(0, 4))]:
        columns.setdefault(str(name), distractors[str(name)])
    order = [str(name) for name in rng.permutation([*columns])]
    text = csv(",".join(order), *(columns[name] for name in order))
    stated = f"{driving_turns}:{driven_turns}" if rng.random() < 0.8 else str(ratio)
    options: dict = {"ratio": stated}
    if unit == "counts":
        options["counts"] = COUNTS
    elif rng.random() < 0.7 and form == "{}":
        options["unit"] = unit
    if inverted and rng.random() < 0.7:
        options["invert"] = "driven"
    truth = {"time": stamp, "driving": named[0], "driven": named[1], "unit": unit}
    return text, options, truth


def outcome(tmp_path, seed: int) -> tuple[str, str]:
    """ "right", "asked" or "wrong", with what was read."""
    text, options, truth = drawn(seed)
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    try:
        log = read_log(path, **options)
    except (LogError, UsageError) as question:
        return ("asked" if "--" in str(question) else "wrong"), str(question)
    assert log.spec is not None and log.driven is not None
    found = log.spec.log
    units = {log.driving.unit, log.driven.unit}
    same = (found.time, found.driving, found.driven) == tuple(
        truth[role] for role in ("time", "driving", "driven")
    )
    if same and units == {truth["unit"]}:
        return "right", ""
    return "wrong", f"{seed}: {found} with {units} in place of {truth} from {options}"


def test_thirty_tables(tmp_path):
    seen = [outcome(tmp_path, seed) for seed in range(30)]
    assert [what for verdict, what in seen if verdict == "wrong"] == []
    assert sum(verdict == "right" for verdict, _ in seen) >= 8  # asking always is no answer


@pytest.mark.slow
def test_three_hundred_tables(tmp_path):
    seen = [outcome(tmp_path, seed) for seed in range(300)]
    assert [what for verdict, what in seen if verdict == "wrong"] == []
    assert sum(verdict == "right" for verdict, _ in seen) >= 75


def in_languages(tmp_path, seeds: range) -> tuple[list[str], int]:
    """What was read wrongly, and the number of tables read right, of tables in many languages."""
    wrong, right = [], 0
    path = tmp_path / "log.csv"
    for seed in seeds:
        table = drawn_table(seed)
        path.write_text(table.text, encoding="utf-8")
        try:
            log = read_log(path, **table.options)
        except (LogError, UsageError):
            continue
        assert log.spec is not None and log.driven is not None
        found = {role: getattr(log.spec.log, role) for role in table.roles}
        if found == table.roles and {log.driving.unit, log.driven.unit} == {table.unit}:
            right += 1
        else:
            wrong.append(f"{seed}: {found} in place of {table.roles} from {table.options}")
    return wrong, right


def test_tables_in_many_languages(tmp_path):
    wrong, right = in_languages(tmp_path, range(7000, 7040))
    assert wrong == [] and right >= 10


@pytest.mark.slow
def test_a_thousand_tables_in_many_languages(tmp_path):
    wrong, right = in_languages(tmp_path, range(1000))
    assert wrong == [] and right >= 350


@pytest.mark.parametrize("language", [name for name in LANGUAGES if name != "none"])
def test_names_of_shafts_in_a_language(language):
    """Every pair of names says its roles, alone and beside the word for an angle."""
    words = LANGUAGES[language]
    for first, second in words.shafts:
        for angle in ("", *words.angle):
            assert read_name(f"{first} {angle}".strip(), "log.csv").role == "driving"
            assert read_name(f"{angle}_{second}".strip("_"), "log.csv").role == "driven"
    assert all(read_name(name, "log.csv").role == "time" for name in words.time if name != "zzz")
    others = [*words.setpoint, *words.others.values()]
    readings = [read_name(f"{words.shafts[0][0]} {word}", "log.csv") for word in others]
    assert all(reading.setpoint or reading.other for reading in readings)


@pytest.mark.parametrize(
    "name",
    [
        "Motordrehzahl",
        "Motortemperatur",
        "Motorsollwert",
        "Antriebssollwinkel",
        "Abtriebsdrehmoment",
        "Lastmoment",
        "motortemp",
        "motorvarvtal",
        "outputtorque",
        "inputspeed",
        "load_N",
        "motor_following_error",
        "모터전류",
    ],
)
def test_compounds_that_are_no_angle(name):
    reading = read_name(name, "log.csv")
    assert reading.other or reading.setpoint


@pytest.mark.parametrize(
    "name", ["Motorwinkel", "Lastlage", "temps", "outputangle", "Motorgeber", "angle"]
)
def test_names_without_another_quantity(name):
    reading = read_name(name, "log.csv")
    assert not reading.other and not reading.setpoint


def test_a_wrong_answer_is_seen(tmp_path, monkeypatch):
    from tests.logs.recognition import test_drawn_tables as module

    text, options, truth = next(
        one for one in map(drawn, range(60)) if outcome_of(tmp_path, one) == "right"
    )
    swapped = truth | {"driving": truth["driven"], "driven": truth["driving"]}
    monkeypatch.setattr(module, "drawn", lambda _: (text, options, swapped))
    assert module.outcome(tmp_path, 0)[0] == "wrong"


def outcome_of(tmp_path, table) -> str:
    """Verdict of one drawn table."""
    text, options, _ = table
    path = tmp_path / "one.csv"
    path.write_text(text, encoding="utf-8")
    try:
        read_log(path, **options)
    except (LogError, UsageError):
        return "asked"
    return "right"
