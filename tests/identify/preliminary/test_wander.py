"""A level that wanders: its likelihood, its size, and the intervals beside it."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from tests.identify.summaries import TERMS, normal_matrix, random_log
from vttig_jax.base.units import ARCSEC
from vttig_jax.identify.compress.harmonic_summary import summarise
from vttig_jax.identify.compress.orthogonal import triangle_of
from vttig_jax.identify.compress.regressors import Drift, steps
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.noise.noise_model import NoiseModel
from vttig_jax.identify.preliminary.nuisance import NuisanceRegression, own_terms
from vttig_jax.identify.preliminary.wander import _height
from vttig_jax.identify.solve.beside import Walk
from vttig_jax.identify.solve.solved_fit import SolvedFit

PAIR = drive("1/64")
MOTION = there_and_back([240, 120, 180], 2.5, ramp_s=1.0)
DELAY_S = 0.003
SEEDS = range(6)


def logged(seed: int, step_arcsec: float, motion=MOTION):
    """A log whose level makes a random step of this size every second, and a first order."""

    def error(angle, _):
        walk = np.cumsum(np.random.default_rng(100 + seed).standard_normal(200)) * step_arcsec
        time = np.arange(len(angle)) / 100.0
        return 20 * np.sin(angle + 0.3) + np.interp(time, np.arange(200), walk)

    return drive_log(PAIR, motion, gap=level(30.0), error=error, delay_s=level(DELAY_S), seed=seed)


@pytest.fixture(scope="module")
def wandering() -> list[Fit]:
    return [fit(logged(seed, 10.0), PAIR) for seed in SEEDS]


def _away(found: Fit) -> float:
    """Distance of the delay from the truth in half-widths of its interval."""
    delay = found.parameters["delay_s"]
    half = (known(delay.high95) - known(delay.low95)) / 2
    return abs(known(delay.value) - DELAY_S) / half


def test_the_interval_of_the_delay_allows_for_the_level(wandering):
    """A drift that a user demands is taken as it is, and its intervals are too narrow."""
    plain = [fit(logged(seed, 10.0), PAIR, drift_order=2) for seed in SEEDS]
    assert sum(_away(one) > 1 for one in wandering) <= 1
    assert sum(_away(one) > 1 for one in plain) >= 2
    assert all(one.checks.wander is None for one in plain)


def test_the_size_of_a_step_is_found(wandering):
    for one in wandering:
        wander = one.checks.wander
        assert wander is not None and wander.widening > 1
        per_second = wander.step_arcsec / np.sqrt(wander.knots_s)
        assert 10.0 / 2.5 < per_second < 10.0 * 2.5
        assert "the level of the transmission error wanders by" in str(one)


def test_a_level_that_stays_is_left_alone():
    for seed in SEEDS[:2]:
        still = fit(logged(seed, 0.0), PAIR)
        plain = fit(logged(seed, 0.0), PAIR, drift_order=still.checks.drift_order)
        assert still.checks.wander is None
        one, other = (known(f.parameters["delay_s"].std) for f in (still, plain))
        assert one == pytest.approx(other, rel=1e-6)


def test_two_runs_tell_no_walk():
    """There a walk resembles the gap."""
    once = there_and_back([240], 8.0, ramp_s=1.0)
    assert fit(logged(0, 10.0, once), PAIR).checks.wander is None


def test_the_likelihood_is_that_of_a_random_walk():
    """Against the density of the residual space under the dense covariance of steps and noise."""
    rng = np.random.default_rng(0)
    names = ("delay", *(f"spline_{k}" for k in range(1, 7)))
    columns = rng.standard_normal((40, 7))
    y = columns @ rng.standard_normal(7) + rng.standard_normal(40)
    own = NuisanceRegression(
        names, triangle_of(np.column_stack([columns, y])), 40.0, float(y @ y), np.ones(7)
    )
    basis = np.linalg.svd(columns[:, :1])[0][:, 1:]
    spread = np.linalg.inv(steps(6))

    def dense(stiffness: float) -> float:
        walk = columns[:, 1:] @ spread / stiffness
        among = basis.T @ (np.eye(40) + walk @ walk.T) @ basis
        rest = basis.T @ y
        return 39 * np.log(rest @ np.linalg.solve(among, rest)) + np.linalg.slogdet(among)[1]

    found = [_height(own, stiffness) - dense(stiffness) for stiffness in (0.3, 1.0, 5.0)]
    np.testing.assert_allclose(found, found[0], rtol=0, atol=1e-9)
    assert _height(own, np.inf) - _height(own, 1e6) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("flanks", ["AB", "BA"])
def test_steps_are_further_rows_of_least_squares(flanks):
    own = ("offset", "spline_1", "spline_2", "spline_3", "delay")
    log = replace(random_log(0, own, flanks), drift=Drift(knots_s=1.0, stiffness=7.0))
    free = replace(log, drift=Drift(knots_s=1.0))
    held = own_terms(summarise([log], TERMS), np.ones(1))
    plain = own_terms(summarise([free], TERMS), np.ones(1))
    penalty = np.zeros((3, len(plain.names)))
    penalty[:, [plain.names.index(name) for name in own[1:4]]] = 7.0 * steps(3)
    expected = np.linalg.lstsq(
        np.concatenate([plain.triangle[:, :-1], penalty]),
        np.concatenate([plain.triangle[:, -1], np.zeros(3)]),
        rcond=None,
    )[0]
    for place, name in enumerate(plain.names):
        assert held.estimate(name, held.names)[0] == pytest.approx(expected[place], rel=1e-6)
        if name != "delay":
            assert plain.estimate(name, plain.names)[0] != pytest.approx(expected[place], rel=1e-3)


@pytest.mark.parametrize("coefficients", [[], [0.8], [1.6, -0.9]])
def test_the_step_of_the_level_is_that_of_the_added_information(coefficients):
    """The held rows add the inverse covariance of the spline; its level is (1, 4, 1)/6 of three."""
    own = ("offset", *(f"spline_{k}" for k in range(1, 6)))
    drift = Drift(knots_s=1.0, stiffness=7.0)
    log = replace(random_log(0, own, "AB"), drift=drift)
    noise = NoiseModel(np.array(coefficients), innovation_std=2 * ARCSEC, std=1.0, block_s=0.1)
    with_steps, without = (
        np.sum(
            [normal_matrix(flank, noise.filter) for flank in summarise([one], TERMS).flanks], axis=0
        )
        for one in (log, replace(log, drift=Drift(knots_s=1.0)))
    )
    places = [summarise([log], TERMS).columns.index(name) for name in own[1:]]
    added = (with_steps - without)[np.ix_(places, places)]
    spline = np.linalg.inv(added) * noise.innovation_std**2
    # The level at the third knot less that at the second.
    change = (np.array([0, 0, 1, 4, 1]) - np.array([0, 1, 4, 1, 0])) / 6
    linear = SimpleNamespace(model=SimpleNamespace(drift=drift))
    solved = Mock(spec=SolvedFit, noise=noise, linear=linear)
    expected = np.sqrt(change @ spline @ change) / ARCSEC
    assert Walk(solved, 1.0).step_arcsec == pytest.approx(expected, rel=1e-6)
