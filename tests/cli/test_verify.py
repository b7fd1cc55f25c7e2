"""`vttig verify`: an axis that stands where a known error puts it, with tables right and wrong."""

import numpy as np
import pytest

from tests.cli.known_error import error_arcsec, fitted

SPEED_DEG_S, RATE_HZ = 180.0, 50.0


@pytest.fixture
def exported(found, tmp_path):
    """Function that exports the table of an axis: positions, and corrections by direction, °."""

    def export(run, *options) -> np.ndarray:
        out = tmp_path / "axis.json"
        record = found("export", run, "--for", "json", "--out", out, "--overwrite", *options)
        return np.array([record["positions_deg"], *record["corrections_deg"].values()])

    return export


@pytest.fixture
def table(exported, both):
    return exported(both)


@pytest.fixture
def verified(found):
    """Function that returns what `vttig verify` says of one log."""

    def verify(run, log, *options) -> dict:
        (one,) = found("verify", run, log, *options)["logs"]
        return one

    return verify


def commanded(
    path, table, noise_arcsec=1.0, *, zero_deg=0.0, gain=0.5, name="command_deg", turn=0, size=1.0
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
    noise = noise_arcsec * rng.standard_normal(len(command))
    error = size * np.where(sign * gain > 0, *error) + noise
    rows = np.stack([moment, command, 0.5 * driving_deg + error / 3600 + 17.0], axis=1)
    np.savetxt(path, rows, "%.9f", ",", header=f"time_s,{name},driven_deg", comments="")
    return path


CHANGES = {
    "right": (1, 1, 1),
    "nothing_loaded": (1, 0, 0),
    "sign_reversed": (1, -1, -1),
    "directions_exchanged": None,
    "zero_shifted": (1, 1, 1),
}
"""Name of a fault → factors of positions and of both corrections."""


def changed(table: np.ndarray, name: str) -> np.ndarray:
    factors = CHANGES[name]
    return table[[0, 2, 1]] if factors is None else table * np.array(factors)[:, None]


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_wrong_has_its_name(told, verified, both, table, tmp_path, name):
    zero_deg = 25.0 if name == "zero_shifted" else 0.0
    log = commanded(tmp_path / "log.csv", changed(table, name), zero_deg=zero_deg)
    one = verified(both, log)
    assert one["likely"] == name and one["not_excluded"] == []
    forward = one["left_arcsec"]["forward"]
    assert forward["low95"] <= forward["rms"] <= forward["high95"]
    if name == "zero_shifted":
        assert one["value"] == pytest.approx(25.0, abs=0.5)
        assert f"--axis-zero-deg {one['value']:.4f}" in one["sentence"]
    if name == "sign_reversed":
        assert forward["rms"] > 1.5 * error_arcsec("A", np.linspace(0, 4 * np.pi, 1000)).std()
    if name == "right":
        assert forward["rms"] < 1.0 and forward["predicted95"][1] < 2.0
        out = told("verify", both, log)
        assert one["sentence"] in out and "predicted" in out


@pytest.mark.parametrize("name", list(CHANGES)[:4])
def test_an_error_that_is_larger_today_hides_no_fault(verified, both, table, tmp_path, name):
    """Another load adds a twentieth to the error: 60 times what the noise of the log is."""
    one = verified(both, commanded(tmp_path / "log.csv", changed(table, name), size=1.05))
    assert one["likely"] == ("changed" if name == "right" else name)
    assert name != "right" or one["left_arcsec"]["forward"]["rms"] < 3


def test_a_log_that_goes_beyond_the_table(told, found, exported, both, tmp_path):
    """The control holds the ends of the table, and verify predicts what is left there."""
    travel = ("--travel", "60", "300")
    log = commanded(tmp_path / "log.csv", exported(both, *travel))
    record = found("verify", both, log, *travel)
    assert record["table_deg"] == pytest.approx([60, 300], abs=1e-4)
    (one,) = record["logs"]
    assert one["likely"] == "right" and one["travel_deg"] == pytest.approx([5, 355], abs=15)
    assert one["left_arcsec"]["forward"]["low95"] > 3
    assert "beyond the table" in told("verify", both, log, *travel)


@pytest.mark.parametrize("places", [30, 85, 128])
def test_another_table_does_not_work_as_predicted(verified, both, table, tmp_path, places):
    """A table that was exported with another zero stands where the log has the right one."""
    other = np.vstack([table[:1], np.roll(table[1:, :-1], places, axis=1)[:, [*range(255), 0]]])
    one = verified(both, commanded(tmp_path / "log.csv", other))
    forward = one["left_arcsec"]["forward"]
    assert forward["low95"] > forward["predicted95"][1] and one["likely"] == "unexplained"


AXES = [
    (("--reversed", "--axis-zero-deg", "77.5"), {"gain": -0.5, "zero_deg": 77.5}),
    (("--axis", "driving", "--travel", "0", "360"), {"gain": 1.0}),
    (("--axis", "driving", "--place-unknown"), {"gain": 1.0, "turn": 1}),
]


@pytest.mark.parametrize(("options", "axis"), AXES)
def test_any_axis(verified, exported, both, tmp_path, options, axis):
    table, log = exported(both, *options), tmp_path / "log.csv"
    for name in ("right", "sign_reversed"):
        commanded(log, changed(table, name), **axis)
        assert verified(both, log, *options)["likely"] == name
    if "--travel" in options:
        commanded(log, table, turn=1, **axis)
        one = verified(both, log, *options)
        assert one["likely"] == "another_turn" and one["value"] == 1


def test_one_direction(verified, exported, tmp_path):
    """The run knows the way forward alone, and so does what it says of a log of both."""
    run = fitted(tmp_path / "drive", error_arcsec, "--delay", "off", "--flank", "A")
    log = commanded(tmp_path / "log.csv", exported(run)[[0, 1, 1]])
    one = verified(run, log)
    assert one["likely"] == "right" and list(one["left_arcsec"]) == ["forward"]


def test_before_and_after(found, both, table, tmp_path):
    bare = changed(table, "nothing_loaded")
    logs = [commanded(tmp_path / f"{k}.csv", one) for k, one in enumerate((bare, table))]
    for two, outcome in ((logs, "better"), (logs[::-1], "worse"), ([logs[1]] * 2, "open")):
        change = found("verify", both, *two)["change"]
        assert {one["outcome"] for one in change.values()} == {outcome}
    # A log with as much noise as error tells nothing, and says how much longer it has to be.
    loud = [commanded(tmp_path / f"loud{k}.csv", one, 600.0) for k, one in enumerate((bare, table))]
    record = found("verify", both, *loud)
    assert record["logs"][0]["not_excluded"]
    for one in record["change"].values():
        assert one["outcome"] == "open" and one["needed_s"] > record["logs"][1]["span_s"]


@pytest.mark.portable
def test_refusals(refused, vttig, verified, both, table, tmp_path):
    # Two encoders alone do not see a compensation.
    refused(4, "--column command=", "verify", both, both.parent / "log.csv")
    # Exported as it is and verified as reversed, or the other way round.
    log = commanded(tmp_path / "log.csv", table)
    said = refused(2, "command", "verify", both, log, "--reversed")
    assert "--reversed" in said and "--invert" not in said
    assert vttig("verify", both, log, log, log)[0] == 2
    # The column and the unit of the command are stated.
    log = commanded(tmp_path / "log.csv", table, name="joint.0.pos-cmd")
    assert vttig("verify", both, log)[0] == 4
    refused(3, "unit", "verify", both, log, "--column", "command=joint.0.pos-cmd")
    log = commanded(tmp_path / "log.csv", table, name="joint.0.pos-cmd [deg]")
    one = verified(both, log, "--column", "command=joint.0.pos-cmd [deg]")
    assert one["likely"] == "right"
