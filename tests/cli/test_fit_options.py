"""Every option of the model does something, on its own, to the fit of a cheap log."""

import copy
import inspect
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from tests.cli.drive import DELAY_S, FIRST_ARCSEC, TORQUE_ARCSEC, write_drive, write_pair
from tests.schemas import load_schema
from vttig_jax.cli.verbs.fit import command
from vttig_jax.identify.fit_settings import fields
from vttig_jax.identify.identification import fit


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    write_pair(folder / "pair.toml")
    write_pair(folder / "off.toml", "500001/1000000")
    write_drive(folder / "late.csv")
    write_drive(folder / "prompt.csv", delay_s=0.0, seed=1)
    write_drive(folder / "humming.csv", hum_arcsec=20.0)
    write_drive(folder / "wound.csv", torque_arcsec=TORQUE_ARCSEC)
    write_drive(folder / "again.csv", seed=2)
    write_drive(folder / "later.csv", seed=3, start_deg=40.0)
    return folder


@pytest.fixture(scope="module")
def known() -> dict:
    """Records by arguments."""
    return {}


@pytest.fixture
def fitted(folder, known, found, monkeypatch):
    """The record of a fit of logs by name, which is valid under its schema."""
    monkeypatch.chdir(folder)

    def run(*arguments, pair="pair.toml") -> dict:
        key = (*arguments, pair)
        if key not in known:
            known[key] = found("fit", *arguments, "--pair", pair)
        return known[key]

    return run


def delay(record: dict) -> dict:
    return record["parameters"]["delay_s"]


def not_fitted(delay_ms: int):
    """Function that says whether the delay of a record was taken as this."""
    return lambda record: (delay(record)["reason"] or "").startswith(f"not fitted: {delay_ms} ms")


def torque(record: dict) -> dict | None:
    return record["regressors"].get("torque_arcsec_per_unit")


def ratio(record: dict) -> dict | None:
    return record["regressors"].get("ratio")


def near(parameter: dict | None, truth: float) -> bool:
    return parameter is not None and abs(parameter["value"] - truth) < 4 * parameter["std"]


CASES = [
    # Options that do not touch each other share a fit, which has to show each of them.
    ("late.csv", {"--delay off": not_fitted(0), "--ratio-within 0": lambda r: ratio(r) is None}),
    ("late.csv", {"--delay 4ms": not_fitted(4)}),
    ("late.csv", {"--delay 0.004": lambda r: r["conditional_on"] == ["given_delay"]}),
    ("late.csv", {"--delay -0.002": not_fitted(-2), "--flank B": lambda r: r["flanks"] == ["B"]}),
    ("late.csv", {"--delay-within 1us": lambda r: not delay(r)["determined"]}),
    (
        "late.csv",
        {
            "--orders-within 0.01": lambda r: (
                not r["parameters"]["driving_amplitude_arcsec"]["determined"]
            )
        },
    ),
    ("late.csv", {"--widths-within 1e4": lambda r: r["checks"]["drift_arcsec"] > 0.1}),
    (
        "humming.csv",
        {"--lines report": lambda r: not any(x["joined"] for x in r["checks"]["lines"])},
    ),
]


@pytest.mark.parametrize(("log", "options"), CASES)
def test_every_option_changes_the_result(fitted, log, options):
    record, plain = fitted(log, *" ".join(options).split()), fitted(log)
    assert log != "humming.csv" or record["checks"]["lines"]
    for option, changed in options.items():
        assert changed(record), option
        assert not changed(plain), option


def test_what_is_found_is_the_truth(fitted):
    record = fitted("late.csv")
    assert near(delay(record), DELAY_S)
    for shaft, truth in FIRST_ARCSEC.items():
        assert near(record["parameters"][f"{shaft}_amplitude_arcsec"], truth)
    assert near(torque(fitted("wound.csv")), TORQUE_ARCSEC)
    assert near(torque(record), 0.0)
    assert near(ratio(fitted("late.csv", pair="off.toml")), 0.5)


TOGETHER = [
    *("--delay", "0.004", "--ratio-within", "0.01", "--lines", "report", "--own-zero"),
    *("--column", "time=time_s", "--decimal", ".", "--no-figures", "--out", "all"),
]


def test_all_together_and_again(fitted, folder, found):
    first = fitted("late.csv", "later.csv", *TOGETHER)
    assert set(first["regressors"]) >= {"torque_arcsec_per_unit", "ratio"}
    kept = json.loads((folder / "all" / "fit.json").read_text())
    assert len(kept.pop("run")) == len(kept.pop("arrays")) == 64
    assert found("fit", "--run", folder / "all") == kept


@pytest.mark.parametrize("zero", ["--same-zero", "--own-zero"])
def test_several_logs_share_the_rig(fitted, zero):
    one, two = fitted("late.csv"), fitted("late.csv", "again.csv", zero)
    assert [log["source"] for log in two["logs"]] == ["late.csv", "again.csv"]
    assert len(one["logs"]) == 1
    for name in ("driving_amplitude_arcsec", "delay_s"):
        assert two["parameters"][name]["std"] < 0.85 * one["parameters"][name]["std"]
    assert two["samples"]["read"] == sum(log["samples"]["read"] for log in two["logs"])


def test_zeros_of_several_logs(fitted):
    free = fitted("late.csv", "later.csv", "--own-zero")["logs"][1]["start"]
    assert free["driving_deg"] == pytest.approx(40.0, abs=4 * free["driving_std_deg"])
    assert fitted("late.csv", "later.csv")["logs"][1]["start"] == free
    held = fitted("late.csv", "again.csv", "--same-zero")["logs"][1]["start"]
    assert (held["driving_deg"], held["driving_std_deg"]) == (0, 0)
    assert fitted("late.csv", "again.csv")["logs"][1]["start"]["driving_std_deg"] > 0


def test_options_that_cannot_be_followed(folder, refused, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "copy.csv").write_bytes((folder / "late.csv").read_bytes())
    for arguments, words in (
        ("--delay soon", "neither auto, off nor a number of seconds"),
        ("--delay 1.5", "within ±1"),
        ("--delay 1500ms", "such as 0.5ms, within ±1 s"),
        ("--delay nan", "within ±1"),
        ("--delay off --delay-within 2", "--delay and --delay-within exclude"),
        ("--ratio-within 0.5", "--ratio-within"),
        ("--lines drop", "--lines"),
        ("--same-zero", "--same-zero compares several logs"),
        ("--own-zero", "--own-zero compares several logs"),
        ("late.csv", "late.csv: given twice"),
        ("copy.csv", "copy.csv: the same data as late.csv"),
        ("--column driving=driving_deg --column driving=x", "named twice"),
        ("--column load=torque_nm", "ROLE=NAME"),
        ("--require load", "no such parameter"),
        ("--use-readings", "--backlash-readings"),
        ("--perfect-gears --perfect-encoders", "leave nothing to fit"),
    ):
        refused(2, words, "fit", "late.csv", *arguments.split(), "--pair", "pair.toml")
    zeros = ("late.csv", "later.csv", "--same-zero", "--pair", "pair.toml")
    refused(3, "not with the same zero", "fit", *zeros)


def test_a_regressor_can_be_required(fitted, vttig):
    assert ratio(fitted("late.csv", "--require", "ratio"))
    code, _, err = vttig("fit", "late.csv", "--ratio-within", "0", "--require", "ratio")
    assert code != 0 and "ratio" in err


def test_every_setting_has_an_option():
    parameters_of_fit = {parameter.name: parameter for parameter in command.params}
    keywords = inspect.signature(fit).parameters
    for field in fields():
        option = parameters_of_fit[field.name]
        assert keywords[field.name].default == field.default
        assert option.help == field.text
        assert [*option.opts, *option.secondary_opts] == field.option.split("/")


MANGLED = [
    lambda r: r["logs"].clear(),
    lambda r: r["logs"][0].pop("sha256"),
    lambda r: r["logs"][0]["samples"].pop("masked"),
    lambda r: r["logs"][0].update(zero="end"),
    lambda r: r["regressors"]["ratio"].pop("unit"),
    lambda r: r["regressors"].update(ratio=0.5),
    lambda r: r["parameters"]["delay_s"].update(determined="yes"),
    lambda r: r["checks"].update(outliers=2.0),
    lambda r: r["checks"]["ratio"][0].update(verdict="fine"),
    lambda r: r["checks"].update(passes=0),
    lambda r: r["checks"].update(gap_over_angles_covered={"value": 1.0}),
    lambda r: r["checks"].update(lines=[{"cycles_per_rev": 3.0}]),
    lambda r: r["checks"]["likelihood_ratio"].update(drift=-1.0),
    lambda r: r["checks"].update(delay_by_parts=[{}]),
    lambda r: r["findings"].append({"slug": "drift"}),
]


def test_the_schema_refuses_mangled_records(fitted):
    record = fitted("late.csv", "later.csv", *TOGETHER)
    schema = load_schema("vttig.fit/1")
    for mangle in MANGLED:
        broken = copy.deepcopy(record)
        mangle(broken)
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(broken, schema)


@pytest.fixture
def readings(folder) -> Path:
    """The gap of the drive, 100″ everywhere, read with 1″ of noise."""
    angle = np.arange(0.0, 3000.0, 37.0)
    gap = (100.0 + np.random.default_rng(0).standard_normal(len(angle))) / 3600
    path = folder / "readings.csv"
    rows = "".join(f"{a},{g:.7f}\n" for a, g in zip(angle, gap, strict=True))
    path.write_text("driving_deg,backlash_deg\n" + rows)
    return path


def test_readings_are_kept_in_the_run_and_guarded(readings, told, refused, folder, monkeypatch):
    monkeypatch.chdir(folder)
    options = ("--backlash-readings", "readings.csv", "--use-readings", "--no-figures")
    told("fit", "prompt.csv", "--pair", "pair.toml", *options, "--out", "run")
    told("fit", "--run", "run/run.toml")
    readings.write_text(readings.read_text() + "5,0.02\n")
    refused(3, "file of readings has changed", "fit", "--run", "run/run.toml")
