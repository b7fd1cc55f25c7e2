"""`vttig verify`: an axis that stands where a known error puts it, with tables right and wrong."""

import jsonschema
import numpy as np
import pytest

from tests.cli.test_error_quantity import error_arcsec, fitted
from tests.schemas import load_schema

SPEED_DEG_S, RATE_HZ = 180.0, 50.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Drive 1 : 2, whose axis repeats after one turn; both flanks."""
    return fitted(tmp_path_factory.mktemp("both") / "drive", error_arcsec, "--delay", "off")


@pytest.fixture
def table(vttig_json, run, tmp_path):
    """Positions and corrections forward and back, °."""
    _, record = vttig_json("export", run, "--for", "json", "--out", tmp_path / "axis.json")
    return np.array([record["positions_deg"], *record["corrections_deg"].values()])


def commanded(
    path,
    table,
    noise_arcsec=1.0,
    *,
    zero_deg=0.0,
    gain=0.5,
    name="command_deg",
    turn=0,
    size=1.0,
):
    """Write an axis that moves from 5° to 355° and back, as a control commands it with a table.

    Its position is `gain` times the driving angle, but for the zero; its error is `size` times that
    of the run.
    """
    ramp, pause, there = 0.5, 0.3, 350.0 / SPEED_DEG_S
    pieces, time = [], 0.0
    rng = np.random.default_rng(1)
    for sign in (1, -1, 1, -1, 1, -1):
        inside = np.arange(0, there + ramp + pause, 1 / RATE_HZ)
        gone = np.interp(inside, [0, ramp, there, there + ramp], [0, 45.0, 305.0, 350.0])
        start = 5.0 if sign > 0 else 355.0
        pieces.append((time + inside, start + sign * gone, np.full(len(inside), sign)))
        time += inside[-1] + 1 / RATE_HZ
    moment, command, sign = np.concatenate(pieces, axis=1)
    added = np.where(sign > 0, *(np.interp(command, table[0], one) for one in table[1:]))
    driving_deg = (command + added - zero_deg + 360 * turn) / gain
    error = [error_arcsec(flank, np.radians(driving_deg)) for flank in "AB"]
    error = size * np.where(sign * gain > 0, *error) + noise_arcsec * rng.standard_normal(
        len(command)
    )
    driven = 0.5 * driving_deg + error / 3600 + 17.0
    columns = {"time_s": moment, name: command, "driven_deg": driven}
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, "%.9f", ",", header=",".join(columns), comments="")
    return path


CHANGES = {
    "right": (lambda table: table, {}),
    "nothing_loaded": (lambda table: table * [[1], [0], [0]], {}),
    "sign_reversed": (lambda table: table * [[1], [-1], [-1]], {}),
    "directions_exchanged": (lambda table: table[[0, 2, 1]], {}),
    "zero_shifted": (lambda table: table, {"zero_deg": 25.0}),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_wrong_has_its_name(vttig, vttig_json, run, table, tmp_path, name):
    change, more = CHANGES[name]
    log = commanded(tmp_path / "log.csv", change(table), **more)
    code, record = vttig_json("verify", run, log)
    assert code == 0
    jsonschema.validate(record, load_schema("vttig.verify/1"))
    (found,) = record["logs"]
    assert found["likely"] == name and found["not_excluded"] == []
    if name == "zero_shifted":
        assert found["value"] == pytest.approx(25.0, abs=0.5)
        assert f"--axis-zero-deg {found['value']:.4f}" in found["sentence"]
    forward = found["left_arcsec"]["forward"]
    assert forward["low95"] <= forward["rms"] <= forward["high95"]
    whole = error_arcsec("A", np.linspace(0, 4 * np.pi, 1000)).std()
    if name == "right":
        assert forward["rms"] < 1.0 and forward["predicted95"][1] < 2.0
    if name == "sign_reversed":
        assert forward["rms"] > 1.5 * whole
    if name == "right":
        code, out, _ = vttig("verify", run, log)
        assert code == 0 and found["sentence"] in out and "predicted" in out


@pytest.mark.parametrize("name", ["nothing_loaded", "sign_reversed", "directions_exchanged"])
def test_an_error_that_is_larger_today_hides_no_fault(vttig_json, run, table, tmp_path, name):
    """Another load adds a twentieth to the error: 60 times what the noise of the log is."""
    log = commanded(tmp_path / "log.csv", CHANGES[name][0](table), size=1.05)
    _, record = vttig_json("verify", run, log)
    assert record["logs"][0]["likely"] == name


def test_an_axis_that_has_changed_since_its_log(vttig_json, run, table, tmp_path):
    log = commanded(tmp_path / "log.csv", table, size=1.05)
    _, record = vttig_json("verify", run, log)
    jsonschema.validate(record, load_schema("vttig.verify/1"))
    (found,) = record["logs"]
    assert found["likely"] == "changed" and found["left_arcsec"]["forward"]["rms"] < 3


def test_a_log_that_goes_beyond_the_table(vttig, vttig_json, run, tmp_path):
    """The control holds the ends of the table, and verify predicts what is left there."""
    travel = ("--travel", "60", "300")
    _, record = vttig_json("export", run, "--for", "json", "--out", tmp_path / "a.json", *travel)
    table = np.array([record["positions_deg"], *record["corrections_deg"].values()])
    log = commanded(tmp_path / "log.csv", table)
    _, record = vttig_json("verify", run, log, *travel)
    assert record["table_deg"] == pytest.approx([60, 300], abs=1e-4)
    (found,) = record["logs"]
    assert found["likely"] == "right" and found["travel_deg"] == pytest.approx([5, 355], abs=15)
    assert found["left_arcsec"]["forward"]["low95"] > 3
    _, out, _ = vttig("verify", run, log, *travel)
    assert "beyond the table" in out


@pytest.mark.parametrize("places", [30, 85, 128])
def test_another_table_does_not_work_as_predicted(vttig_json, run, table, tmp_path, places):
    """A table that was exported with another zero stands where the log has the right one."""
    other = np.vstack([table[:1], np.roll(table[1:, :-1], places, axis=1)[:, [*range(255), 0]]])
    log = commanded(tmp_path / "log.csv", other)
    _, record = vttig_json("verify", run, log)
    jsonschema.validate(record, load_schema("vttig.verify/1"))
    (found,) = record["logs"]
    forward = found["left_arcsec"]["forward"]
    assert forward["low95"] > forward["predicted95"][1] and found["likely"] == "unexplained"


AXES = [
    (("--reversed", "--axis-zero-deg", "77.5"), {"gain": -0.5, "zero_deg": 77.5}),
    (("--axis", "driving", "--travel", "0", "360"), {"gain": 1.0}),
    (("--axis", "driving", "--place-unknown"), {"gain": 1.0, "turn": 1}),
]


@pytest.mark.parametrize(("options", "axis"), AXES)
def test_any_axis(vttig_json, run, tmp_path, options, axis):
    out, log = tmp_path / "axis.json", tmp_path / "log.csv"
    _, record = vttig_json("export", run, "--for", "json", "--out", out, *options)
    table = np.array([record["positions_deg"], *record["corrections_deg"].values()])
    _, record = vttig_json("verify", run, commanded(log, table, **axis), *options)
    assert record["logs"][0]["likely"] == "right"
    commanded(log, table * [[1], [-1], [-1]], **axis)
    _, record = vttig_json("verify", run, log, *options)
    assert record["logs"][0]["likely"] == "sign_reversed"
    if "--travel" in options:
        commanded(log, table, turn=1, **axis)
        _, record = vttig_json("verify", run, log, *options)
        assert record["logs"][0]["likely"] == "another_turn" and record["logs"][0]["value"] == 1


def test_an_axis_that_counts_against_its_command(vttig, run, table, tmp_path):
    """Exported as it is and verified as reversed, or the other way round."""
    log = commanded(tmp_path / "log.csv", table)
    code, out, err = vttig("verify", run, log, "--reversed")
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert "command" in err and "--reversed" in err and "--invert" not in err


def test_one_direction(vttig_json, tmp_path):
    """The run knows the way forward alone, and so does what it says of a log of both."""
    run = fitted(tmp_path / "drive", error_arcsec, "--delay", "off", "--flank", "A")
    _, record = vttig_json("export", run, "--for", "json", "--out", tmp_path / "axis.json")
    added = record["corrections_deg"]["forward"]
    log = commanded(tmp_path / "log.csv", np.array([record["positions_deg"], added, added]))
    _, record = vttig_json("verify", run, log)
    (found,) = record["logs"]
    assert found["likely"] == "right" and list(found["left_arcsec"]) == ["forward"]


def test_before_and_after(vttig_json, run, table, tmp_path):
    bare = table * [[1], [0], [0]]
    logs = [commanded(tmp_path / f"{k}.csv", one) for k, one in enumerate((bare, table))]
    _, record = vttig_json("verify", run, *logs)
    assert {one["outcome"] for one in record["change"].values()} == {"better"}
    _, record = vttig_json("verify", run, *logs[::-1])
    assert {one["outcome"] for one in record["change"].values()} == {"worse"}
    _, same = vttig_json("verify", run, logs[1], logs[1])
    assert {one["outcome"] for one in same["change"].values()} == {"open"}
    # A log with as much noise as error tells nothing, and says how much longer it has to be.
    loud = [commanded(tmp_path / f"loud{k}.csv", one, 600.0) for k, one in enumerate((bare, table))]
    _, record = vttig_json("verify", run, *loud)
    assert record["logs"][0]["not_excluded"]
    for one in record["change"].values():
        assert one["outcome"] == "open" and one["needed_s"] > record["logs"][1]["span_s"]


@pytest.mark.portable
def test_two_encoders_alone_do_not_see_a_compensation(vttig, run):
    code, out, err = vttig("verify", run, run.parent / "log.csv")
    assert (code, out) == (4, "") and err.count("\n") == 1 and "--column command=" in err


def test_the_column_and_the_unit_of_the_command_are_stated(vttig, vttig_json, run, table, tmp_path):
    log = commanded(tmp_path / "log.csv", table, name="joint.0.pos-cmd")
    assert vttig("verify", run, log)[0] == 4
    code, _, err = vttig("verify", run, log, "--column", "command=joint.0.pos-cmd")
    assert code == 3 and "unit" in err
    log = commanded(tmp_path / "other.csv", table, name="joint.0.pos-cmd [deg]")
    code, record = vttig_json("verify", run, log, "--column", "command=joint.0.pos-cmd [deg]")
    assert code == 0 and record["logs"][0]["likely"] == "right"
    assert vttig("verify", run, log, log, log)[0] == 2
