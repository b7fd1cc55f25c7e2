"""Turns found again from single-turn readings, and their probabilities against plain integrals."""

import dataclasses
import math
from fractions import Fraction
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import softmax

from vttig_jax.base.errors import NoAnswerError
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.kinematics.harmonic import OrderModel
from vttig_jax.kinematics.turn_location import locate, turn_log_likelihood, turn_remainders
from vttig_jax.rig.paper import paper_pair, paper_rig

PAPER = paper_pair().ratio
STD = 10 * ARCSEC


@pytest.fixture(scope="module")
def model():
    return paper_rig(1).flank_model()


@jax.jit
def both_flanks(model, driving):
    """Transmission errors of both flanks."""
    return tuple(model.transmission_error(driving, flank) for flank in ("A", "B"))


def readings(model, ratio: Fraction, driving: float, share: float) -> tuple[float, float]:
    """Both shafts within a turn, the driven one at a share of the way from flank A to B."""
    lower, upper = map(float, both_flanks(model, driving))
    driven = float(ratio) * driving + lower + share * (upper - lower)
    return driving % REV, driven % REV


@given(
    turn=st.integers(0, 15),
    within=st.floats(0, REV, exclude_max=True),
    share=st.floats(0, 1),
    noise=st.floats(-4 * STD, 4 * STD),
    windings=st.tuples(st.integers(-3, 3), st.integers(-3, 3)),
)
def test_every_turn_of_the_paper_is_found(model, turn, within, share, noise, windings):
    driving = within + REV * turn
    first, second = readings(model, PAPER, driving, share)
    first, second = first + REV * windings[0], second + noise + REV * windings[1]
    found = locate(first, second, PAPER, model, std_rad=STD)
    assert found.turn == int(driving // REV)
    assert found.driving_rad == pytest.approx(driving, abs=1e-9)
    assert found.probability > 1 - 1e-12
    assert found.probability + found.runner_up_probability <= 1 + 1e-12
    assert found.fits and found.misfit_rad <= abs(noise) + 1e-12
    assert found.hunting_turns == 16 and found.probabilities.sum() == pytest.approx(1.0)


def test_an_encoder_mounted_at_any_angle_changes_nothing(model):
    mounted = OrderModel(
        ratio=model.ratio,
        terms=((1, 0), (0, 1)),
        offset=jnp.array([2.1, 2.1 + 0.04 * DEG]) + 40 * REV,
        cosine=jnp.full((2, 2), 2e-4),
        sine=jnp.full((2, 2), 1e-4),
    )
    for turn in range(16):
        first, second = readings(mounted, PAPER, 1.0 + REV * turn, 0.3)
        assert locate(first, second, PAPER, mounted, std_rad=STD).turn == turn


def test_the_constant_gap_alone_is_enough_where_turns_lie_far_apart():
    gap = 0.0, 0.038 * DEG
    for turn in range(16):
        driving = 4.0 + REV * turn
        second = float(PAPER) * driving + 0.07 * DEG
        found = locate(4.0, second, PAPER, gap, std_rad=0.02 * DEG)
        assert (found.turn, found.fits) == (turn, True)


def test_readings_of_no_turn_are_told_though_one_turn_is_the_nearest(model):
    first, second = readings(model, PAPER, 20.0, 0.5)
    found = locate(first, second + 1 * DEG, PAPER, model, std_rad=STD)
    assert found.probability > 0.999
    assert not found.fits and "fit no turn" in str(found)
    right = locate(first, second, PAPER, model, std_rad=STD)
    assert "fit no turn" not in str(right) and "within the gap" in str(right)
    assert "turn           3 of 0 … 15" in str(right)
    for misfit, fits in ((6.0, True), (6.0 + 1e-12, False)):  # six standard deviations
        assert dataclasses.replace(right, misfit_rad=misfit, std_rad=1.0).fits is fits
    alone = locate(1.0, 2.0, Fraction(2, 1), (0.0, 1e-3), std_rad=1e-4)
    assert (alone.turn, alone.probability, alone.runner_up) == (0, 1.0, None)
    assert "runner-up" not in str(alone)


def test_the_flank_that_carries_decides_between_turns():
    # Three turns 120° apart, of which the gap spans nearly all.
    ratio, gap, driven = Fraction(1, 3), (0.0, 110 * DEG), 117 * DEG
    open_ = locate(0.0, driven, ratio, gap, std_rad=5 * DEG)
    assert (open_.turn, open_.runner_up) == (1, 0)
    assert 0.6 < open_.probability < 0.95
    carrying = [locate(0.0, driven, ratio, gap, std_rad=5 * DEG, flank=f) for f in ("A", "B")]
    assert [(one.turn, one.probability > 0.999) for one in carrying] == [(1, True), (0, True)]
    assert [one.misfit_rad for one in carrying] == pytest.approx([3 * DEG, 7 * DEG])


def exact_log_likelihood(x: float, lower: float, upper: float, std: float) -> float:
    """ln of the mean of a Gaussian over the gap, with 60 digits."""
    with mpmath.workdps(60):
        low, high = sorted((mpmath.mpf(lower), mpmath.mpf(upper)))
        if low == high:
            return float(mpmath.log(mpmath.npdf(x, low, std)))
        # Of both tails the small one, which cancels no digits.
        scale = std * mpmath.sqrt(2) * (1 if x > (low + high) / 2 else -1)
        tails = [mpmath.erfc((x - end) / scale) / 2 for end in (low, high)]
        return float(mpmath.log(abs(tails[0] - tails[1]) / (high - low)))


def test_likelihood_is_the_gaussian_averaged_over_the_gap():
    std, places = 0.7, (-40.0, -3.0, -0.1, 0.0, 0.31, 0.9, 1.0, 4.0, 35.0)
    x, width = np.array([*product(places, (0.0, 1e-9, 1e-6, 1e-3, 0.5, 20.0, -0.5))]).T
    expected = [exact_log_likelihood(at, 0.0, gap, std) for at, gap in zip(x, width, strict=True)]
    found = turn_log_likelihood(x, np.zeros(len(x)), width, std)
    np.testing.assert_allclose(found, expected, rtol=1e-7)


def drawn(std: float, count: int = 4000):
    """Readings of random turns of a long hunting period, and the turns."""
    rng = np.random.default_rng(3)
    turns, ratio = 180, 7 / 180
    turn = rng.integers(0, turns, count)
    within = rng.uniform(0, REV, count)
    gap = 1.5 * DEG
    driven = ratio * (within + REV * turn) + rng.uniform(0, gap, count)
    driven += std * rng.standard_normal(count)
    return within, driven, turn, np.zeros(turns), np.full(turns, gap), ratio


def stated_and_true(reckoned: float, std: float) -> tuple[float, float, float]:
    """Mean of the stated probability, share of right turns, and its standard error."""
    within, driven, turn, lower, upper, ratio = drawn(std)
    remainder = turn_remainders(within, driven, lower, upper, ratio)
    chance = softmax(turn_log_likelihood(remainder, lower, upper, reckoned), axis=-1)
    best = chance.argmax(axis=1)
    right = (best == turn).mean()
    return chance.max(axis=1).mean(), right, math.sqrt(right * (1 - right) / len(turn))


@pytest.mark.parametrize("std_deg", [0.3, 1.0, 3.0])
def test_probabilities_hold_where_turns_are_hard_to_tell(std_deg):
    stated, right, error = stated_and_true(std_deg * DEG, std_deg * DEG)
    assert abs(stated - right) < 4 * error
    assert 0.2 < right < 0.995
    if std_deg == 1.0:  # those of a wrong noise do not hold
        stated, right, error = stated_and_true(0.1 * DEG, 1.0 * DEG)
        assert stated - right > 10 * error


def test_impossible_arguments_are_refused():
    def at(driving=0.0, driven=0.0, error=(0.0, 1e-3), std_rad=1e-3):
        return locate(driving, driven, PAPER, error, std_rad=std_rad)

    at()
    cases: list[tuple[dict[str, Any], str]] = [
        ({"driving": math.nan}, "must be finite"),
        ({"driven": math.inf}, "must be finite"),
        ({"std_rad": 0.0}, "`std_rad` must be positive"),
        ({"std_rad": math.nan}, "`std_rad` must be positive"),
        ({"error": (0.0, math.nan)}, "must be known on both flanks"),
    ]
    for changed, words in cases:
        with pytest.raises(ValueError, match=words):
            at(**changed)
    with pytest.raises(NoAnswerError, match='such as "7/1798"'):
        locate(0.0, 0.0, Fraction("0.003893214683"), (0.0, 1e-3), std_rad=1e-3)
