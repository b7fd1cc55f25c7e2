"""`vttig sample` on a cheap drive: what it prints, keeps, refuses and goes on with."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from filelock import FileLock

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
def sampled(folder) -> Path:
    """A run folder with too few steps to converge."""
    out = folder / "run"
    arguments = [folder / "log.csv", "--pair", folder / "pair.toml", "--out", out]
    steps = ["--steps", STEPS, "--no-figures"]
    assert main([str(a) for a in ("sample", *arguments, *steps)]) == 5
    return out


@pytest.fixture
def run(sampled, tmp_path) -> Path:
    """A copy of that run folder to play with."""
    return Path(shutil.copytree(sampled, tmp_path / "run"))


def _draws(out: Path) -> np.ndarray:
    return read_chains(out / "posterior.h5").record.draws


def test_too_few_steps_are_said_and_kept(vttig, folder, run):
    code, out, err = vttig("sample", "--out", run, "--resume", "--no-figures", "--steps", STEPS)
    assert code == 5
    assert out.startswith("not converged: ") and "converged: no; " in out
    assert "the sampler has not converged" in err and f"`vttig sample {run} --resume`" in err
    assert {"posterior.h5", "posterior.json", "fit.json", "summary.npz", "run.toml"} <= {
        path.name for path in run.iterdir()
    }


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


def test_an_interrupt_says_what_is_kept(vttig, run, monkeypatch):
    monkeypatch.setattr(FitTarget, "log_density", Interrupted(500))
    code, out, err = vttig("sample", run, "--resume", "--steps", "100000")
    assert code == 130 and out == "" and err.count("\n") == 1
    assert f"{run / 'posterior.h5'}" in err and "--resume" in err
    monkeypatch.undo()
    assert _draws(run).shape[1] >= 8


def test_the_run_folder_is_the_argument(vttig, folder, run, tmp_path):
    again = ("--resume", "--no-figures", "--steps", STEPS, "--json")
    named, said = (vttig("sample", *place, *again) for place in ((run,), ("--out", run)))
    assert named[:2] == said[:2] and named[0] == 5
    code, _, err = vttig("sample", run, "--out", tmp_path / "other")
    assert code == 2 and f"`vttig sample {run}` samples the fit in it" in err
    code, _, err = vttig("sample", folder / "log.csv", "--pair", folder / "pair.toml")
    assert code == 2 and f"`vttig sample {folder / 'log.csv'} --out run`" in err
    code, _, err = vttig("sample", "--resume")
    assert code == 2 and "`vttig sample run`" in err


def test_the_json_holds_what_the_folder_holds(vttig_json, run):
    code, record = vttig_json("sample", "--out", run, "--resume", "--steps", STEPS, "--no-figures")
    assert code == 5 and record["schema"] == "vttig.error/1" and record["exit"] == 5
    kept = json.loads((run / "posterior.json").read_text())
    assert kept["schema"] == "vttig.posterior/1" and not kept["converged"]
    assert kept["parameters"]["driving_amplitude_arcsec"]["median"] == pytest.approx(30, abs=1)
    assert {"prior", "diagnosis"} <= set(kept)


@pytest.mark.portable
def test_going_on_ends_as_if_never_stopped(vttig, folder, run, tmp_path):
    vttig("sample", "--out", run, "--resume", "--no-figures", "--steps", 2 * STEPS)
    whole = tmp_path / "whole"
    log, pair = folder / "log.csv", folder / "pair.toml"
    vttig("sample", log, "--pair", pair, "--out", whole, "--no-figures", "--steps", 2 * STEPS)
    np.testing.assert_array_equal(_draws(run), _draws(whole))
    another = tmp_path / "another"
    arguments = ("--no-figures", "--steps", STEPS, "--seed", 1)
    vttig("sample", log, "--pair", pair, "--out", another, *arguments)
    assert not np.array_equal(_draws(another), _draws(run)[:, : _draws(another).shape[1]])


@pytest.mark.slow
def test_the_stop_rule_ends_it_and_pictures_are_drawn(vttig_json, run):
    code, record = vttig_json("sample", "--out", run, "--resume", "--until", "600")
    assert code == 0 and record["converged"]
    assert min(record["diagnosis"]["effective_draws"].values()) >= 600
    names = {path.name for path in (run / "figures").iterdir()}
    assert names == {"corner.png", "trace.png", "band.png"}
    fit = json.loads((run / "fit.json").read_text())["parameters"]
    for name, parameter in record["parameters"].items():
        if fit[name]["determined"] and fit[name]["std"]:
            assert parameter["std"] == pytest.approx(fit[name]["std"], rel=0.3)


def test_the_map_has_bands_after_it(vttig, vttig_json, run, tmp_path):
    code, out, err = vttig("map", run, "--out", tmp_path / "map.csv")
    assert code == 0 and "95 % of the whole map" in out
    assert "have not converged" in err
    table = np.genfromtxt(tmp_path / "map.csv", delimiter=",", names=True)
    assert np.all(table["low95_simultaneous_deg"] < table["low95_deg"])
    assert np.all(table["low95_deg"] < table["backlash_deg"])
    assert np.all(table["high95_deg"] < table["high95_simultaneous_deg"])
    _, half = vttig_json("map", run, "--probability", "0.5")
    _, most = vttig_json("map", run)
    assert half["probability"] == 0.5 and half["critical"] < most["critical"]
    assert vttig("map", run, "--closing-mm", "0.1")[0] == 4  # a drive has no taper
    code, _, err = vttig("map", run, "--closing-mm", 0.1, "--constant-backlash-deg", 0.1)
    assert code == 2 and "leave out --constant-backlash-deg" in err


def test_a_new_fit_takes_old_draws_away(vttig, folder, run):
    log, pair = folder / "other.csv", folder / "pair.toml"
    _, _, err = vttig("fit", log, "--pair", pair, "--out", run, "--overwrite", "--no-figures")
    assert "draws" in err
    assert not (run / "posterior.h5").exists() and not (run / "posterior.json").exists()


def _same(run: Path, before: bytes) -> bool:
    return (run / "posterior.h5").read_bytes() == before


def test_what_is_there_is_not_replaced_unasked(vttig, folder, run):
    before = (run / "posterior.h5").read_bytes()
    code, _, err = vttig("sample", "--out", run)
    assert code == 2 and "--resume" in err and "--overwrite" in err
    code, _, err = vttig("sample", folder / "log.csv", "--pair", folder / "pair.toml", "--out", run)
    assert code == 2 and "already exists" in err
    assert _same(run, before)
    code, *_ = vttig("sample", "--out", run, "--overwrite", "--steps", 40, "--no-figures")
    assert code == 5 and not _same(run, before)


def test_the_seed_is_that_of_the_draws_unless_given(vttig, folder, tmp_path):
    out = tmp_path / "run"
    log, pair = folder / "log.csv", folder / "pair.toml"
    chosen = ("--seed", 7, "--walkers", 34, "--steps", 40)
    vttig("sample", log, "--pair", pair, "--out", out, "--no-figures", *chosen)
    code, _, err = vttig("sample", "--out", out, "--resume", "--no-figures", "--steps", 60)
    assert code == 5, err
    chains = read_chains(out / "posterior.h5")
    assert (chains.header.seed, chains.header.walkers, chains.diagnosis.steps) == (7, 34, 60)


def test_walkers_in_words(vttig, run):
    for odd in ("5", "4"):
        code, _, err = vttig("sample", "--out", run, "--overwrite", "--walkers", odd)
        assert code == 2 and "--walkers must be even and at least" in err
    assert vttig("sample", "--out", run, "--resume", "--steps", 10)[0] == 2


def test_a_fit_is_not_replaced_under_a_sampler(vttig, folder, run):
    before = (run / "fit.json").read_bytes()
    with FileLock(run / ".posterior.h5.lock"):
        log, pair = folder / "other.csv", folder / "pair.toml"
        code, _, err = vttig("fit", log, "--pair", pair, "--out", run, "--overwrite")
    assert code == 2 and "a sampler is writing" in err
    assert (run / "fit.json").read_bytes() == before and (run / "posterior.h5").exists()


def test_a_checkpoint_of_another_log_is_refused(vttig, folder, run):
    before = (run / "posterior.h5").read_bytes()
    other = ("sample", folder / "other.csv", "--pair", folder / "pair.toml", "--out", run)
    code, _, err = vttig(*other, "--resume", "--steps", 800)
    assert code == 3 and "data_sha256" in err.replace(" ", "_")
    code, _, err = vttig("sample", "--out", run, "--resume", "--seed", 5)
    assert code == 3 and "seed" in err
    assert _same(run, before)


@pytest.mark.parametrize("size", [0, 100, -4000])
def test_a_truncated_checkpoint_is_refused(vttig, run, size):
    data = (run / "posterior.h5").read_bytes()
    (run / "posterior.h5").write_bytes(data[:size])
    code, _, err = vttig("sample", "--out", run, "--resume")
    assert code == 3 and "no complete checkpoint" in err
    assert _same(run, data[:size])


def test_usage(vttig, folder, run, tmp_path):
    log, pair = folder / "log.csv", folder / "pair.toml"
    empty = tmp_path / "empty"
    assert vttig("sample", "--out", empty)[0] == 2
    code, _, err = vttig("sample", "--out", empty, "--resume")
    assert code == 2 and "vttig fit" in err
    code, _, err = vttig("sample", log, "--out", empty)
    assert code == 2 and "--pair" in err
    for wrong in (("--resume", "--overwrite"), ("--steps", "100", "--until", "500")):
        code, _, err = vttig("sample", "--out", run, *wrong)
        assert code == 2 and "exclude each other" in err
    code, _, err = vttig("sample", "--out", run, "--resume", "--delay", "off")
    assert code == 2 and "--delay" in err
    assert vttig("sample", log, "--pair", pair)[0] == 2
    assert not empty.exists()


@pytest.mark.slow
def test_a_command_with_resume_is_repeated(vttig, folder, tmp_path):
    """It starts, goes on with a fit or with draws, and ends with 0 once all is done."""
    out = tmp_path / "run"
    again = ("sample", folder / "log.csv", "--pair", folder / "pair.toml", "--out", out)
    again = (*again, "--resume", "--until", 300, "--no-figures", "-q")
    code, _, err = vttig(*again)
    assert code == 0, err
    draws, fitted = _draws(out), (out / "fit.json").stat().st_mtime_ns
    (out / "posterior.json").unlink()  # killed before its report
    assert vttig(*again)[0] == 0 and (out / "posterior.json").exists()
    np.testing.assert_array_equal(_draws(out), draws)
    for name in ("posterior.h5", "posterior.json"):  # killed before its draws
        (out / name).unlink()
    assert vttig(*again)[0] == 0 and (out / "posterior.json").exists()
    np.testing.assert_array_equal(_draws(out), draws)
    assert (out / "fit.json").stat().st_mtime_ns == fitted
    for changed, words in ((("--delay", "off"), "options"), (("--until", 310), "")):
        code, _, err = vttig(*again, *changed)
        assert code == (3 if words else 0) and words in err
    other = ("sample", folder / "other.csv", *again[2:])
    code, _, err = vttig(*other)
    assert code == 3 and "another fit (data sha256 differ)" in err


@pytest.mark.slow
def test_killed_and_resumed(folder, tmp_path):
    """The real command, killed while it samples: an import and a fit each, hence the time."""
    script = "import sys; from vttig_jax.cli.main import main; sys.exit(main(sys.argv[1:]))"
    log, pair = str(folder / "log.csv"), str(folder / "pair.toml")
    common = ["--no-figures", "--steps", "3000", "-q"]
    whole, killed = tmp_path / "whole", tmp_path / "killed"

    def start(*arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-c", script, "sample", *arguments, *common]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    first = start(log, "--pair", pair, "--out", str(killed))
    checkpoint = killed / "posterior.h5"
    patience = time.monotonic() + 120
    while not checkpoint.exists() and first.poll() is None and time.monotonic() < patience:
        time.sleep(0.02)
    os.kill(first.pid, signal.SIGKILL)
    first.communicate()
    assert first.returncode == -signal.SIGKILL
    with h5py.File(checkpoint) as file:
        assert file.keys()
    assert read_chains(checkpoint).diagnosis.steps < 3000
    resumed, unbroken = (
        start("--out", str(killed), "--resume"),
        start(log, "--pair", pair, "--out", str(whole)),
    )
    for process in (resumed, unbroken):
        _, err = process.communicate(timeout=180)
        assert process.returncode in (0, 5), err
    np.testing.assert_array_equal(_draws(killed), _draws(whole))


@pytest.mark.parametrize("option", ["--ensembles", "--walkers", "--steps"])
def test_numbers_that_no_machine_holds_are_refused_at_once(vttig, tmp_path, option):
    code, _, err = vttig("sample", "--out", tmp_path, option, "1000000000000")
    assert code == 2 and f"Invalid value for '{option}'" in err
