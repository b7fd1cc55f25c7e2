import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.posterior.densities import Gaussian, plain
from tests.posterior.runs import only, same, sample, sentence
from vttig_jax.base.errors import InputError, UsageError
from vttig_jax.posterior.chains import read_chains
from vttig_jax.posterior.until import Until


def test_killed_at_any_moment_it_goes_on_bit_for_bit(tmp_path):
    command = [sys.executable, "-m", "tests.posterior.killed", str(tmp_path)]
    folder = Path(__file__).parents[2]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["same"]
    assert found["signals"][:4] == [9, 9, 9, 9] and found["signals"].count(9) >= 8
    assert found["steps"] == sorted(found["steps"]) and found["steps"][3] > 0
    assert found["left_over"] >= 2  # killed in the writing and before the move
    assert found["files"] == ["posterior.h5"]


def test_a_finished_run_resumed_is_there_at_once(path):
    chains = sample(path)
    before, inode, target = path.read_bytes(), path.stat().st_ino, plain()
    assert same(sample(path, target, resume=True), chains)
    assert path.stat().st_ino == inode  # nor was the file written anew
    assert len(target.sizes) <= 1  # no step was made
    assert path.read_bytes() == before and only(path)


@pytest.mark.parametrize("first", [0, 50, 85, 87])
def test_more_steps_go_on_from_the_last(path, first):
    if first:
        sample(path, steps=first)
    assert same(sample(path, steps=140, resume=True), sample(None, steps=140))
    assert same(read_chains(path), sample(None, steps=140)) and only(path)


def test_a_run_by_steps_goes_on_by_the_rule_as_one_by_the_rule_alone(path):
    by_the_rule: dict[str, Any] = {"steps": None, "until": Until(effective=2000.0)}
    whole = sample(None, **by_the_rule)
    sample(path, steps=85)
    for _ in range(2):
        assert same(sample(path, **by_the_rule, resume=True), whole)
    assert whole.diagnosis.steps % 50 == 0 and whole.diagnosis.converged


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
    left, interruption = 750, KeyboardInterrupt

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
        sample(path, target, steps=600)
    assert 0 < read_chains(path).diagnosis.steps < 600 and only(path)
    assert same(sample(path, steps=600, resume=True), sample(None, steps=600))
