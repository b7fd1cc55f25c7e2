"""`vttig calibrate`: coverage tables, exit codes, files."""

import json

import click
import pytest
from vttig_jax.posterior.calibration.scenarios import SCENARIOS

from vttig_jax.cli.main import VERBS
from vttig_jax.cli.verbs.calibrate import _NAMES, command

QUICK = ("calibrate", "--scenario", "encoders_left_out", "--short", "--rigs", "60")


@pytest.fixture(autouse=True)
def _verb(monkeypatch):
    monkeypatch.setitem(VERBS, "calibrate", ("vttig_jax.cli.verbs.calibrate:command", "Check."))


def test_names_are_those_of_the_scenarios():
    assert list(SCENARIOS) == list(_NAMES)
    scenario = next(p for p in command.params if p.name == "names")
    assert isinstance(scenario.type, click.Choice)


@pytest.mark.portable
def test_a_wrong_model_is_seen_to_fail(vttig_json):
    code, record = vttig_json(*QUICK)
    assert code == 0
    assert record["calibrated"] and record["cases"][0]["verdict"] == "seen to fail"


def test_table_and_file(vttig, tmp_path):
    out = tmp_path / "found"
    code, text, _ = vttig(*QUICK, "--out", out)
    assert code == 0
    assert "encoders_left_out (short)" in text
    record = json.loads((out / "calibration.json").read_text())
    assert record["schema"] == "vttig.calibrate/1" and record["seed"] == 0
    assert vttig(*QUICK, "--out", out)[0] == 2


def test_intervals_that_do_not_hold_are_exit_4(vttig, monkeypatch):
    from dataclasses import replace

    wrong = replace(SCENARIOS["encoders_left_out"], holds=True)
    monkeypatch.setitem(SCENARIOS, "encoders_left_out", wrong)
    code, out, err = vttig(*QUICK)
    assert code == 4
    assert "calibrated: NO" in out
    assert "intervals do not hold in encoders_left_out (short)" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--rigs", "3"), "20"),
        (("--rigs", "1000000000000"), "1000000"),
        (("--rigs", "50", "--posterior", "51"), "--posterior 51 is more than --rigs 50"),
        (("--scenario", "rainbow"), "rainbow"),
        (("--overwrite",), "--out"),
        (("--seed", "-1"), "-1"),
    ],
)
def test_usage(vttig, arguments, said):
    code, _, err = vttig("calibrate", *arguments)
    assert code == 2 and said in err
