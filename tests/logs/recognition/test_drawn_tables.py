"""Drawn tables end in the right roles and units or in a question, never in a wrong answer."""

from dataclasses import replace
from itertools import cycle, product

import numpy as np
import pytest

from tests.logs.recognition.draws import LANGUAGES, Drawn, drawn_table
from tests.logs.rig_log import csv
from vttig_jax import LogError, UsageError, read_log

X = np.concatenate([np.arange(0, 720, 30), np.arange(720, 0, -30)])
T, Y = np.arange(len(X)) / 20, X * 9 / 16 + 0.02 * np.sin(np.radians(X) + 1)


def outcome(path, table: Drawn) -> str:
    """ "right", "asked", or what was read wrongly."""
    path.write_text(table.text, encoding="utf-8")
    try:
        log = read_log(path, **table.options)
    except (LogError, UsageError) as question:
        return "asked" if "--" in str(question) else f"no cure in {question}"
    assert log.spec is not None and log.driven is not None
    found = {role: getattr(log.spec.log, role) for role in table.roles}
    if found == table.roles and {log.driving.unit, log.driven.unit} == {table.unit}:
        return "right"
    return f"{found} in place of {table.roles} from {table.options}"


def outcomes(path, seeds: range) -> tuple[list[str], int]:
    """What was read wrongly, and the number of tables read right."""
    found = [outcome(path, drawn_table(seed)) for seed in seeds]
    return [one for one in found if one not in ("right", "asked")], found.count("right")


def test_tables_in_many_languages(tmp_path):
    wrong, right = outcomes(tmp_path / "log.csv", range(7000, 7030))
    assert wrong == [] and right >= 8  # asking always is no answer


@pytest.mark.slow
def test_a_thousand_tables_in_many_languages(tmp_path):
    wrong, right = outcomes(tmp_path / "log.csv", range(1000))
    assert wrong == [] and right >= 350


def test_a_wrong_answer_is_seen(tmp_path):
    path = tmp_path / "log.csv"
    table = next(one for one in map(drawn_table, range(60)) if outcome(path, one) == "right")
    swapped = table.roles | {"driving": table.roles["driven"], "driven": table.roles["driving"]}
    assert "in place of" in outcome(path, replace(table, roles=swapped))
    assert "in place of" in outcome(path, replace(table, unit="gon"))


def roles(path, columns: dict[str, np.ndarray]) -> tuple[str | None, ...]:
    """Names of the time, the driving and the driven column; none if the log is asked about."""
    path.write_text(csv(";".join(columns), *columns.values(), mark=";"), encoding="utf-8")
    try:
        spec = read_log(path, ratio="16:9", unit="deg").spec
    except LogError:
        return ()
    assert spec is not None
    return spec.log.time, spec.log.driving, spec.log.driven


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("language", [name for name in LANGUAGES if name != "none"])
def test_names_in_a_language(tmp_path, language):
    """Every pair of names says its roles beside any word, and other quantities are left out."""
    words = LANGUAGES[language]
    times = cycle(words.time)
    for (first, second), angle in product(words.shafts, ("", *words.angle)):
        names, time = (f"{first} {angle}".strip(), f"{angle}_{second}".strip("_")), next(times)
        columns = {names[1]: Y, f"{time} [s]": T, names[0]: X}
        assert roles(tmp_path / "log.csv", columns) == (f"{time} [s]", *names)
    for word in (*words.setpoint, *words.others.values()):
        other = f"{words.shafts[0][0]} {word}"
        columns = {"t [s]": T, other: X, "p [deg]": X, "q [deg]": Y}
        assert other not in roles(tmp_path / "log.csv", columns)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "names",
    [
        "Motordrehzahl Motortemperatur Motorsollwert Antriebssollwinkel Abtriebsdrehmoment",
        "Lastmoment motortemp motorvarvtal outputtorque inputspeed load_N 모터전류",
        "motor_following_error",
    ],
)
def test_compounds_that_are_no_angle(tmp_path, names):
    for name in names.split():
        columns = {"t [s]": T, name: X, "p [deg]": X, "q [deg]": Y}
        assert name not in roles(tmp_path / "log.csv", columns)
    for name in ("Motorwinkel", "Motorgeber"):
        columns = {"t [s]": T, name: X, "q [deg]": Y}
        assert roles(tmp_path / "log.csv", columns)[1] == name
