from fractions import Fraction

import numpy as np
import pytest

from tests.logs.profiles import drive, geared, of_counts, spec, trapezoid
from vttig_jax.base.errors import LogError
from vttig_jax.logs.checks.ratio import APART, DEVIATIONS, SHIFT_TURNS, check_ratio, seen_ratio
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.slope import better_fraction, slope

TIME, ANGLE, _ = trapezoid(rate=400.0, reversal=1800.0)
WHEEL, _ = geared(ANGLE, noise=0.001)


def log(driving=ANGLE, driven=WHEEL, pair=None):
    return of_counts(TIME, driving, driven, pair)


def of_angles(driving, driven, ratio="9/16", unit="rad", time=None):
    time = np.arange(len(driving)) / 100.0 if time is None else time
    return EncoderLog.from_arrays(time, driving, driven, pair=drive(ratio), unit=unit)


def test_a_right_ratio_and_half_a_percent_are_never_doubted():
    ratio = check_ratio(log())
    assert ratio.verdict == "agrees" and ratio.given == spec().ratio
    assert ratio.seen is not None and ratio.std is not None
    assert abs(ratio.seen - 0.5625) < 4 * ratio.std
    assert ratio.seen == pytest.approx(0.5625, rel=1e-4)
    assert "as given" in ratio.sentence and "9/16 = 0.5625 given" in ratio.short
    for factor, verdict in ((1.0045, "agrees"), (1.0055, "differs")):
        assert seen_ratio(log(driven=WHEEL * factor)).verdict == verdict


@pytest.mark.parametrize(
    ("made", "verdict", "cure"),
    [
        (lambda: log(pair=spec(driven_teeth=81)), "differs", "correct the teeth"),
        (lambda: log(driving=0.5625 * ANGLE), "differs", 'driving_scale = "16/9" under [log]'),
        (lambda: log(driven=-WHEEL), "sign", "`sign = -1`"),
        (lambda: log(driving=WHEEL, driven=ANGLE), "swapped", "--column driving=NAME"),
        (lambda: log(driving=WHEEL, driven=-ANGLE), "swapped_sign", "exchange them"),
    ],
)
def test_contradictions(made, verdict, cure):
    ratio = seen_ratio(made())
    assert ratio.verdict == verdict
    with pytest.raises(LogError) as caught:
        check_ratio(made())
    assert cure in caught.value.message and "arrays" in caught.value.where
    assert f"{ratio.seen:.6g}" in caught.value.message


@pytest.mark.parametrize("turns", [0.5, 1.0, 1.5, 2.5])
@pytest.mark.parametrize("order", [1.0, 0.5625])
def test_an_eccentricity_over_few_turns_is_no_wrong_ratio(turns, order):
    """A huge eccentricity puts the slope off by per cents; a wrong tooth count is still seen."""
    angle = np.linspace(0, 2 * np.pi * turns, 400)
    off = []
    for phase in np.linspace(0, 2 * np.pi, 8):
        driven = 0.5625 * angle + 0.015 * np.sin(order * angle + phase)
        ratio = seen_ratio(of_angles(angle, driven))
        assert ratio.verdict == "agrees" and ratio.seen is not None
        off.append(abs(ratio.seen / 0.5625 - 1))
        assert seen_ratio(of_angles(angle, driven, "45/60")).verdict == "differs"
    assert max(off) > 0.005 or turns > 1


@pytest.mark.parametrize(
    ("turns", "off", "verdict"),
    [(1.7, 1.008, "agrees"), (1.7, 1.011, "differs"), (20.0, 1.008, "differs")],
)
def test_a_ratio_that_is_fitted_on_few_turns_is_refused_later(turns, off, verdict):
    """Over 1.7 driven turns 0.8 % turn the driven order by 5°, over 20 turns by 58°."""
    angle = np.linspace(0, 2 * np.pi * turns / 0.5625, 4000)
    driven = 0.5625 * off * angle + 1e-6 * np.sin(40.3 * angle)
    assert seen_ratio(of_angles(angle, driven, time=angle)).verdict == verdict


def test_the_tolerance_begins_where_the_slope_is_uncertain():
    """A first order that does not average out moves the slope beyond the tolerance alone."""
    angle = np.linspace(0, 2 * np.pi * 1.7 / 0.5625, 4000)
    beyond = []
    for phase in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        driven = 0.5625 * 1.0085 * angle + 0.008 * np.sin(0.5625 * angle + phase)
        ratio = seen_ratio(of_angles(angle, driven, time=angle))
        assert ratio.verdict == "agrees" and ratio.seen and ratio.std
        off = abs(ratio.seen / 0.5625 - 1)
        beyond.append(off > SHIFT_TURNS / 1.7 and off > DEVIATIONS * ratio.std / 0.5625)
        assert seen_ratio(of_angles(angle, 1.03 * driven, time=angle)).verdict == "differs"
    assert any(beyond)


def test_standard_error_covers_independent_noise():
    draws = []
    for seed in range(40):
        noise = np.random.default_rng(seed).standard_normal(400)
        x = np.linspace(0, 200, 400)
        value, std = slope(x, 2 * x + 0.1 * noise)
        draws.append((value - 2) / std)
    assert np.abs(draws).max() < 4.5 and np.std(draws) > 0.05


LONG = np.arange(2000) / 100.0
ROCKED, WAVE = 400 * (1 - np.cos(0.314 * LONG)), 400 * np.sin(0.9 * LONG)
CROSSED = 0.5 - 0.5 * np.tanh(8 * np.sin(0.314 * LONG))  # the teeth cross the gap in 0.5 s


@pytest.mark.parametrize(
    ("driving", "driven", "ratio", "together"),
    [
        (ROCKED, ROCKED / 4000 + 0.03 * CROSSED, "1/4000", True),
        # The same scatter that does not follow the direction of motion.
        (ROCKED, ROCKED / 4000 + 0.03 * np.tanh(8 * np.sin(1.7 * LONG)), "1/4000", False),
        (WAVE, WAVE / 10 + 0.3 * np.sin(0.1 * WAVE), "1/10", True),
        # Two shafts of different axes: no ratio is right, so none can be called wrong.
        (WAVE, 30 * np.sin(1.7 * LONG + 1.0), "1/10", False),
    ],
)
def test_channels_that_do_not_turn_together_are_refused(driving, driven, ratio, together):
    """A gap that is large beside the travel is no reason to refuse."""
    made = of_angles(driving, driven, ratio, "deg")
    if ratio == "1/4000" and together:
        residual = made.driven_angle - slope(made.driving_angle, made.driven_angle)[0] * (
            made.driving_angle
        )
        assert np.std(residual) > APART * np.ptp(made.driven_angle)
    if together:
        assert check_ratio(made).verdict == "agrees"
        return
    with pytest.raises(LogError, match="do not turn together"):
        check_ratio(made)


@pytest.mark.parametrize(
    ("given", "seen", "std", "better"),
    [
        ("0.3594", 0.3593751, 2e-7, "23/64"),
        ("0.3594", 0.3593751, 1e-5, None),  # as given within five standard errors
        ("23/64", 0.3593751, 2e-7, None),
        ("0.3594", 0.35939, 1e-6, None),  # any number has a fraction of large numbers near it
        ("0.3594", 0.3593751, 0.0, None),
    ],
)
def test_a_fraction_is_named_and_said_that_fits_better(given, seen, std, better):
    found = better_fraction(Fraction(given), seen, std)
    assert found == (None if better is None else Fraction(better))
    said = check_ratio(of_angles(ANGLE, 23 / 64 * ANGLE, "0.3594", "deg", TIME))
    assert said.verdict == "agrees" and said.better == Fraction(23, 64)
    assert "23/64 fits, so write that" in said.sentence


@pytest.mark.parametrize("given", ["1.7778", "16/9"])
def test_an_inverse_is_answered_with_the_fraction_of_the_log(given):
    """16/9 given as 1.7778 for a log of 9/16: the inverse of 1.7778 would be a wrong ratio."""
    ratio = seen_ratio(of_angles(ANGLE, WHEEL, given, "deg", TIME))
    assert ratio.verdict == "swapped" and "--ratio 16:9 (in the pair file 9/16)" in ratio.sentence
