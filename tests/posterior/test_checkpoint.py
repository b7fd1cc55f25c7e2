"""Checkpoints: written, damaged, on a full disk, and gone on with."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tests.posterior.densities import Gaussian, only, plain, same, sample, sentence
from vttig_jax.base import InputError, UsageError
from vttig_jax.posterior import Until, checkpoint
from vttig_jax.posterior.chains import read_chains


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "posterior.h5"


def test_what_is_written_is_read_back_with_its_stop_rule(path):
    target = plain(identity={"file": "é", "nested": {"list": [1, 2.5, None]}}, units=("mm", "°"))
    rule = Until(effective=300.0, r_hat=1.2, most_steps=2000)
    chains = sample(path, target, seed=2**70, steps=None, until=rule)
    assert chains.diagnosis.converged and chains.diagnosis.steps < 2000
    found = read_chains(path)
    assert same(chains, found) and only(path)
    assert found.header.names == ("x0", "x1") and found.header.units == ("mm", "°")
    assert found.diagnosis.until == rule and str(found.diagnosis) == str(chains.diagnosis)


def test_an_existing_damaged_or_missing_file_is_refused(path, tmp_path):
    sample(path)
    before = path.read_bytes()
    target = plain()
    with pytest.raises(UsageError, match="--resume, replace it with --overwrite") as caught:
        sample(path, target)
    assert caught.value.exit_code == 2 and not target.sizes
    assert str(path) in sentence(caught.value)
    assert path.read_bytes() == before and only(path)
    sample(path, seed=1, overwrite=True)
    assert same(read_chains(path), sample(None, seed=1))
    for kind, before in damaged(path).items():
        path.write_bytes(before)
        for attempt in (lambda: sample(path, resume=True), lambda: read_chains(path)):
            with pytest.raises(InputError, match="no complete checkpoint of vttig") as caught:
                attempt()
            sentence(caught.value)
            assert path.read_bytes() == before and only(path), kind
    with pytest.raises(InputError, match="this checkpoint does not exist"):
        read_chains(tmp_path / "posterior.h5")
    with pytest.raises(InputError) as caught:
        read_chains(tmp_path)
    sentence(caught.value)


def damaged(path: Path) -> dict[str, bytes]:
    """Contents of checkpoints that are none, or not whole."""
    whole = path.read_bytes()
    middle = whole.index(read_chains(path).record.draws.tobytes()[800:840])
    with h5py.File(path, "w") as file:
        file["draws"] = np.zeros(3)
    flipped = {place: bytes([whole[place] ^ 4]) for place in (middle, 40)}
    return {
        "no checkpoint": path.read_bytes(),
        "text": b"time,angle\n0,1\n",
        "empty": b"",
        "half": whole[:middle],
        "one byte short": whole[:-1],
    } | {f"bit {k}": whole[:k] + bit + whole[k + 1 :] for k, bit in flipped.items()}


def test_a_second_writer_is_refused_and_a_file_left_over_no_hindrance(path):
    said = []

    def progress(_: object) -> None:
        with pytest.raises(UsageError, match="another vttig is writing to this checkpoint"):
            sample(path, overwrite=True)
        said.append(1)

    path.parent.mkdir()
    path.with_name(".posterior.h5.tmp").write_bytes(b"half of an older one")
    chains = sample(path, progress=progress)
    assert said and same(chains, read_chains(path)) and only(path)


def test_generations_come_by_the_clock(path, monkeypatch):
    written, now = [], [0.0]
    real = checkpoint.replace_file

    def write(target: Path, data: bytes) -> None:
        now[0] += 1.0  # slow to write: 20 s until the next
        real(target, data)
        written.append(read_chains(target).diagnosis.steps)

    def progress(_: object) -> None:
        now[0] += 4.0

    monkeypatch.setattr(checkpoint, "replace_file", write)
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: now[0])
    sample(path, steps=500, progress=progress)
    assert written == [150, 400, 500]


def full_after(monkeypatch: pytest.MonkeyPatch, generations: int) -> list[Path]:
    """Write every block, let so many generations through, refuse more; the refusals so far."""
    monkeypatch.setattr(checkpoint, "SAVE_S", 0.0)
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: 0.0)
    refused: list[Path] = []
    real, left = checkpoint.replace_file, [generations]

    def write(target: Path, data: bytes) -> None:
        left[0] -= 1
        if left[0] < 0:
            refused.append(target)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(target, data)

    monkeypatch.setattr(checkpoint, "replace_file", write)
    return refused


@pytest.mark.parametrize("generations", [0, 1])
def test_a_full_disk_leaves_the_generation_before(path, monkeypatch, generations):
    refused = full_after(monkeypatch, generations)
    with pytest.raises(InputError, match="no space left") as caught:
        sample(path, steps=200)
    sentence(caught.value)
    assert caught.value.exit_code == 3 and len(refused) == 1  # not tried again on the way out
    assert path.exists() == bool(generations)
    monkeypatch.undo()
    assert same(sample(path, steps=200, resume=True), sample(None, steps=200))


def test_a_full_disk_leaves_the_file_that_was_to_be_replaced(path, monkeypatch):
    sample(path)
    before = path.read_bytes()
    full_after(monkeypatch, 0)
    with pytest.raises(InputError):
        sample(path, seed=1, overwrite=True)
    assert path.read_bytes() == before and only(path)


def test_no_permission_leaves_no_folder(path, monkeypatch):
    def replace(source: Path, target: Path) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(InputError, match="no permission to write here"):
        sample(path)
    assert not path.parent.exists()  # nor is the folder left that it made


def test_killed_at_any_moment_it_goes_on_bit_for_bit(tmp_path):
    command = [sys.executable, "-m", "tests.posterior.killed", str(tmp_path)]
    folder = Path(__file__).parents[2]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["same"]
    assert found["signals"][:4] == [9, 9, 9, 9] and found["signals"].count(9) >= 5
    assert found["steps"] == sorted(found["steps"]) and found["steps"][3] > 0
    assert found["left_over"] >= 2  # killed in the writing and before the move
    assert found["files"] == ["posterior.h5"]


def test_a_finished_run_is_there_at_once_or_goes_on_by_the_rule(path):
    chains = sample(path)
    before, inode, target = path.read_bytes(), path.stat().st_ino, plain()
    assert same(sample(path, target, resume=True), chains)
    assert path.stat().st_ino == inode  # nor was the file written anew
    assert len(target.sizes) <= 1  # no step was made
    assert path.read_bytes() == before and only(path)
    path = path.with_name("other.h5")
    by_the_rule: dict[str, Any] = {"steps": None, "until": Until(effective=2000.0)}
    whole = sample(None, **by_the_rule)
    sample(path, steps=85)
    for _ in range(2):
        assert same(sample(path, **by_the_rule, resume=True), whole)
    assert whole.diagnosis.steps % 50 == 0 and whole.diagnosis.converged


@pytest.mark.parametrize("first", [0, 50, 85, 87])
def test_more_steps_go_on_from_the_last(path, first):
    if first:
        sample(path, steps=first)
    assert same(sample(path, steps=140, resume=True), sample(None, steps=140))
    assert same(read_chains(path), sample(None, steps=140)) and only(path)


def test_a_checkpoint_of_another_run_says_what_differs(path):
    sample(path)
    before = path.read_bytes()
    cases: list[tuple[dict[str, Any], str]] = [
        ({"target": plain(names=("x0", "y"))}, "names"),
        ({"target": plain(units=("mm", "rad"))}, "units"),
        ({"target": plain(3)}, "names"),
        ({"target": plain(identity={"data": "ab12", "priors": [2.5]})}, "priors"),
        ({"target": plain(identity={"data": "ffff", "priors": [1.5]})}, "data"),
        ({"target": Gaussian(np.zeros(2), 2 * np.eye(2)), "steps": 200}, "another density"),
        ({"seed": 7}, "seed 0 in it, 7"),
        ({"walkers": 32}, "walkers 16 in it, 32"),
        ({"ensembles": 5}, "ensembles 4 in it, 5"),
    ]
    for options, words in cases:
        with pytest.raises(InputError) as caught:
            sample(path, **options, resume=True)
        assert words in sentence(caught.value) and caught.value.exit_code == 3
    with pytest.raises(UsageError, match="already holds 100 steps"):
        sample(path, steps=50, resume=True)
    assert path.read_bytes() == before and only(path)


class Interrupted(Gaussian):
    left, interruption = 350, KeyboardInterrupt

    def log_density(self, points: np.ndarray) -> np.ndarray:
        self.left -= 1
        if self.left == 0:
            raise self.interruption
        return super().log_density(points)


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit, ValueError])
def test_an_interrupt_leaves_a_checkpoint_and_goes_on(path, interruption):
    target = Interrupted(np.zeros(2), np.eye(2))
    target.interruption = interruption
    with pytest.raises(interruption):
        sample(path, target, steps=300)
    assert 0 < read_chains(path).diagnosis.steps < 300 and only(path)
    assert same(sample(path, steps=300, resume=True), sample(None, steps=300))
