"""`--quantity error` of `map` and `export`, beside transmission errors that are written down here.

The logs are made by plain trigonometry from a known transmission error of each flank.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from tests.schemas import load_schema
from vttig_jax import open_run
from vttig_jax.cli.main import main

GAP_ARCSEC = 90.0
TURNS = 8
"""Driving turns of a log in each direction: four hunting periods of the drive 1 : 2."""


def error_arcsec(flank: str, driving: np.ndarray, ratio: float = 0.5) -> np.ndarray:
    """True transmission error; flank B has another phase, and stands above flank A by the gap."""
    on_b = flank == "B"
    return (
        30.0 * np.sin(driving + (0.9 if on_b else 0.3))
        + 6.0 * np.sin(3 * driving + 2.0)
        + 50.0 * np.sin(ratio * driving + 1.1)
        + (GAP_ARCSEC if on_b else 0.0)
    )


def worm_arcsec(flank: str, driving: np.ndarray) -> np.ndarray:
    """True transmission error of a worm, whose wheel has none."""
    return error_arcsec(flank, driving, 0.0)


def no_error(flank: str, driving: np.ndarray) -> np.ndarray:
    """Perfect gears with a gap."""
    return np.full(len(driving), GAP_ARCSEC if flank == "B" else 0.0)


def fitted(
    folder: Path,
    error: Callable[[str, np.ndarray], np.ndarray],
    *options: str,
    ratio: float = 0.5,
    slip: float = 1.0,
    back: bool = True,
) -> Path:
    """Run folder with the fit of a log of `error` with noise of 1″, at 60 rpm, 50 Hz.

    The driven shaft turns `slip` times as fast as the ratio of the pair file says.
    """
    folder.mkdir()
    there = [0, 60, 60, 0], [0, 0.5, 0.5 + TURNS, 1 + TURNS]
    speeds, times = np.array(there[0] + [0, -60, -60, 0]), np.array(there[1] + [2, 2.5, 10.5, 11])
    times[4:] += times[3] - 1.0
    if not back:
        speeds, times = speeds[:4], times[:4]
    time = np.arange(0, times[-1], 0.02)
    fine = np.linspace(0, times[-1], 200_001)
    speed = np.interp(fine, times, speeds) * 2 * np.pi / 60
    turned = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2) * fine[1]])
    driving = np.interp(time, fine, turned)
    forward = np.interp(time, times, speeds) >= 0
    te = np.where(forward, error("A", driving), error("B", driving))
    te += np.random.default_rng(0).standard_normal(len(time))
    columns = {
        "time_s": time,
        "driving_deg": np.degrees(driving),
        "driven_deg": np.degrees(slip * ratio * driving) + (te - te[0]) / 3600,
    }
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(folder / "log.csv", table, "%.9f", ",", header=",".join(columns), comments="")
    (folder / "pair.toml").write_text(
        f'name = "drive"\n[drive]\nratio = "1/{1 / ratio:.0f}"\n'
        "[fit]\ndriving_orders = [1, 2, 3]\ndriven_orders = [1, 2]\n"
    )
    log, pair, out = (str(folder / name) for name in ("log.csv", "pair.toml", "run"))
    assert main(["fit", log, "--pair", pair, "--out", out, "--no-figures", *options]) == 0
    return folder / "run"


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Path:
    return fitted(tmp_path_factory.mktemp("both") / "drive", error_arcsec, "--delay", "off")


@pytest.fixture(scope="module")
def worm(tmp_path_factory) -> Path:
    """One direction, at one speed."""
    folder = tmp_path_factory.mktemp("worm") / "drive"
    return fitted(folder, worm_arcsec, "--ratio-within", "0", ratio=1 / 40, back=False)


def table_of(path: Path) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", names=True)


def truth_deg(error: Callable[..., np.ndarray], flank: str, driving_deg: np.ndarray) -> np.ndarray:
    """The true error less its mean, °."""
    values = error(flank, np.radians(driving_deg)) / 3600
    return values - values.mean()


def test_the_table_of_both_flanks_is_the_true_error(vttig_json, both, tmp_path):
    code, record = vttig_json("map", both, "--quantity", "error", "--out", tmp_path / "te.csv")
    assert code == 0 and record["quantity"] == "error"
    assert record == json.loads((tmp_path / "te.json").read_text())
    table = table_of(tmp_path / "te.csv")
    assert table.dtype.names == ("driving_deg", "te_a_deg", "te_b_deg")
    assert len(table) == record["rows"] == 720 and record["zero_mean_flanks"] == ["A"]
    for flank in ("A", "B"):
        found = table[f"te_{flank.lower()}_deg"]
        true = truth_deg(error_arcsec, flank, table["driving_deg"])
        # 400 samples of 1″ on each flank and ten coefficients: 0.2″ at most angles.
        np.testing.assert_allclose(found - found.mean(), true, atol=0.6 / 3600)
        other = truth_deg(error_arcsec, "AB".replace(flank, ""), table["driving_deg"])
        assert np.abs(found - found.mean() - other).max() > 10 / 3600  # the check can fail
        size = record["transmission_error"][flank]
        assert size["peak_to_peak_deg"] == pytest.approx(np.ptp(true), abs=1 / 3600)
        assert size["rms_deg"] == pytest.approx(true.std(), abs=0.2 / 3600)
        assert size["significant"] and size["turns"] == 2
    assert abs(table["te_a_deg"].mean()) < 1e-9
    assert table["te_b_deg"].mean() == pytest.approx(GAP_ARCSEC / 3600, abs=0.3 / 3600)


def test_the_flanks_stand_apart_by_the_backlash_of_the_map(vttig, run_folder, tmp_path):
    for name, options in (("te", ("--quantity", "error")), ("gap", ())):
        code, _, _ = vttig("map", run_folder, *options, "--out", tmp_path / f"{name}.csv")
        assert code == 0
    errors, gaps = (table_of(tmp_path / f"{name}.csv") for name in ("te", "gap"))
    distance = errors["te_b_deg"] - errors["te_a_deg"]
    np.testing.assert_allclose(distance, gaps["backlash_deg"], atol=1e-8)


def test_the_report_of_the_fit_has_the_size_of_the_covered_angles(both, worm, tmp_path):
    for run, error, flanks, turns in (
        (both, error_arcsec, ("A", "B"), 2.0),
        (worm, worm_arcsec, ("A",), TURNS),
    ):
        fit = open_run(run).fit
        record = json.loads((run / "fit.json").read_text())["transmission_error"]
        assert tuple(record) == tuple(fit.flank_errors) == flanks
        for flank, size in fit.flank_errors.items():
            true = truth_deg(error, flank, np.arange(0, 720, 0.5))
            assert record[flank]["peak_to_peak_deg"] == pytest.approx(np.ptp(true), abs=1 / 3600)
            assert record[flank]["rms_deg"] == pytest.approx(true.std(), abs=0.2 / 3600)
            assert record[flank]["turns"] == pytest.approx(turns, abs=1.0)
            assert size.to_json() == record[flank] and str(size) in str(fit)


def test_a_run_folder_of_an_older_version_opens(vttig_json, both, tmp_path):
    """Its fit.json does not have the sizes yet."""
    run = Path(shutil.copytree(both, tmp_path / "run"))
    record = json.loads((run / "fit.json").read_text())
    sizes = record.pop("transmission_error")
    (run / "fit.json").write_text(json.dumps(record))
    assert open_run(run).fit.to_json()["transmission_error"] == sizes
    old, new = (vttig_json("map", one, "--quantity", "error")[1] for one in (run, both))
    assert old == new


def test_a_worm_of_one_direction_has_an_error_and_no_backlash(vttig, vttig_json, worm, tmp_path):
    assert vttig("map", worm)[0] == 4
    code, record = vttig_json("map", worm, "--quantity", "error", "--out", tmp_path / "te.csv")
    assert code == 0 and list(record["transmission_error"]) == ["A"]
    table = table_of(tmp_path / "te.csv")
    assert table.dtype.names == ("driving_deg", "te_a_deg") and len(table) == 40 * 360
    covered = table["driving_deg"] < TURNS * 360
    true = truth_deg(worm_arcsec, "A", table["driving_deg"][covered])
    found = table["te_a_deg"][covered] - table["te_a_deg"][covered].mean()
    np.testing.assert_allclose(found, true, atol=1.2 / 3600)  # orders of the wheel are a slow wave
    code, exported = vttig_json("export", worm, "--quantity", "error", "--out", tmp_path / "x.csv")
    assert code == 0 and (tmp_path / "x.csv").read_bytes() == (tmp_path / "te.csv").read_bytes()
    assert not (tmp_path / "x.json").exists()
    assert exported["transmission_error"] == record["transmission_error"]


def test_one_flank_of_a_gear_pair(vttig, vttig_json, rig_folder, run_folder, tmp_path):
    log, pair = rig_folder / "log.csv", rig_folder / "pair.toml"
    out = tmp_path / "run"
    assert vttig("fit", log, "--pair", pair, "--flank", "B", "--out", out, "--no-figures")[0] == 0
    assert list(json.loads((out / "fit.json").read_text())["transmission_error"]) == ["B"]
    tables = {}
    for name, run in (("one", out), ("both", run_folder)):
        path = tmp_path / f"{name}.csv"
        assert vttig_json("map", run, "--quantity", "error", "--out", path)[0] == 0
        tables[name] = table_of(path)
    assert tables["one"].dtype.names == ("driving_deg", "te_b_deg")
    one, both = (tables[name]["te_b_deg"] for name in ("one", "both"))
    np.testing.assert_allclose(one, both - both.mean(), atol=0.003)
    assert abs(one.mean()) < 1e-9 < 0.01 < both.mean()


@pytest.mark.parametrize("name", ["both", "worm", pytest.param("sampled", marks=pytest.mark.slow)])
def test_the_json_file_holds_the_table_and_where_it_comes_from(request, vttig_json, name, tmp_path):
    run, path = request.getfixturevalue(name), tmp_path / "table.json"
    code, record = vttig_json("export", run, "--quantity", "error", "--out", path, "--step-deg", 2)
    assert code == 0 and json.loads(path.read_text()) == record
    jsonschema.validate(record, load_schema("vttig.map/1"))
    options = ("--quantity", "error", "--step-deg", "2", "--out", tmp_path / "te.csv")
    assert vttig_json("map", run, *options)[0] == 0
    table = table_of(tmp_path / "te.csv")
    assert tuple(record["table"]) == table.dtype.names
    for column, values in record["table"].items():
        np.testing.assert_allclose(values, table[column], rtol=1e-8, atol=1e-12)
    fit = json.loads((run / "fit.json").read_text())
    assert all(record[key] == fit[key] for key in ("sha256", "zero", "zero_readings", "source"))


def test_perfect_gears_have_a_table_that_is_not_above_its_noise(vttig_json, both, tmp_path):
    run = fitted(tmp_path / "perfect", no_error, "--delay", "off")
    for place, real in ((run, False), (both, True)):
        _, record = vttig_json("map", place, "--quantity", "error")
        sizes = record["transmission_error"].values()
        assert {size["significant"] for size in sizes} == {real}
        assert all((size["rms_deg"] > 1 / 3600) is real for size in sizes)
        fit = json.loads((place / "fit.json").read_text())["transmission_error"]
        assert {size["significant"] for size in fit.values()} == {real}


def test_a_slipping_drive_has_no_map_for_a_controller_but_an_error(vttig, vttig_json, tmp_path):
    run = fitted(tmp_path / "belt", error_arcsec, "--delay", "off", slip=1.001)
    assert vttig("export", run, "--out", tmp_path / "gap.csv")[0] == 4
    _, record = vttig_json("export", run, "--quantity", "error", "--out", tmp_path / "te.csv")
    assert record["no_period"] is not None
    true = truth_deg(error_arcsec, "A", np.arange(0, 720, 0.5))
    found = record["transmission_error"]["A"]["peak_to_peak_deg"]
    assert found == pytest.approx(np.ptp(true), abs=2 / 3600)


@pytest.fixture(scope="module")
def sampled(both, tmp_path_factory) -> Path:
    """The run of both flanks with draws."""
    run = tmp_path_factory.mktemp("sampled") / "run"
    log, pair = (str(both.parent / name) for name in ("log.csv", "pair.toml"))
    sample = ["sample", log, "--pair", pair, "--delay", "off", "--out", str(run), "--no-figures"]
    assert main([*sample, "--steps", "300"]) in (0, 5)
    return run


@pytest.mark.slow
def test_bands_of_draws_hold_the_true_error(vttig_json, sampled, tmp_path):
    code, record = vttig_json("map", sampled, "--quantity", "error", "--out", tmp_path / "te.csv")
    assert code == 0
    table = table_of(tmp_path / "te.csv")
    assert vttig_json("export", sampled, "--quantity", "error", "--out", tmp_path / "x.csv")[0] == 0
    assert (tmp_path / "x.csv").read_bytes() == (tmp_path / "te.csv").read_bytes()
    gap_deg = np.mean(
        error_arcsec("B", np.radians(table["driving_deg"])) / 3600
        - error_arcsec("A", np.radians(table["driving_deg"])) / 3600
    )
    for flank, above in (("A", 0.0), ("B", gap_deg)):
        edges = {
            end: table[f"te_{flank.lower()}_{end}_deg"]
            for end in ("low95", "high95", "low95_simultaneous", "high95_simultaneous")
        }
        true = truth_deg(error_arcsec, flank, table["driving_deg"]) + above
        low, high = edges["low95_simultaneous"], edges["high95_simultaneous"]
        assert ((low < true) & (true < high)).all()
        assert np.mean((edges["low95"] < true) & (true < edges["high95"])) > 0.6
        assert (high - low).max() < 2 / 3600
        without_third = true - 6.0 / 3600 * np.sin(3 * np.radians(table["driving_deg"]) + 2.0)
        assert not ((low < without_third) & (without_third < high)).all()
        draws = record["transmission_error"][flank]["peak_to_peak_draws_deg"]
        assert draws["low95"] < np.ptp(true) < draws["high95"]


@pytest.mark.slow
def test_the_probability_of_the_bands_is_asked_for_and_needs_draws(vttig, both, sampled, tmp_path):
    wanted = ("--quantity", "error", "--probability", "0.5")
    assert vttig("map", sampled, *wanted, "--out", tmp_path / "te.csv")[0] == 0
    names = table_of(tmp_path / "te.csv").dtype.names
    assert names is not None and "te_a_low50_deg" in names
    assert vttig("map", both, *wanted)[0] == 2


def test_the_shift_comes_first_where_there_is_one(vttig, vttig_json, run_folder, both, tmp_path):
    for name, options in (("gap", ()), ("shift", ("--quantity", "shift"))):
        vttig_json("map", run_folder, *options, "--out", tmp_path / f"{name}.csv")
    gap, shift = (table_of(tmp_path / f"{name}.csv") for name in ("gap", "shift"))
    first, *_ = (name for name in shift.dtype.names or () if name != "driving_deg")
    assert first == "axial_mm" and set(shift.dtype.names or ()) == set(gap.dtype.names or ())
    for name in gap.dtype.names or ():
        np.testing.assert_array_equal(shift[name], gap[name])
    code, _, err = vttig("map", both, "--quantity", "shift")
    assert code == 2 and "no axial displacement" in err
    for suffix in ("csv", "json"):
        out = tmp_path / f"x.{suffix}"
        assert vttig("export", both, "--quantity", "shift", "--out", out)[0] == 2
        assert vttig("export", run_folder, "--quantity", "shift", "--out", out)[0] == 0
    exported = np.genfromtxt(tmp_path / "x.csv", delimiter=",", names=True)
    assert exported.dtype.names == shift.dtype.names


def test_what_the_error_has_no_use_for_is_refused(vttig, both, monkeypatch):
    for arguments in (
        ("map", "run", "--quantity", "error", "--closing-mm", "1"),
        ("map", "run", "--quantity", "error", "--constant-backlash-deg", "0.1"),
        ("map", "run", "--quantity", "errors"),
        ("export", "run", "--quantity", "error", "--out", "x.h"),
        ("export", "run", "--quantity", "error", "--out", "x.json", "--tolerance-arcsec", "9"),
        ("export", "run", "--quantity", "error", "--out", "x.json", "--accuracy-arcsec", "1"),
        ("export", "run", "--quantity", "error", "--out", "x.csv", "--constant-backlash-deg", "1"),
        ("export", "run", "--quantity", "error", "--out", "x.csv", "--step-deg", "0.001"),
    ):
        monkeypatch.chdir(both.parent)
        code, out, err = vttig(*arguments)
        assert (code, out) == (2, "") and err.count("\n") == 1
        assert not list(both.parent.glob("x.*"))
