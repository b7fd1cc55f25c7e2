import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import vttig_jax
from tests.cli.commands import table_of, write_paper_pair
from vttig_jax.base.errors import UsageError
from vttig_jax.base.files.json_io import dumps
from vttig_jax.cli.verbs.simulate import _stride
from vttig_jax.control.scenario.spec import default_toml
from vttig_jax.control.simulation import simulate as simulate_module
from vttig_jax.identify.backlash import contact_map
from vttig_jax.runs.run import open_run

SCENARIO = """
pair = "gears/pair.toml"
[eccentricities]
driving_mm = 0.0226
driving_phase_deg = 49.5
driven_mm = 0.0273
driven_phase_deg = 79.3
constant_backlash_deg = 0.038
[motion]
reversal_deg = 720.0
dwell_s = 0.2
"""
COLUMNS = (
    *("time_s", "driving_deg", "te_deg", "te_shown_deg", "flank_a_deg", "flank_b_deg"),
    *("output_error_deg", "speed_rad_s", "acceleration_rad_s2", "command_mm", "axial_mm"),
)


@pytest.fixture
def scenario(tmp_path) -> Path:
    """A scenario of the paper's rig; its pair file lies in a folder beside it."""
    (tmp_path / "gears").mkdir()
    write_paper_pair(tmp_path / "gears" / "pair.toml")
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """An empty folder to work in, so that paths relative to the scenario are seen to be."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def simulated(found):
    """Function that simulates with values of `--set`."""

    def simulate(scenario, *settings, options=()):
        arguments = (part for setting in settings for part in ("--set", setting))
        return found("simulate", scenario, "-q", *arguments, *options)

    return simulate


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.portable
def test_prints_the_run_of_the_library_and_writes_nothing(vttig, found, scenario, elsewhere):
    before = names(scenario.parent)
    code, out, err = vttig("simulate", scenario)
    assert (code, err) == (0, "")
    assert out.startswith("VTTIG rig of the paper\n")
    assert "rigid plant, controller acceleration" in out
    assert "reversal at 720°, trapezoid of 60 rpm, 5.4 s at 1000 Hz" in out
    assert re.search(r"[78] ms after the motor brakes, at 632\.\d+°, 87\.\d+° before the turn", out)
    assert "further than the gap allows" in out
    record, run = found("simulate", scenario), vttig_jax.simulate(scenario)
    assert record == json.loads(dumps(run.to_json())) and out == f"{run}\n"
    assert record["metrics"]["interference_mm"] > 0.1
    assert record["turn"]["driving_deg"] == pytest.approx(720.0)
    assert record["turn"]["time_s"] == pytest.approx(2.7)
    assert record["scenario"]["motion"]["dwell_s"] == 0.2
    assert names(elsewhere) == set() and names(scenario.parent) == before
    assert vttig("simulate", "--print-defaults") == (0, default_toml(), "")


def test_settings_are_those_of_a_file(simulated, scenario):
    record = simulated(
        scenario,
        "motion.event=emergency_stop",
        "motion.reversal_deg=1080",
        "actuator.stroke_mm=0.5",
        "judgement.threshold_rad_s2=1e9",
    )
    text = SCENARIO.replace("720.0", '1080\nevent = "emergency_stop"')
    scenario.write_text(f"{text}[actuator]\nstroke_mm = 0.5\n[judgement]\nthreshold_rad_s2 = 1e9\n")
    assert simulated(scenario) == record
    assert record["metrics"]["detection_deg"] is None
    # Left open, the flanks change while the shaft still turns forward.
    gap = record["turn"]["backlash_deg"]
    assert record["metrics"]["jump_deg"] == pytest.approx(gap, abs=2e-3)
    assert record["crossing_deg"] < 1079


@pytest.mark.parametrize(
    ("setting", "outcome", "words"),
    [
        ("actuator.stroke_mm=0.2", "stroke", "actuator.stroke_mm is 0.2"),
        ("actuator.speed_mm_s=0.1", "slow", "still lacks"),
        ("judgement.threshold_rad_s2=30", "missed", "lower judgement.threshold_rad_s2"),
        ("mesh.friction_coefficient=0.1", "bound", "The drive blocks after 2.0"),
    ],
)
def test_whatever_comes_of_a_run_is_a_result(
    vttig, simulated, scenario, elsewhere, setting, outcome, words
):
    code, out, err = vttig("simulate", scenario, "--set", setting)
    assert (code, err) == (0, "") and words in out and "nan" not in out
    record = simulated(scenario, setting, options=("--trace", "trace.csv"))
    assert record["metrics"]["outcome"] == outcome and words in record["remarks"][0]
    if outcome == "bound":  # the trace ends where the drive blocks
        last = table_of(Path("trace.csv"))["time_s"][-1]
        assert 0 <= record["blocked_s"] - last < 0.002
        assert record["blocked_s"] < record["duration_s"] / 2


def test_trace_and_figure_of_one_run(refused, told, simulated, scenario, elsewhere):
    files = ("--trace", "new/trace.csv", "--figure", "run.png")
    record = simulated(scenario, options=files)
    assert Path("run.png").read_bytes().startswith(b"\x89PNG")
    table, metrics = table_of(Path("new/trace.csv")), record["metrics"]
    assert table.dtype.names == COLUMNS and len(table) == record["samples"] == 5401
    shown = table["te_shown_deg"] - table["te_shown_deg"][0]
    assert shown.max() == pytest.approx(metrics["te_max_deg"], abs=1e-8)
    assert shown.mean() == pytest.approx(metrics["te_mean_deg"], abs=1e-8)
    first = table[table["command_mm"] > 0][0]
    assert first["driving_deg"] == pytest.approx(metrics["detection_deg"], abs=1e-6)
    assert (table["te_deg"] >= table["flank_a_deg"] - 1e-9).all()
    assert (table["te_deg"] <= table["flank_b_deg"] + 1e-9).all()
    refused(2, "new/trace.csv: already exists; add --overwrite", "simulate", scenario, *files)
    told("simulate", scenario, *files[:2], "--every", 7, "--overwrite")
    np.testing.assert_array_equal(table_of(Path("new/trace.csv")), table[::7])


def test_a_recorded_motion_lies_beside_the_scenario(vttig, scenario, elsewhere, monkeypatch):
    """What the run costs is spared: it is interrupted, and then writes nothing."""
    built = []

    def run(case, *_):
        built.append(case)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulate_module, "run_in_chunks", run)
    motion = scenario.parent / "gears" / "motion.csv"
    motion.write_text("time_s,driving_deg\n0,0\n1,90\n2,180\n3,90\n4,0\n")
    settings = ("--set", "motion.kind=recorded", "--set", "motion.file=gears/motion.csv")
    code, out, err = vttig("simulate", scenario, *settings, "--trace", "trace.csv")
    assert (code, out) == (130, "") and "interrupted" in err and names(elsewhere) == set()
    (case,) = built
    assert case.motion.duration_s == 4.0
    assert float(case.motion.at(2.0).angle) == pytest.approx(np.pi)


def with_rig(folder: Path, run: str, **more: int) -> Path:
    """A scenario whose rig is that of a run folder."""
    kept = tomllib.loads(SCENARIO)
    del kept["eccentricities"]
    path = folder / "fitted.toml"
    path.write_text(tomli_w.dumps(kept | {"rig": {"from": run, **more}}))
    return path


def test_the_rig_of_a_run_folder_which_is_a_scenario_itself(simulated, scenario, run_folder):
    record = simulated(with_rig(scenario.parent, str(run_folder)), "controller=none")
    assert record["scenario"]["rig"] == {"from": str(run_folder)}
    _, model = contact_map(open_run(run_folder).fit)
    gap = np.degrees(float(model.backlash(np.radians(record["crossing_deg"]))))
    assert record["metrics"]["jump_deg"] == pytest.approx(gap, abs=1e-9)
    record = simulated(run_folder, "motion.reversal_deg=720")
    assert record["scenario"]["rig"] == {"from": str(run_folder)}
    assert record["controller"] == "acceleration" and record["metrics"]["detection_deg"] > 600


def test_a_rig_that_one_case_cannot_have(refused, scenario, run_folder):
    folder = scenario.parent
    for more, words in (
        ({}, "map 'nowhere': no map can be read here"),
        ({"draws": 3}, "rig.draws: one case runs with the fitted rig; remove this key"),
        ({"seed": 3}, "rig.seed"),
    ):
        refused(3, words, "simulate", with_rig(folder, "nowhere", **more))
    path, gears = with_rig(folder, str(run_folder)), folder / "gears" / "pair.toml"
    text = gears.read_text()
    for old, new, words in (
        ("teeth = 45", "teeth = 44", "teeth 44/80 here, 45/80 there"),
        ("module_mm = 2.0", "module_mm = 1.99", "module 1.99 mm here, 2 mm there"),
    ):
        assert old in text
        (folder / "other.toml").write_text(text.replace(old, new))
        refused(3, words, "simulate", path, "--set", "pair=other.toml")
    gears.write_text(text.replace(old, new))
    refused(3, words, "simulate", path)


def test_one_run_serves_trace_and_figure():
    for periods, every, draws, kept in (
        (5e3, 0, False, 0),
        (5e3, 0, True, 1),
        (5e3, 7, False, 7),
        (5e3, 7, True, 1),
        (6e6, 0, True, 6),
        (6e6, 4, True, 2),
        (6e9, 600, False, 600),
    ):
        assert _stride(periods, every, draws) == kept
    with pytest.raises(UsageError, match="thin it out with --every 300"):
        _stride(6e9, 299, False)


def test_bad_calls_end_in_one_sentence(vttig, scenario, monkeypatch):
    monkeypatch.chdir(scenario.parent)
    before = names(scenario.parent)
    for options, code, words in (
        ("", 2, "SCENARIO is missing; --print-defaults prints one"),
        ("none.toml", 3, "none.toml: no such file"),
        ("gears", 3, "gears: this folder holds neither run.toml"),
        ("S --print-defaults --json", 2, "no --json and no SCENARIO"),
        ("S --set reversal_deg=9", 2, "did you mean `motion.reversal_deg`?"),
        ("S --set motion.reversal_deg=20", 2, "--set motion.reversal_deg: 20 lies inside"),
        ("S --set motion.speed_rpm=6e4", 2, "with --set: motion.reversal_deg: 720 lies inside"),
        ("S --set seed=1.5", 2, "--set seed: expected a whole number"),
        ("S --set seed", 2, "'seed' is not of the form key=value"),
        ("S --set seed=", 2, "not of the form key=value"),
        ("S --set controller=\udced\udcff", 2, "the value of 'controller' is not UTF-8"),
        ("S --set controller=[none", 2, "the value of 'controller' is no TOML"),
        (f"S --set seed={'9' * 5000}", 2, "--set seed: expected a whole number"),
        ("S --set seed=1\x00other=2", 2, "the value of 'seed' is no TOML"),
        ("S --set controller={a=1", 2, "the value of 'controller' is no TOML"),
        ("S --set seed=1 --set seed=2", 2, "--set seed is given twice"),
        ("S --set pair=no.toml", 3, "pair: there is no file no.toml"),
        ("S --set motion.kind=recorded --set motion.file=no.csv", 3, "no.csv: no such file"),
        ("S --set motion.kind=recorded --set motion.file=gears", 3, "gears: this is a folder"),
        ("S --set motion.speed_rpm=1e-300", 2, "periods, but at most 1e+12 are simulated"),
        ("S --every 3", 2, "--every without --trace"),
        ("S --trace gears", 2, "gears: --trace is a folder"),
        ("S --trace trace.txt", 2, "choose a name that ends with .csv"),
        ("S --figure run.pdf", 2, "choose a name that ends with .png"),
        ("S --trace S/trace.csv", 3, "a file is in the way of this folder"),
    ):
        text = options.replace("S", "scenario.toml")
        ended, out, err = vttig("simulate", *(one.replace("\x00", "\n") for one in text.split()))
        assert ended == code and words in err and len(err.strip().splitlines()) == 1
        assert out == "" or json.loads(out)["exit"] == code
        assert names(scenario.parent) == before


def test_a_bad_scenario_is_named_with_its_key(refused, scenario, monkeypatch):
    folder = scenario.parent
    monkeypatch.chdir(folder)
    (folder / "drive.toml").write_text('[drive]\nratio = "1/2"\n')
    gears = (folder / "gears" / "pair.toml").read_text()
    (folder / "spur.toml").write_text(gears.replace("_deg = 3.0", "_deg = 0.0"))
    for old, new, words in (
        ("reversal_deg", "reversal_dg", "motion.reversal_dg: unknown key"),
        ("720.0", "nan", "motion.reversal_deg: expected a number"),
        ("720.0", "20", "motion.reversal_deg: 20 lies inside the ramps"),
        ("0.2\n", "0.2\n[sweep]\nseed = [1, 2]", "sweep: this file has many"),
        ("gears/pair", "drive", "pair: names a [drive] without gears"),
        ("gears/pair", "spur", "controller: the controller 'acceleration' shifts"),
    ):
        scenario.write_text(SCENARIO.replace(old, new))
        refused(3, f"scenario.toml: {words}", "simulate", "scenario.toml")
