"""`--quantity error` of `map` and `export`, beside transmission errors that are known."""

import json
import shutil
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from tests.cli.commands import fit_into, table_of
from tests.cli.known_error import GAP_ARCSEC, TURNS, error_arcsec, fitted, worm_arcsec
from tests.schemas import load_schema
from vttig_jax import open_run
from vttig_jax.cli.main import main

ERROR = ("--quantity", "error")


def truth_deg(error, flank: str, driving_deg: np.ndarray) -> np.ndarray:
    """The true error less its mean, °."""
    values = error(flank, np.radians(driving_deg)) / 3600
    return values - values.mean()


@pytest.fixture
def mapped(found, tmp_path):
    """Function that writes `vttig map` of a run, and returns its object and its table."""

    def run(folder, *options):
        record = found("map", folder, *options, "--out", tmp_path / "te.csv", "--overwrite")
        return record, table_of(tmp_path / "te.csv")

    return run


def test_the_table_of_both_flanks_is_the_true_error(mapped, both, tmp_path):
    record, table = mapped(both, *ERROR)
    assert record == json.loads((tmp_path / "te.json").read_text())
    assert record["quantity"] == "error" and record["zero_mean_flanks"] == ["A"]
    assert table.dtype.names == ("driving_deg", "te_a_deg", "te_b_deg")
    assert len(table) == record["rows"] == 720
    for flank, other in ("AB", "BA"):
        error = table[f"te_{flank.lower()}_deg"]
        centred = error - error.mean()
        true, false = (truth_deg(error_arcsec, one, table["driving_deg"]) for one in (flank, other))
        # 400 samples of 1″ on each flank and ten coefficients: 0.2″ at most angles.
        np.testing.assert_allclose(centred, true, atol=0.6 / 3600)
        assert np.abs(centred - false).max() > 10 / 3600  # the check can fail
        size = record["transmission_error"][flank]
        assert size["significant"] and size["turns"] == 2
        assert_size(size, true)
    assert abs(table["te_a_deg"].mean()) < 1e-9
    assert table["te_b_deg"].mean() == pytest.approx(GAP_ARCSEC / 3600, abs=0.3 / 3600)


def assert_size(size: dict, true: np.ndarray) -> None:
    assert size["peak_to_peak_deg"] == pytest.approx(np.ptp(true), abs=1 / 3600)
    assert size["rms_deg"] == pytest.approx(true.std(), abs=0.2 / 3600)


def test_the_flanks_stand_apart_by_the_backlash_of_the_map(mapped, run_folder):
    (_, errors), (_, gaps) = mapped(run_folder, *ERROR), mapped(run_folder)
    distance = errors["te_b_deg"] - errors["te_a_deg"]
    np.testing.assert_allclose(distance, gaps["backlash_deg"], atol=1e-8)


def test_the_report_of_the_fit_has_the_size_of_the_covered_angles(both, worm):
    for run, error, flanks, turns in ((both, error_arcsec, "AB", 2), (worm, worm_arcsec, "A", 8)):
        fit = open_run(run).fit
        record = json.loads((run / "fit.json").read_text())["transmission_error"]
        assert "".join(record) == "".join(fit.flank_errors) == flanks
        for flank, size in fit.flank_errors.items():
            assert_size(record[flank], truth_deg(error, flank, np.arange(0, 720, 0.5)))
            assert record[flank]["turns"] == pytest.approx(turns, abs=1.0)
            assert size.to_json() == record[flank] and str(size) in str(fit)


def test_a_run_folder_of_an_older_version_opens(found, both, tmp_path):
    """Its fit.json does not have the sizes yet."""
    run = Path(shutil.copytree(both, tmp_path / "run"))
    record = json.loads((run / "fit.json").read_text())
    sizes = record.pop("transmission_error")
    (run / "fit.json").write_text(json.dumps(record))
    assert open_run(run).fit.to_json()["transmission_error"] == sizes
    assert found("map", run, *ERROR) == found("map", both, *ERROR)


def test_a_worm_of_one_direction_has_an_error_and_no_backlash(vttig, found, mapped, worm, tmp_path):
    assert vttig("map", worm)[0] == 4
    record, table = mapped(worm, *ERROR)
    assert list(record["transmission_error"]) == ["A"]
    assert table.dtype.names == ("driving_deg", "te_a_deg") and len(table) == 40 * 360
    covered = table[table["driving_deg"] < TURNS * 360]
    true = truth_deg(worm_arcsec, "A", covered["driving_deg"])
    error = covered["te_a_deg"] - covered["te_a_deg"].mean()
    np.testing.assert_allclose(error, true, atol=1.2 / 3600)  # orders of the wheel: a slow wave
    exported = found("export", worm, *ERROR, "--out", tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_bytes() == (tmp_path / "te.csv").read_bytes()
    assert not (tmp_path / "x.json").exists()
    assert exported["transmission_error"] == record["transmission_error"]


def test_one_flank_of_a_gear_pair(mapped, rig_folder, run_folder, tmp_path):
    log, pair = rig_folder / "log.csv", rig_folder / "pair.toml"
    run = fit_into(tmp_path / "run", log, pair, "--flank", "B")
    assert list(json.loads((run / "fit.json").read_text())["transmission_error"]) == ["B"]
    (_, alone), (_, whole) = mapped(run, *ERROR), mapped(run_folder, *ERROR)
    assert alone.dtype.names == ("driving_deg", "te_b_deg")
    one, two = alone["te_b_deg"], whole["te_b_deg"]
    np.testing.assert_allclose(one, two - two.mean(), atol=0.003)
    assert abs(one.mean()) < 1e-9 < 0.01 < two.mean()


@pytest.mark.parametrize("name", ["both", "worm", pytest.param("sampled", marks=pytest.mark.slow)])
def test_the_json_file_holds_the_table_and_where_it_comes_from(
    request, found, mapped, name, tmp_path
):
    run, path = request.getfixturevalue(name), tmp_path / "table.json"
    record = found("export", run, *ERROR, "--out", path, "--step-deg", 2)
    assert json.loads(path.read_text()) == record
    jsonschema.validate(record, load_schema("vttig.map/1"))
    _, table = mapped(run, *ERROR, "--step-deg", "2")
    assert tuple(record["table"]) == table.dtype.names
    for column, values in record["table"].items():
        np.testing.assert_allclose(values, table[column], rtol=1e-8, atol=1e-12)
    fit = json.loads((run / "fit.json").read_text())
    assert all(record[key] == fit[key] for key in ("sha256", "zero", "zero_readings", "source"))


def test_perfect_gears_have_a_table_that_is_not_above_its_noise(found, both, tmp_path):
    def no_error(flank: str, driving: np.ndarray) -> np.ndarray:
        return np.full(len(driving), GAP_ARCSEC if flank == "B" else 0.0)

    run = fitted(tmp_path / "perfect", no_error, "--delay", "off")
    for place, real in ((run, False), (both, True)):
        sizes = found("map", place, *ERROR)["transmission_error"].values()
        assert {size["significant"] for size in sizes} == {real}
        assert all((size["rms_deg"] > 1 / 3600) is real for size in sizes)
        fit = json.loads((place / "fit.json").read_text())["transmission_error"]
        assert {size["significant"] for size in fit.values()} == {real}


def test_a_slipping_drive_has_no_map_for_a_controller_but_an_error(vttig, found, tmp_path):
    run = fitted(tmp_path / "belt", error_arcsec, "--delay", "off", slip=1.001)
    assert vttig("export", run, "--out", tmp_path / "gap.csv")[0] == 4
    record = found("export", run, *ERROR, "--out", tmp_path / "te.csv")
    assert record["no_period"] is not None
    true = truth_deg(error_arcsec, "A", np.arange(0, 720, 0.5))
    size = record["transmission_error"]["A"]["peak_to_peak_deg"]
    assert size == pytest.approx(np.ptp(true), abs=2 / 3600)


@pytest.fixture(scope="module")
def sampled(both, tmp_path_factory) -> Path:
    """The run of both flanks with draws."""
    run = tmp_path_factory.mktemp("sampled") / "run"
    log, pair = (str(both.parent / name) for name in ("log.csv", "pair.toml"))
    sample = ["sample", log, "--pair", pair, "--delay", "off", "--out", str(run), "--no-figures"]
    assert main([*sample, "--steps", "300"]) in (0, 5)
    return run


@pytest.mark.slow
def test_bands_of_draws_hold_the_true_error(found, mapped, both, sampled, tmp_path, vttig):
    record, table = mapped(sampled, *ERROR)
    found("export", sampled, *ERROR, "--out", tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_bytes() == (tmp_path / "te.csv").read_bytes()
    driving_deg, driving = table["driving_deg"], np.radians(table["driving_deg"])
    gap_deg = np.mean(error_arcsec("B", driving) - error_arcsec("A", driving)) / 3600
    for flank, above in (("A", 0.0), ("B", gap_deg)):
        low, high, low_all, high_all = (
            table[f"te_{flank.lower()}_{end}_deg"]
            for end in ("low95", "high95", "low95_simultaneous", "high95_simultaneous")
        )
        true = truth_deg(error_arcsec, flank, driving_deg) + above
        assert ((low_all < true) & (true < high_all)).all()
        assert np.mean((low < true) & (true < high)) > 0.6
        assert (high_all - low_all).max() < 2 / 3600
        without_third = true - 6.0 / 3600 * np.sin(3 * driving + 2.0)
        assert not ((low_all < without_third) & (without_third < high_all)).all()
        draws = record["transmission_error"][flank]["peak_to_peak_draws_deg"]
        assert draws["low95"] < np.ptp(true) < draws["high95"]
    _, half = mapped(sampled, *ERROR, "--probability", "0.5")
    assert "te_a_low50_deg" in (half.dtype.names or ())
    assert vttig("map", both, *ERROR, "--probability", "0.5")[0] == 2


def test_the_shift_comes_first_where_there_is_one(
    refused, told, mapped, run_folder, both, tmp_path
):
    shift_first = ("--quantity", "shift")
    (_, gap), (_, shift) = mapped(run_folder), mapped(run_folder, *shift_first)
    assert shift.dtype.names is not None and shift.dtype.names[:2] == ("driving_deg", "axial_mm")
    assert set(shift.dtype.names) == set(gap.dtype.names or ())
    for name in shift.dtype.names:
        np.testing.assert_array_equal(shift[name], gap[name])
    refused(2, "no axial displacement", "map", both, *shift_first)
    for suffix in ("json", "csv"):
        out = tmp_path / f"x.{suffix}"
        refused(2, "no axial displacement", "export", both, *shift_first, "--out", out)
        told("export", run_folder, *shift_first, "--out", out)
    assert table_of(tmp_path / "x.csv").dtype.names == shift.dtype.names


def test_what_the_error_has_no_use_for_is_refused(refused, both, monkeypatch):
    monkeypatch.chdir(both.parent)
    for verb, options in (
        ("map", "--closing-mm 1"),
        ("map", "--constant-backlash-deg 0.1"),
        ("map", "--quantity errors"),
        ("export", "--out x.h"),
        ("export", "--out x.json --tolerance-arcsec 9"),
        ("export", "--out x.json --accuracy-arcsec 1"),
        ("export", "--out x.csv --constant-backlash-deg 1"),
        ("export", "--out x.csv --step-deg 0.001"),
    ):
        refused(2, "", verb, "run", *ERROR, *options.split())
        assert not list(both.parent.glob("x.*"))
