"""Run folders from Python hold what the command line reads, and the other way round."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vttig_jax
from tests.base.files.disk_states import recorded
from tests.cli.drive import write_drive, write_pair
from vttig_jax.base.errors import InputError, LogError, UsageError
from vttig_jax.cli.main import main
from vttig_jax.identify.fit_settings import FitSettings
from vttig_jax.identify.identification import fit
from vttig_jax.logs.read import read_log
from vttig_jax.pair.gear_pair import GearPair, load_pair, pair_from_spec, spec_of
from vttig_jax.pair.pair_file import parse_pair_spec, spec_table
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.posterior.summary.bands import BandedMap
from vttig_jax.rig.paper import paper_pair
from vttig_jax.runs.run import Run, open_run

SETTINGS = FitSettings(delay=0.001, lines="report")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A fit of a log file of a drive, in Python."""
    folder = tmp_path_factory.mktemp("drive")
    pair = load_pair(write_pair(folder / "pair.toml"))
    log = read_log(write_drive(folder / "log.csv"), pair)
    return fit(log, pair, settings=SETTINGS, orders=HarmonicOrders(mesh_orders=0))


@pytest.fixture(scope="module")
def saved(made, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "run"
    made.save(folder)
    return folder


def same(folder: Path, other: Any) -> bool:
    """Whether the fit in a folder is another one."""
    return open_run(folder).fit.to_json() == json.loads(json.dumps(other.to_json()))


def test_a_fit_comes_back(made, saved, tmp_path, capsys):
    run = open_run(saved)
    assert same(saved, made) and run.fit.request == made.request
    assert run.pair.ratio == made.pair.ratio and run.pair.fit == made.request.orders
    assert list(run.logs.values()) == [made.sha256]
    assert (saved / "figures" / "te_fit.png").exists()
    np.testing.assert_array_equal(run.fit.covariance, made.covariance)
    text = str(Run(saved))
    assert "fit" in text and "lines = report" in text and "delay = 0.001" in text
    # The command line repeats it, and it is saved elsewhere.
    assert main(["fit", "--run", str(saved / "run.toml"), "--json"]) == 0
    repeated = json.loads(capsys.readouterr().out)
    assert repeated["parameters"] == json.loads(json.dumps(made.to_json()))["parameters"]
    run.fit.save(tmp_path / "copy", figures=False)
    for name in ("fit.json", "summary.npz"):
        assert (tmp_path / "copy" / name).read_bytes() == (saved / name).read_bytes()
    assert not (tmp_path / "copy/figures").exists()


def test_a_result_is_not_replaced_unasked(made, saved, tmp_path):
    before = (saved / "fit.json").read_bytes()
    with pytest.raises(UsageError, match="overwrite=True"):
        made.save(saved)
    assert (saved / "fit.json").read_bytes() == before
    made.save(saved, overwrite=True)
    bare = vttig_jax.read_fit(saved, made.pair)  # a fit without its options
    with pytest.raises(UsageError, match="open_run"):
        bare.save(tmp_path / "other")


def test_arrays_are_saved_and_not_repeated(tmp_path, capsys, quick_fit):
    quick_fit.save(tmp_path / "run", figures=False)
    run = open_run(tmp_path / "run")
    assert "arrays" in str(run)
    assert run.fit.value("driving_eccentricity_mm") == quick_fit.value("driving_eccentricity_mm")
    assert main(["fit", "--run", str(tmp_path / "run/run.toml")]) == 3
    assert "fitted from arrays" in capsys.readouterr().err


@pytest.mark.slow
def test_draws_are_saved_and_resumed(tmp_path, quick_fit):
    folder = tmp_path / "run"
    posterior = vttig_jax.sample(quick_fit, steps=40, seed=3)
    posterior.save(folder, figures=False)
    with pytest.raises(UsageError, match="exists"):
        posterior.save(folder, figures=False)
    run = open_run(folder)
    np.testing.assert_array_equal(run.posterior.chains.draws, posterior.chains.draws)
    # The file has one half of the matrices of a log; the halves differ in the last digit.
    np.testing.assert_allclose(run.posterior.draws, posterior.draws, rtol=1e-9, atol=1e-12)
    assert "draws" in str(run) and "draws" in run._repr_html_()
    assert isinstance(run.map, BandedMap)
    call = ["sample", "--out", str(folder), "--resume", "--steps", "80", "--no-figures"]
    assert main(call) == 5
    straight = vttig_jax.sample(quick_fit, steps=80, seed=3)
    resumed = open_run(folder).posterior.draws
    np.testing.assert_allclose(resumed, straight.draws, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_draws_that_were_continued_in_their_folder_are_reported_anew(tmp_path, quick_fit):
    folder = tmp_path / "run"
    place, report = folder / "posterior.h5", folder / "posterior.json"
    vttig_jax.sample(quick_fit, steps=40, seed=3).save(folder)
    assert json.loads(report.read_text())["diagnosis"]["steps"] == 40
    longer = vttig_jax.sample(quick_fit, steps=80, seed=3, checkpoint=place, resume=True)
    longer.save(folder, figures=False)
    record = json.loads(report.read_text())
    assert record["diagnosis"]["steps"] == 80
    assert record["parameters"] == json.loads(json.dumps(longer.to_json()))["parameters"]
    assert not (folder / "figures" / "corner.png").exists()  # that of the shorter chains
    assert (folder / "figures" / "te_fit.png").exists()
    np.testing.assert_array_equal(open_run(folder).posterior.chains.draws, longer.chains.draws)
    before = place.read_bytes()
    shorter, other = (vttig_jax.sample(quick_fit, steps=n, seed=s) for n, s in ((40, 3), (120, 4)))
    for refused in (longer, shorter, other):
        with pytest.raises(UsageError, match="exists"):
            refused.save(folder)
    assert place.read_bytes() == before


@pytest.mark.slow
def test_the_draws_of_another_fit_do_not_join(tmp_path, made, quick_fit, quick_rig):
    """Neither those of another log, nor those of other settings."""
    other = fit(quick_rig.log(0), quick_rig.pair, delay="off", lines="report")
    for name, kept, sampled in (("log", made, quick_fit), ("settings", quick_fit, other)):
        kept.save(tmp_path / name, figures=False)
        with pytest.raises(UsageError, match="another fit"):
            vttig_jax.sample(sampled, steps=40).save(tmp_path / name)
        assert not (tmp_path / name / "posterior.h5").exists()


def test_missing_and_damaged_parts_name_the_command_that_makes_them(tmp_path, saved):
    for words, read in (
        ("vttig fit LOG", lambda: open_run(tmp_path / "nothing")),
        ("neither", lambda: open_run(tmp_path)),
        ("vttig sample", lambda: open_run(saved).posterior),
        ("vttig sweep", lambda: open_run(saved).sweep),
    ):
        with pytest.raises(UsageError, match=words):
            read()
    (tmp_path / "sweep.parquet").write_bytes(b"no table")
    (tmp_path / "sweep.json").write_text("{}")
    with pytest.raises(InputError, match="damaged"):
        _ = open_run(tmp_path).sweep


@pytest.mark.parametrize("pair", [paper_pair(), load_pair(Path("fits/paper/pair.toml"))])
def test_a_gear_pair_comes_back_from_its_file(pair):
    again = pair_from_spec(parse_pair_spec(spec_table(spec_of(pair))))
    assert isinstance(again, GearPair)
    np.testing.assert_allclose(again.base_radii, pair.base_radii, rtol=1e-14)
    assert again.fit == pair.fit and again.driving.encoder == pair.driving.encoder


def test_a_log_is_found_after_a_change_of_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "below").mkdir()
    pair = load_pair(write_pair(tmp_path / "pair.toml"))
    write_drive(tmp_path / "log.csv")
    log = read_log("log.csv", pair)
    monkeypatch.chdir(tmp_path / "below")
    fit(log, pair).save("run", figures=False)
    assert main(["fit", "--run", "run", "--quiet"]) == 0


def test_a_log_counts_once_and_belongs_to_its_pair(quick_rig):
    log = quick_rig.log(0)
    with pytest.raises(UsageError, match="given twice"):
        fit([log, log], quick_rig.pair)
    drive = load_pair(Path("fits/worm_mount/pair.toml"))
    with pytest.raises(LogError, match="read with the ratio 9/16"):
        fit(log, drive)


def test_what_python_sees(quick_fit):
    """Scalars of numpy are numbers, and a figure is shown in windows and notebooks."""
    values: dict[str, Any] = {"delay": np.float64(0.003), "same_zero": np.True_}
    assert FitSettings(**values) == FitSettings(delay=0.003, same_zero=True)
    figure = quick_fit.plot()
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert figure.canvas.manager is None
    figure.show()
    assert figure.canvas.manager is not None
    assert quick_fit._repr_html_().startswith("<pre>")


@pytest.fixture(scope="module")
def other(tmp_path_factory) -> Path:
    """A fit of another log with other settings."""
    folder = tmp_path_factory.mktemp("other")
    pair = load_pair(write_pair(folder / "pair.toml"))
    log = read_log(write_drive(folder / "log.csv", seed=1), pair)
    fit(log, pair, settings=FitSettings(delay="off")).save(folder / "run", figures=False)
    return folder / "run"


@pytest.mark.parametrize("part", ["fit.json", "summary.npz", "run.toml"])
def test_files_of_different_runs_are_refused(saved, other, tmp_path, part, capsys):
    mixed = shutil.copytree(saved, tmp_path / "mixed")
    shutil.copy(other / part, mixed / part)
    with pytest.raises(InputError, match="belong to different runs"):
        _ = open_run(mixed).fit
    assert main(["export", str(mixed), "--out", str(tmp_path / "c.h")]) == 3
    assert "belong to different runs" in capsys.readouterr().err
    assert not (tmp_path / "c.h").exists()


def arrays_of(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / "summary.npz") as archive:
        return dict(archive)


def write_arrays(folder: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez(folder / "summary.npz", allow_pickle=False, **arrays)


def test_arrays_that_were_changed_are_refused(saved, tmp_path, capsys):
    folder, arrays = shutil.copytree(saved, tmp_path / "changed"), arrays_of(saved)
    write_arrays(folder, arrays)
    assert same(folder, open_run(saved).fit)
    for name in ("offset", "values", "compressed_windows"):
        for changed in (arrays[name][:0], arrays[name] * 1.0000001):
            write_arrays(folder, arrays | {name: changed})
            assert main(["map", str(folder)]) == 3
            assert "holds other arrays than the fit" in capsys.readouterr().err


def test_a_folder_of_an_older_version_is_refused(saved, tmp_path):
    """Its files carry no digest."""
    folder, arrays = shutil.copytree(saved, tmp_path / "old"), arrays_of(saved)
    for name in ("fit.json", "run.toml"):
        lines = (folder / name).read_text().splitlines(keepends=True)
        digests = ('"run":', '"arrays":', "run =")
        kept = [line for line in lines if not line.lstrip().startswith(digests)]
        (folder / name).write_text("".join(kept))
    with pytest.raises(InputError, match="belong to different runs"):
        _ = open_run(folder).fit
    del arrays["run"]
    write_arrays(folder, arrays)
    with pytest.raises(InputError, match="older version; make it again"):
        _ = open_run(folder).fit


def test_a_killed_overwrite_is_old_or_new_for_every_reader(saved, other, tmp_path):
    """Every state on the disk, as a kill would leave it, read as `export` reads it."""
    folder = shutil.copytree(other, tmp_path / "run")
    (folder / "map.csv").write_text("of the old fit")
    old, new = open_run(folder).fit, open_run(saved).fit
    with recorded(folder, tmp_path / "states") as states:
        new.save(folder, overwrite=True, figures=False)
    seen = []
    for state in states:
        run = open_run(state)
        is_new = run.fit.to_json() == new.to_json()
        expected = new if is_new else old
        assert run.fit.to_json() == expected.to_json()
        np.testing.assert_array_equal(run.fit.covariance, expected.covariance)
        assert run.record.options.settings.delay == (SETTINGS.delay if is_new else "off")
        assert (state / "map.csv").exists() != is_new
        assert not any(path.name.startswith(".new") for path in state.iterdir())
        seen.append(is_new)
    assert sorted(seen) == seen and {False, True} == set(seen)
