"""`vttig fit` on gaps that the log does not tell, or that cannot be."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.commands import fit_into, write_log
from tests.identify.drives import drive, drive_log, level, there_and_back

ONE = '[drive]\nratio = "1"\n[fit]\ndriving_orders = [1]\ndriven_orders = [1]\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("gap")

    (folder / "one.toml").write_text(ONE)
    (folder / "half.toml").write_text(ONE.replace('"1"', '"1/2"'))
    right = drive_log(
        drive("1"),
        there_and_back([60, 100], 5),
        gap=level(200.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3),
    )
    write_log(folder / "right.csv", right)
    write_log(folder / "exchanged.csv", right, "driven", "driving")
    steady = drive_log(
        drive("1/2"),
        there_and_back([60, 60], 5, ramp_s=0.005),
        gap=level(200.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3) + 30 * np.sin(angle / 2 + 1),
        delay_s=level(5e-4),
    )
    write_log(folder / "steady.csv", steady)
    write_log(
        folder / "arc.csv", drive_log(drive("1"), there_and_back([30, 50], 0.4), gap=level(200.0))
    )
    return folder


@pytest.fixture
def steady(folder) -> tuple:
    """Arguments for the log at one speed."""
    return ("fit", folder / "steady.csv", "--pair", folder / "half.toml")


def test_exchanged_columns_contradict_every_gap(folder, vttig, vttig_json, found):
    files = ("fit", folder / "exchanged.csv", "--pair", folder / "one.toml")
    code, out, err = vttig(*files)
    assert code == 4 and "contradicts" in out
    assert "no gap is below zero: the columns are exchanged" in err
    code, shown = vttig_json(*files, "--out", folder / "run", "--no-figures")
    assert (code, shown["outcome"]) == (4, "contradicts")
    record = json.loads((folder / "run" / "fit.json").read_text(encoding="utf-8"))
    assert record["outcome"] == "contradicts"
    assert record["checks"]["gap_over_angles_covered"]["high95"] < 0
    right = found("fit", folder / "right.csv", "--pair", folder / "one.toml")
    gap = right["checks"]["gap_over_angles_covered"]["value"]
    assert right["outcome"] != "contradicts" and gap == pytest.approx(200 / 3600, abs=1e-3)


def test_the_bound_of_the_delay_is_an_option(steady, found, refused):
    halves = []
    for within_ms in (0.6, 1.2):
        parameters = found(*steady, "--delay-within", within_ms)["parameters"]
        assert parameters["backlash_plus_delay_deg"]["determined"]
        gap = parameters["constant_backlash_deg"]
        halves.append(gap["high95"] - gap["value"])
    assert halves[0] == pytest.approx(1.96 * 2 * 180 * 6e-4, rel=0.02)
    assert halves[1] == pytest.approx(2 * halves[0], rel=0.05)
    assert "backlash_plus_delay_deg" not in found(*steady, "--delay", "0")["parameters"]
    for value in ("2ms", "0.002s", "2000us", "2"):
        record = found(*steady, "--delay-within", value)
        assert record["conditional_on"] == ["delay_within_2_ms"]
    for value in ("0", "-1", "soon", "1e9", "2min"):
        refused(2, "--delay-within", *steady, "--delay-within", value)


def test_a_map_for_a_controller_needs_a_bound_of_the_delay(steady, told, refused, tmp_path):
    """At one speed the backlash contains a delay, and a controller would close by both."""
    _, log, _, pair = steady
    run, bounded, given = (
        fit_into(tmp_path / str(place), log, pair, *options)
        for place, options in enumerate(((), ("--delay-within", "0.6"), ("--delay", "0.0005")))
    )
    refused(2, "--delay-within if you know", "export", run, "--out", tmp_path / "open.json")
    assert not (tmp_path / "open.json").exists()
    told("export", run, "--out", tmp_path / "x.json", "--constant-backlash-deg", 0.06)
    for place in (bounded, given):
        told("export", place, "--out", tmp_path / f"{place.name}.json")
    kept = json.loads((bounded / "fit.json").read_text(encoding="utf-8"))
    assert kept["conditional_on"] == ["delay_within_0.6_ms"]
    assert "delay-open" in {one["slug"] for one in kept["findings"]}
    header, gap = tmp_path / "bounded.h", kept["parameters"]["constant_backlash_deg"]
    told("export", bounded, "--out", header, "--quantity", "backlash")
    assert f"between {gap['low95']:.6g}" in " ".join(header.read_text().split())
    # A header lacks a delay and a geometry: what is in the way is named, one after the other.
    export = ("export", run, "--out", tmp_path / "x.h")
    backlash, constant = ("--quantity", "backlash"), ("--constant-backlash-deg", 0.06)
    assert "no axial" not in refused(2, "a controller", *export)
    refused(2, "--delay-within", *export, *backlash)
    refused(2, "--quantity backlash", *export, *constant)
    told(*export, *backlash, *constant)


def test_a_required_value_that_may_be_zero_is_told(folder, vttig):
    """The log has no delay: it is determined, so the exit code is 0, but it is not significant."""
    files = ("fit", folder / "right.csv", "--pair", folder / "one.toml")
    code, _, err = vttig(*files, "--require", "delay_s")
    assert code == 0
    assert "delay_s is determined, as --require asks, but not significant (" in err
    code, _, err = vttig(*files, "--require", "constant_backlash_deg")
    assert (code, err) == (0, "")


def test_an_arc_tells_only_its_gap(folder, vttig, vttig_json, told, found, tmp_path):
    files = ("fit", folder / "arc.csv", "--pair", folder / "one.toml", "--delay", "off")
    code, out, err = vttig(*files)
    assert code == 4 and "gap_over_angles_covered" in out
    assert "only the gap over the covered angles: 0.05" in err
    code, shown = vttig_json(*files, "--out", tmp_path / "run", "--no-figures")
    gap = shown["checks"]["gap_over_angles_covered"]
    assert (code, shown["outcome"]) == (4, "not_determined")
    assert gap["low95"] <= 200 / 3600 <= gap["high95"]
    assert shown["parameters"]["gap_over_angles_covered"]["value"] == gap["value"]
    assert "extrapolated" in told("map", tmp_path / "run")
    record = found("map", tmp_path / "run")
    assert (record["smallest"], record["safe_closing_mm"]) == (None, None)
    assert record["gap_over_angles_covered"] == gap
