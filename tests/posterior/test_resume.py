import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.posterior.densities import Gaussian, plain
from tests.posterior.runs import REPOSITORY, only, same, sample, sentence
from vttig_jax.base.errors import InputError, UsageError, VttigError
from vttig_jax.posterior.sampling.ensembles import read_chains
from vttig_jax.posterior.sampling.stop_rule import Until


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "posterior.h5"


def test_killed_at_any_moment_it_goes_on_bit_for_bit(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "tests.posterior.killed", str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["same"]
    assert found["signals"][:4] == [9, 9, 9, 9] and found["signals"].count(9) >= 8
    assert found["steps"] == sorted(found["steps"]) and 0 < found["steps"][3] <= 1800
    assert found["left_over"] >= 2  # killed in the writing and before the move
    assert found["files"] == ["posterior.h5"]


def test_a_finished_run_resumed_is_there_at_once(path):
    chains = sample(path)
    before = path.read_bytes()
    target = plain()
    inode = path.stat().st_ino
    assert same(sample(path, target, resume=True), chains)
    assert path.stat().st_ino == inode  # nor was the file written anew
    assert len(target.sizes) <= 3  # no step was made
    assert path.read_bytes() == before and only(path)


@pytest.mark.parametrize("first", [200, 237, 203])
def test_more_steps_go_on_from_the_last(path, first):
    sample(path, steps=first)
    assert same(sample(path, steps=450, resume=True), sample(None, steps=450))
    assert same(read_chains(path), sample(None, steps=450))


def test_a_run_by_steps_goes_on_by_the_rule_as_one_by_the_rule_alone(path):
    rule = Until(autocorrelation_times=60.0)
    whole = sample(None, steps=None, until=rule)
    sample(path, steps=537)
    assert same(sample(path, steps=None, until=rule, resume=True), whole)
    assert whole.steps % 200 == 0 and whole.diagnosis.converged
    again = sample(path, steps=None, until=rule, resume=True)
    assert same(again, whole)


def test_fewer_steps_than_there_are_is_refused(path):
    sample(path, steps=400)
    before = path.read_bytes()
    with pytest.raises(UsageError, match="already holds 400 steps, more than the 200"):
        sample(path, steps=200, resume=True)
    assert path.read_bytes() == before and only(path)


def test_where_nothing_is_there_a_resumed_run_starts(path):
    assert same(sample(path, resume=True), sample(None))
    assert only(path)
    assert same(sample(path, steps=450, resume=True), sample(None, steps=450))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"target": plain(names=("x0", "y"))}, '`names[1]` is "x1", "y" expected'),
        ({"target": plain(units=("mm", "rad"))}, '`units[1]` is "mm", "rad" expected'),
        ({"target": plain(3)}, '`names` is ["x0", "x1"], ["x0", "x1", "x2"] expected'),
        (
            {"target": plain(identity={"data": "ab12", "prior": {"a": 2.5}})},
            "`identity.prior.a` is 1.5, 2.5 expected",
        ),
        (
            {"target": plain(identity={"data": "ab12", "delay": 1})},
            '`identity.prior` is {"a": 1.5}, not expected; `identity.delay` is missing, 1 exp',
        ),
        ({"seed": 7}, "`seed` is 0, 7 expected"),
        ({"walkers": 32}, "`walkers` is 16, 32 expected"),
        ({"ensembles": 5}, "`ensembles` is 4, 5 expected"),
        ({"thin": 4}, "`thin` is 5, 4 expected"),
        (
            {"seed": 7, "thin": 4, "walkers": 32, "ensembles": 5},
            "`walkers` is 16, 32 expected; and 1 more; ",
        ),
    ],
)
def test_a_checkpoint_of_another_run_says_what_differs(path, options, words):
    sample(path)
    before = path.read_bytes()
    with pytest.raises(InputError) as caught:
        sample(path, **options, resume=True)
    assert words in sentence(caught.value) and caught.value.exit_code == 3
    assert path.read_bytes() == before and only(path)


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_leaves_a_checkpoint_and_goes_on(path, interruption):
    class Interrupted(Gaussian):
        left = 750

        def log_density(self, points: np.ndarray) -> np.ndarray:
            self.left -= 1
            if self.left == 0:
                raise interruption
            return super().log_density(points)

    with pytest.raises(interruption):
        sample(path, Interrupted(np.zeros(2), np.eye(2)), steps=600)
    assert read_chains(path).steps == 200 and only(path)
    assert same(sample(path, steps=600, resume=True), sample(None, steps=600))


def test_a_failing_density_leaves_a_checkpoint_too(path):
    class Failing(Gaussian):
        left = 750

        def log_density(self, points: np.ndarray) -> np.ndarray:
            self.left -= 1
            return super().log_density(points) * (np.nan if self.left <= 0 else 1.0)

    with pytest.raises(VttigError, match="the log density is nan at x0 = "):
        sample(path, Failing(np.zeros(2), np.eye(2)), steps=600)
    assert read_chains(path).steps == 200
