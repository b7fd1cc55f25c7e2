"""`vttig sample` on a cheap drive: what it prints, keeps, refuses and goes on with."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filelock import FileLock

from tests.cli.commands import table_of
from tests.cli.drive import write_drive, write_pair
from vttig_jax.cli.main import main
from vttig_jax.posterior.chains import read_chains
from vttig_jax.posterior.target import FitTarget

STEPS = 50


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A log and a pair file of a drive."""
    folder = tmp_path_factory.mktemp("drive")
    write_drive(folder / "log.csv", delay_s=0.0)
    write_drive(folder / "other.csv", seed=1, delay_s=0.0)
    write_pair(folder / "pair.toml")
    return folder


@pytest.fixture(scope="module")
def drive(folder) -> tuple:
    """Arguments for the log of the drive."""
    return (folder / "log.csv", "--pair", folder / "pair.toml")


@pytest.fixture(scope="module")
def other(folder) -> tuple:
    """Arguments for another log of the drive."""
    return (folder / "other.csv", "--pair", folder / "pair.toml")


@pytest.fixture(scope="module")
def sampled(folder, drive) -> Path:
    """A run folder with too few steps to converge."""
    steps = ("--steps", STEPS, "--no-figures", "--out", folder / "run")
    assert main([str(a) for a in ("sample", *drive, *steps)]) == 5
    return folder / "run"


@pytest.fixture
def run(sampled, tmp_path) -> Path:
    """A copy of that run folder to play with."""
    return Path(shutil.copytree(sampled, tmp_path / "run"))


@pytest.fixture
def sample(vttig):
    """Function that samples without pictures."""
    return lambda *arguments: vttig("sample", *arguments, "--no-figures")


def _draws(out: Path) -> np.ndarray:
    return read_chains(out / "posterior.h5").record.draws


def _kept(run: Path) -> bytes:
    return (run / "posterior.h5").read_bytes()


def test_too_few_steps_are_said_and_kept(sample, vttig_json, run):
    again = ("--resume", "--steps", STEPS)
    code, out, err = sample("--out", run, *again)
    assert code == 5
    assert out.startswith("not converged: ") and "converged: no; " in out
    assert "the sampler has not converged" in err and f"`vttig sample {run} --resume`" in err
    assert {"posterior.h5", "posterior.json", "fit.json", "summary.npz", "run.toml"} <= {
        path.name for path in run.iterdir()
    }
    assert sample(run, *again)[:2] == (code, out)  # the run folder is the argument
    code, record = vttig_json("sample", "--out", run, *again, "--no-figures")
    assert code == record["exit"] == 5 and record["schema"] == "vttig.error/1"
    kept = json.loads((run / "posterior.json").read_text())
    assert kept["schema"] == "vttig.posterior/1" and not kept["converged"]
    assert kept["parameters"]["driving_amplitude_arcsec"]["median"] == pytest.approx(30, abs=1)
    assert {"prior", "diagnosis"} <= set(kept)


class Interrupted:
    """A density that is interrupted, as by Ctrl-C, at its n-th call."""

    def __init__(self, after: int):
        self.after, self.whole = after, FitTarget.log_density

    def __get__(self, target: FitTarget, _: type) -> Any:
        def density(points: np.ndarray) -> np.ndarray:
            self.after -= 1
            if self.after == 0:
                raise KeyboardInterrupt
            return self.whole(target, points)

        return density


def test_an_interrupt_says_what_is_kept(refused, run, monkeypatch):
    monkeypatch.setattr(FitTarget, "log_density", Interrupted(500))
    again = ("sample", run, "--resume", "--steps", "100000")
    assert "--resume" in refused(130, str(run / "posterior.h5"), *again)
    monkeypatch.undo()
    assert _draws(run).shape[1] >= 8


@pytest.mark.portable
def test_going_on_ends_as_if_never_stopped(sample, drive, run, tmp_path):
    whole, another = tmp_path / "whole", tmp_path / "another"
    sample("--out", run, "--resume", "--steps", 2 * STEPS)
    sample(*drive, "--out", whole, "--steps", 2 * STEPS)
    np.testing.assert_array_equal(_draws(run), _draws(whole))
    sample(*drive, "--out", another, "--seed", 1, "--steps", STEPS)
    assert not np.array_equal(_draws(another), _draws(run)[:, : _draws(another).shape[1]])
    # Seed and walkers are those of the draws unless given.
    chosen = ("--seed", 7, "--walkers", 34, "--steps", 40)
    sample("--out", another, "--overwrite", *chosen)
    assert sample("--out", another, "--resume", "--steps", 60)[0] == 5
    chains = read_chains(another / "posterior.h5")
    assert (chains.header.seed, chains.header.walkers, chains.diagnosis.steps) == (7, 34, 60)


@pytest.mark.slow
def test_the_stop_rule_ends_it_and_pictures_are_drawn(found, run):
    record = found("sample", "--out", run, "--resume", "--until", "600")
    assert record["converged"]
    assert min(record["diagnosis"]["effective_draws"].values()) >= 600
    names = {path.name for path in (run / "figures").iterdir()}
    assert names == {"corner.png", "trace.png", "band.png"}
    fit = json.loads((run / "fit.json").read_text())["parameters"]
    for name, parameter in record["parameters"].items():
        if fit[name]["determined"] and fit[name]["std"]:
            assert parameter["std"] == pytest.approx(fit[name]["std"], rel=0.3)


def test_the_map_has_bands_after_it(vttig, found, refused, run, tmp_path):
    code, out, err = vttig("map", run, "--out", tmp_path / "map.csv")
    assert code == 0 and "95 % of the whole map" in out and "have not converged" in err
    table = table_of(tmp_path / "map.csv")
    assert np.all(table["low95_simultaneous_deg"] < table["low95_deg"])
    assert np.all(table["low95_deg"] < table["backlash_deg"])
    assert np.all(table["high95_deg"] < table["high95_simultaneous_deg"])
    half, most = found("map", run, "--probability", "0.5"), found("map", run)
    assert half["probability"] == 0.5 and half["critical"] < most["critical"]
    assert vttig("map", run, "--closing-mm", "0.1")[0] == 4  # a drive has no taper
    both = ("--closing-mm", 0.1, "--constant-backlash-deg", 0.1)
    refused(2, "leave out --constant-backlash-deg", "map", run, *both)


def test_a_new_fit_takes_old_draws_away_unless_a_sampler_writes(vttig, refused, other, run):
    before = (run / "fit.json").read_bytes()
    again = ("fit", *other, "--out", run, "--overwrite", "--no-figures")
    with FileLock(run / ".posterior.h5.lock"):
        refused(2, "a sampler is writing", *again)
    assert (run / "fit.json").read_bytes() == before and (run / "posterior.h5").exists()
    assert "draws" in vttig(*again)[2]
    assert not (run / "posterior.h5").exists() and not (run / "posterior.json").exists()


def test_what_is_there_is_not_replaced_unasked(sample, refused, drive, other, run):
    before = _kept(run)
    assert "--overwrite" in refused(2, "--resume", "sample", "--out", run)
    refused(2, "already exists", "sample", *drive, "--out", run)
    said = refused(3, "data", "sample", *other, "--out", run, "--resume", "--steps", 800)
    assert "data_sha256" in said.replace(" ", "_")
    refused(3, "options", "sample", *drive, "--out", run, "--resume", "--delay", "off")
    refused(3, "seed", "sample", "--out", run, "--resume", "--seed", 5)
    assert _kept(run) == before
    assert sample("--out", run, "--overwrite", "--steps", 40)[0] == 5 and _kept(run) != before
    data = _kept(run)
    for size in (0, 100, -4000):  # truncated
        (run / "posterior.h5").write_bytes(data[:size])
        refused(3, "no complete checkpoint", "sample", "--out", run, "--resume")
        assert _kept(run) == data[:size]


def test_usage(refused, vttig, drive, run, tmp_path):
    empty, (log, *pair) = tmp_path / "empty", drive
    for words, *arguments in (
        ("`vttig sample run`", "--resume"),
        ("vttig fit", "--out", empty, "--resume"),
        ("", "--out", empty),
        ("--pair", log, "--out", empty),
        (f"`vttig sample {log} --out run`", log, *pair),
        (f"`vttig sample {run}` samples the fit in it", run, "--out", tmp_path / "other"),
        ("exclude each other", "--out", run, "--resume", "--overwrite"),
        ("exclude each other", "--out", run, "--steps", "100", "--until", "500"),
        ("--delay", "--out", run, "--resume", "--delay", "off"),
        ("--walkers must be even and at least", "--out", run, "--overwrite", "--walkers", "5"),
        ("--walkers must be even and at least", "--out", run, "--overwrite", "--walkers", "4"),
        ("", "--out", run, "--resume", "--steps", 10),
        # Numbers that no machine holds are refused at once.
        ("Invalid value for '--ensembles'", "--out", tmp_path, "--ensembles", 10**12),
        ("Invalid value for '--walkers'", "--out", tmp_path, "--walkers", 10**12),
        ("Invalid value for '--steps'", "--out", tmp_path, "--steps", 10**12),
    ):
        refused(2, words, "sample", *arguments)
    assert not empty.exists()


def test_a_fit_that_a_kill_left_on_the_way_to_its_place_is_sampled(vttig, run, drive):
    """All files are in the stage that was switched, none at its place."""
    stage, names = run / ".commit-0", ["run.toml", "summary.npz", "fit.json"]
    fitted = (run / "fit.json").read_bytes()
    stage.mkdir()
    for name in names:
        (run / name).rename(stage / name)
    for left in ("posterior.h5", "posterior.json"):
        (run / left).unlink()
    (stage / ".commit.json").write_text(json.dumps({"files": names, "removed": []}))
    options = ("--out", run, "--resume", "--steps", STEPS, "--no-figures", "-q")
    code, _, said = vttig("sample", *drive, *options)
    assert code == 5 and "has not converged" in said
    assert (run / "fit.json").read_bytes() == fitted and not stage.exists()


@pytest.mark.slow
def test_a_command_with_resume_is_repeated(vttig, told, refused, drive, other, tmp_path):
    """It starts, goes on with a fit or with draws, and ends with 0 once all is done."""
    out = tmp_path / "run"
    options = ("--out", out, "--resume", "--until", 300, "--no-figures", "-q")
    again = ("sample", *drive, *options)
    told(*again)
    draws, fitted = _draws(out), (out / "fit.json").stat().st_mtime_ns
    # Killed before its report, then before its draws.
    for names in (("posterior.json",), ("posterior.h5", "posterior.json")):
        for name in names:
            (out / name).unlink()
        told(*again)
        assert (out / "posterior.json").exists()
        np.testing.assert_array_equal(_draws(out), draws)
    assert (out / "fit.json").stat().st_mtime_ns == fitted
    refused(3, "options", *again, "--delay", "off")
    told(*again, "--until", 310)
    refused(3, "another fit (data sha256 differ)", "sample", *other, *options)
