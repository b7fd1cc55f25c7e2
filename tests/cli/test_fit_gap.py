"""`vttig fit` on gaps that the log does not tell, or that cannot be."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.base.units import DEG

ONE = '[drive]\nratio = "1"\n[fit]\ndriving_orders = [1]\ndriven_orders = [1]\n'
HALF = ONE.replace('"1"', '"1/2"')


def _write(path: Path, time, driving, driven) -> None:
    table = np.stack([time, driving / DEG, driven / DEG], axis=1)
    np.savetxt(path, table, "%.8f", ",", header="time_s,driving_deg,driven_deg", comments="")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("gap")
    (folder / "one.toml").write_text(ONE)
    (folder / "half.toml").write_text(HALF)
    log = drive_log(
        drive("1"),
        there_and_back([60, 100], 5),
        gap=level(200.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3),
    )
    _write(folder / "right.csv", log.time, log.driving_angle, log.driven_angle)
    _write(folder / "exchanged.csv", log.time, log.driven_angle, log.driving_angle)
    log = drive_log(
        drive("1/2"),
        there_and_back([60, 60], 5, ramp_s=0.005),
        gap=level(200.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3) + 30 * np.sin(angle / 2 + 1),
        delay_s=level(5e-4),
    )
    _write(folder / "steady.csv", log.time, log.driving_angle, log.driven_angle)
    log = drive_log(drive("1"), there_and_back([30, 50], 0.4), gap=level(200.0))
    _write(folder / "arc.csv", log.time, log.driving_angle, log.driven_angle)
    return folder


def test_exchanged_columns_contradict_every_gap(folder, vttig, vttig_json):
    files = (folder / "exchanged.csv", "--pair", folder / "one.toml")
    code, out, err = vttig("fit", *files)
    assert code == 4
    assert "contradicts" in out
    assert "no gap is below zero: the columns are exchanged" in err
    code, shown = vttig_json("fit", *files, "--out", folder / "run", "--no-figures")
    assert (code, shown["outcome"]) == (4, "contradicts")
    record = json.loads((folder / "run" / "fit.json").read_text(encoding="utf-8"))
    assert record["outcome"] == "contradicts"
    assert record["checks"]["gap_over_angles_covered"]["high95"] < 0


def test_columns_in_order_contradict_nothing(folder, vttig_json):
    code, record = vttig_json("fit", folder / "right.csv", "--pair", folder / "one.toml")
    assert code == 0 and record["outcome"] != "contradicts"
    assert record["checks"]["gap_over_angles_covered"]["value"] == pytest.approx(
        200 / 3600, abs=1e-3
    )


def test_the_bound_of_the_delay_is_an_option(folder, vttig_json):
    files = (folder / "steady.csv", "--pair", folder / "half.toml")
    halves = []
    for within_ms in (0.6, 1.2):
        code, record = vttig_json("fit", *files, "--delay-within", within_ms)
        assert code == 0
        gap = record["parameters"]["constant_backlash_deg"]
        assert record["parameters"]["backlash_plus_delay_deg"]["determined"]
        halves.append(gap["high95"] - gap["value"])
    assert halves[0] == pytest.approx(1.96 * 2 * 180 * 6e-4, rel=0.02)
    assert halves[1] == pytest.approx(2 * halves[0], rel=0.05)
    _, given = vttig_json("fit", *files, "--delay", "0")
    assert "backlash_plus_delay_deg" not in given["parameters"]


def test_a_bound_that_is_none_is_refused(folder, vttig):
    for value in ("0", "-1", "soon", "1e9", "2min"):
        code, _, err = vttig(
            "fit", folder / "steady.csv", "--pair", folder / "half.toml", "--delay-within", value
        )
        assert code == 2
        assert "--delay-within" in err


def test_a_map_for_a_controller_needs_a_bound_of_the_delay(folder, vttig, tmp_path):
    """At one speed the backlash contains a delay, and a controller would close by both."""
    files = (folder / "steady.csv", "--pair", folder / "half.toml", "--no-figures")
    for place, options in (
        ("open", ()),
        ("bounded", ("--delay-within", 0.6)),
        ("told", ("--delay", 5e-4)),
    ):
        assert vttig("fit", *files, *options, "--out", tmp_path / place)[0] == 0
    code, _, err = vttig("export", tmp_path / "open", "--out", tmp_path / "open.json")
    assert (
        code == 2 and "--delay-within if you know" in err and not (tmp_path / "open.json").exists()
    )
    constant = ("--constant-backlash-deg", 0.06)
    assert vttig("export", tmp_path / "open", "--out", tmp_path / "open.json", *constant)[0] == 0
    for place in ("bounded", "told"):
        out = tmp_path / f"{place}.json"
        assert vttig("export", tmp_path / place, "--out", out)[0] == 0 and out.exists()
    kept = json.loads((tmp_path / "bounded" / "fit.json").read_text(encoding="utf-8"))
    assert kept["conditional_on"] == ["delay_within_0.6_ms"]
    assert "delay-open" in {one["slug"] for one in kept["findings"]}
    header = tmp_path / "bounded.h"
    only = ("--quantity", "backlash")
    assert vttig("export", tmp_path / "bounded", "--out", header, *only)[0] == 0
    gap = kept["parameters"]["constant_backlash_deg"]
    assert f"between {gap['low95']:.6g}" in " ".join(header.read_text().split())


def test_a_bound_of_the_delay_may_have_a_unit(folder, vttig_json):
    for value in ("2ms", "0.002s", "2000us", "2"):
        files = (folder / "steady.csv", "--pair", folder / "half.toml")
        _, record = vttig_json("fit", *files, "--delay-within", value)
        assert record["conditional_on"] == ["delay_within_2_ms"]


def test_an_export_names_what_is_in_the_way(folder, vttig, tmp_path):
    """A header of a drive at one speed lacks a delay and a geometry; one after the other."""
    files = (folder / "steady.csv", "--pair", folder / "half.toml", "--no-figures")
    assert vttig("fit", *files, "--out", tmp_path / "run")[0] == 0
    export = ("export", tmp_path / "run", "--out", tmp_path / "x.h")
    code, _, err = vttig(*export)
    assert code == 2 and err.count("\n") == 1
    assert "a controller" in err and "no axial" not in err
    for option, left in (
        (("--quantity", "backlash"), "--delay-within"),
        (("--constant-backlash-deg", 0.06), "--quantity backlash"),
    ):
        code, _, err = vttig(*export, *option)
        assert code == 2 and left in err
    both = ("--quantity", "backlash", "--constant-backlash-deg", 0.06)
    assert vttig(*export, *both)[0] == 0


def test_a_required_value_that_may_be_zero_is_told(folder, vttig):
    """The log has no delay: it is determined, so the exit code is 0, but it is not significant."""
    files = (folder / "right.csv", "--pair", folder / "one.toml")
    code, _, err = vttig("fit", *files, "--require", "delay_s")
    assert code == 0
    assert "delay_s is determined, as --require asks, but not significant (" in err
    code, _, err = vttig("fit", *files, "--require", "constant_backlash_deg")
    assert (code, err) == (0, "")


def test_an_arc_tells_only_its_gap(folder, vttig, vttig_json, tmp_path):
    files = (folder / "arc.csv", "--pair", folder / "one.toml", "--delay", "off")
    code, out, err = vttig("fit", *files)
    assert code == 4
    assert "gap_over_angles_covered" in out
    assert "only the gap over the covered angles: 0.05" in err
    code, shown = vttig_json("fit", *files, "--out", tmp_path / "run", "--no-figures")
    gap = shown["checks"]["gap_over_angles_covered"]
    assert (code, shown["outcome"]) == (4, "not_determined")
    assert gap["low95"] <= 200 / 3600 <= gap["high95"]
    assert shown["parameters"]["gap_over_angles_covered"]["value"] == gap["value"]
    code, out, _ = vttig("map", tmp_path / "run")
    assert code == 0 and "extrapolated" in out
    code, record = vttig_json("map", tmp_path / "run")
    assert (code, record["smallest"], record["safe_closing_mm"]) == (0, None, None)
    assert record["gap_over_angles_covered"] == gap
