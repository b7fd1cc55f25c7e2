from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.posterior.densities import Gaussian, plain
from vttig_jax.posterior.sampling.ensembles import Chains, run_ensembles
from vttig_jax.posterior.sampling.progress import Progress
from vttig_jax.posterior.sampling.stop_rule import Until


class TwoModes(Gaussian):
    """Two normals so far apart that no walker crosses; one ensemble starts in one of them."""

    apart = 30.0

    def log_density(self, points: np.ndarray) -> np.ndarray:
        one = super().log_density(points)
        other = super().log_density(points - self.apart)
        return np.logaddexp(one, other)

    def starts(self, count: int, generator: np.random.Generator) -> np.ndarray:
        points = super().starts(count, generator)
        return points + (self.apart if generator.uniform() < 0.5 else 0.0)


class Islands(TwoModes):
    """The same, but every ensemble starts on both."""

    def starts(self, count: int, generator: np.random.Generator) -> np.ndarray:
        points = Gaussian.starts(self, count, generator)
        return points + self.apart * (np.arange(count) % 2)[:, None]


@pytest.fixture(scope="module")
def skewed() -> tuple[Gaussian, Chains]:
    """A correlated normal of condition 1e6, started four times too wide, and its chains."""
    generator = np.random.default_rng(4)
    d = 5
    turned = np.linalg.qr(generator.standard_normal((d, d)))[0] * np.geomspace(1, 1e-3, d)
    target = Gaussian(np.arange(float(d)), turned @ turned.T, spread=4.0)
    return target, run_ensembles(target, seed=1)


def test_it_stops_when_long_and_agreed(skewed):
    _, chains = skewed
    diagnosis = chains.diagnosis
    assert diagnosis.converged and diagnosis.shortest >= 50 and diagnosis.r_hat.max() <= 1.01
    assert 1000 <= chains.steps < 10_000 and chains.steps % 200 == 0
    assert str(chains).startswith("converged: yes; shortest chain ")
    assert chains.draws.shape == (4, chains.steps // 5, 64, 5)
    assert chains.log_density.shape == chains.draws.shape[:3]
    assert chains.discarded == chains.steps // 20 * 5
    assert chains.kept.shape[1] * 5 == chains.steps - chains.discarded
    assert chains.flat().shape == (chains.kept.size // 5, 5)
    assert ((chains.acceptance > 0.2) & (chains.acceptance < 0.5)).all()


def test_mean_covariance_and_coverage_are_those_of_the_density(skewed):
    target, chains = skewed
    white = target.whitened(chains.flat())
    effective = chains.diagnosis.effective.min()
    np.testing.assert_allclose(white.mean(0), 0.0, atol=4.5 / np.sqrt(effective))
    np.testing.assert_allclose(np.cov(white.T), np.eye(5), atol=4.5 * np.sqrt(2 / effective))
    inside = (np.abs(white) < 1.959964).mean(0)
    np.testing.assert_allclose(inside, 0.95, atol=4.5 * np.sqrt(0.95 * 0.05 / effective))


def test_the_stated_error_of_the_mean_is_the_one_between_ensembles():
    # The means of 24 ensembles scatter as √(1/effective draws) of each says.
    chains = run_ensembles(plain(), ensembles=24, steps=480, walkers=16)
    scores = chains.kept.mean((1, 2)) * np.sqrt(chains.diagnosis.effective / 24)
    assert np.std(scores) == pytest.approx(1.0, abs=0.35)  # 48 scores: 3.4 standard errors


def test_log_densities_belong_to_their_draws(skewed):
    target, chains = skewed
    expected = target.log_density(chains.flat())
    kept = chains.log_density[:, chains.discarded // chains.thin :].ravel()
    np.testing.assert_allclose(kept, expected, rtol=1e-6)


def test_ensembles_in_different_modes_have_not_converged():
    chains = run_ensembles(TwoModes(np.zeros(2), np.eye(2)), steps=2000, seed=2)
    modes = chains.kept.mean((1, 2, 3)) > 15
    assert 0 < modes.sum() < 4  # the seed puts ensembles in both
    assert chains.diagnosis.long_enough and not chains.diagnosis.converged
    assert "different parts of the posterior" in str(chains)


def test_walkers_in_different_modes_have_not_converged():
    chains = run_ensembles(Islands(np.zeros(4), np.eye(4)), steps=2000)
    assert not chains.diagnosis.converged
    assert np.isin(np.round(chains.kept.mean((0, 1, 3)) / 30), [0, 1]).all()


def test_exactly_the_steps_asked_for():
    chains = run_ensembles(plain(), steps=1013, walkers=16)
    assert chains.steps == 1013 and chains.draws.shape[1] == 202


def test_the_rule_gives_up_at_the_most_steps():
    rule = Until(autocorrelation_times=1000.0, most_steps=1300)
    chains = run_ensembles(plain(), until=rule, walkers=16)
    assert chains.steps == 1300 and not chains.diagnosis.converged


def test_seeds_are_recorded_and_decide_the_draws():
    one, again, other = (run_ensembles(plain(), steps=100, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.draws, again.draws)
    assert (one.seed, other.seed) == (3, 4)
    assert not np.isin(other.draws, one.draws).any()


def test_the_numpy_generator_of_the_user_is_left_alone():
    np.random.seed(5)  # noqa: NPY002
    expected = np.random.random(3)  # noqa: NPY002
    np.random.seed(5)  # noqa: NPY002
    run_ensembles(plain(), steps=100)
    np.testing.assert_array_equal(np.random.random(3), expected)  # noqa: NPY002


@pytest.mark.parametrize(("d", "walkers"), [(1, 64), (31, 64), (32, 66), (40, 82)])
def test_there_are_enough_walkers_by_default(d, walkers):
    chains = run_ensembles(plain(d), steps=40)
    assert chains.draws.shape == (4, 8, walkers, d)


def test_progress_by_steps():
    seen: list[Progress] = []
    run_ensembles(plain(), steps=1100, walkers=16, progress=seen.append)
    assert [item.steps for item in seen] == [200, 400, 600, 800, 1000, 1100]
    assert {item.total for item in seen} == {1100}
    assert all(item.steps_per_s > 0 for item in seen)
    left = [item.remaining_s for item in seen]
    assert None not in left and left[-1] == 0.0 and (left[0] or 0) > 0
    assert seen[0].diagnosis == "" and seen[4].diagnosis.startswith("converged: ")


def test_progress_by_the_rule_estimates_by_the_autocorrelation_time():
    seen: list[Progress] = []
    rule = Until(autocorrelation_times=150.0)
    chains = run_ensembles(plain(), until=rule, walkers=16, progress=seen.append)
    assert {item.total for item in seen} == {None}
    assert seen[0].remaining_s is None
    assert seen[-1].steps == chains.steps and seen[-1].remaining_s == 0.0
    guess = seen[4]
    assert guess.steps == 1000 and guess.remaining_s is not None
    expected = (chains.steps - 1000) / guess.steps_per_s
    assert guess.remaining_s == pytest.approx(expected, rel=0.35)
    assert seen[-1].diagnosis == str(chains.diagnosis)


def test_progress_does_not_change_the_draws():
    one = run_ensembles(plain(), steps=1000, walkers=16, progress=lambda _: None)
    np.testing.assert_array_equal(one.draws, run_ensembles(plain(), steps=1000, walkers=16).draws)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"ensembles": 3}, "ensembles"),
        ({"walkers": 15}, "walkers"),
        ({"walkers": 2}, "walkers"),
        ({"steps": 39}, "steps"),
        ({"steps": 100, "until": Until()}, "until"),
        ({"until": Until(most_steps=200), "thin": 50}, "steps"),
        ({"seed": -1}, "seed"),
        ({"thin": 0}, "thin"),
        ({"resume": True}, "checkpoint"),
        ({"resume": True, "overwrite": True, "checkpoint": Path("x.h5")}, "overwrite"),
        ({"target": plain(names=("a", "a"))}, "target"),
        ({"target": plain(units=("mm",))}, "target"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], name: str):
    target = options.pop("target", plain())
    with pytest.raises(ValueError, match=f"Argument `{name}` must"):
        run_ensembles(target, **options)
