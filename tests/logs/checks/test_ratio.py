from fractions import Fraction

import numpy as np
import pytest

from tests.logs.profiles import counts, drive, geared, spec, trapezoid
from vttig_jax.base.errors import LogError
from vttig_jax.logs.checks.ratio import (
    APART,
    DEVIATIONS,
    SHIFT_TURNS,
    check_ratio,
    seen_ratio,
)
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.slope import better_fraction, slope
from vttig_jax.pair.pair_file import parse_pair_spec

TIME, ANGLE, _ = trapezoid(rate=400.0, reversal=1800.0)
WHEEL, _ = geared(ANGLE, noise=0.001)


def log(driving=ANGLE, driven=WHEEL, pair=None):
    return EncoderLog.from_arrays(TIME, counts(driving), counts(driven), pair=pair or spec())


def test_right_ratio():
    ratio = check_ratio(log())
    assert ratio.verdict == "agrees" and ratio.given == spec().ratio
    assert ratio.seen is not None and ratio.std is not None
    assert abs(ratio.seen - 0.5625) < 4 * ratio.std
    assert ratio.seen == pytest.approx(0.5625, rel=1e-4)
    assert "as given" in ratio.sentence and "9/16 = 0.5625 given" in ratio.short


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


def test_half_a_percent_is_never_doubted():
    assert seen_ratio(log(driven=WHEEL * 1.0045)).verdict == "agrees"
    assert seen_ratio(log(driven=WHEEL * 1.0055)).verdict == "differs"


@pytest.mark.parametrize("turns", [0.5, 1.0, 1.5, 2.5])
@pytest.mark.parametrize("order", [1.0, 0.5625])
def test_an_eccentricity_over_few_turns_is_no_wrong_ratio(turns, order):
    """A huge eccentricity puts the slope off by per cents; a wrong tooth count is still seen."""
    time = np.arange(400) / 100.0
    angle = np.linspace(0, 2 * np.pi * turns, 400)
    off = []
    for phase in np.linspace(0, 2 * np.pi, 8):
        driven = 0.5625 * angle + 0.015 * np.sin(order * angle + phase)
        made = EncoderLog.from_arrays(time, angle, driven, pair=spec(), unit="rad")
        ratio = seen_ratio(made)
        assert ratio.verdict == "agrees" and ratio.seen is not None
        off.append(abs(ratio.seen / 0.5625 - 1))
        teeth = spec(driven_teeth=60)
        wrong = EncoderLog.from_arrays(time, angle, driven, pair=teeth, unit="rad")
        assert seen_ratio(wrong).verdict == "differs"
    assert max(off) > 0.005 or turns > 1


@pytest.mark.parametrize(
    ("turns", "off", "verdict"),
    [(1.7, 1.008, "agrees"), (1.7, 1.011, "differs"), (20.0, 1.008, "differs")],
)
def test_a_ratio_that_is_fitted_on_few_turns_is_refused_later(turns, off, verdict):
    """Over 1.7 driven turns 0.8 % turn the driven order by 5°, over 20 turns by 58°."""
    angle = np.linspace(0, 2 * np.pi * turns / 0.5625, 4000)
    driven = 0.5625 * off * angle + 1e-6 * np.sin(40.3 * angle)
    made = EncoderLog.from_arrays(angle, angle, driven, pair=spec(), unit="rad")
    assert seen_ratio(made).verdict == verdict


def test_the_tolerance_begins_where_the_slope_is_uncertain():
    """A first order that does not average out moves the slope beyond the tolerance alone."""
    angle = np.linspace(0, 2 * np.pi * 1.7 / 0.5625, 4000)
    beyond = []
    for phase in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        driven = 0.5625 * 1.0085 * angle + 0.008 * np.sin(0.5625 * angle + phase)
        made = EncoderLog.from_arrays(angle, angle, driven, pair=spec(), unit="rad")
        ratio = seen_ratio(made)
        assert ratio.verdict == "agrees" and ratio.seen and ratio.std
        off = abs(ratio.seen / 0.5625 - 1)
        beyond.append(off > SHIFT_TURNS / 1.7 and off > DEVIATIONS * ratio.std / 0.5625)
        wrong = EncoderLog.from_arrays(angle, angle, 1.03 * driven, pair=spec(), unit="rad")
        assert seen_ratio(wrong).verdict == "differs"
    assert any(beyond)


def test_standard_error_covers_independent_noise():
    draws = []
    for seed in range(40):
        noise = np.random.default_rng(seed).standard_normal(400)
        x = np.linspace(0, 200, 400)
        value, std = slope(x, 2 * x + 0.1 * noise)
        draws.append((value - 2) / std)
    assert np.abs(draws).max() < 4.5 and np.std(draws) > 0.05


def test_curve_has_no_ratio():
    curve = EncoderLog.from_arrays(
        TIME, ANGLE, pair=drive("9/16"), unit="deg", transmission_error=WHEEL
    )
    ratio = check_ratio(curve)
    assert ratio.seen is None and ratio.verdict == "none" and "no ratio to check" in ratio.sentence


@pytest.mark.parametrize("turned", [False, True])
def test_a_gap_that_is_large_beside_the_travel_is_no_reason_to_refuse(turned):
    time = np.arange(2000) / 100.0
    driving = 400 * (1 - np.cos(0.314 * time))
    crossed = 0.5 - 0.5 * np.tanh(8 * np.sin(0.314 * time))  # the teeth cross the gap in 0.5 s
    pair = parse_pair_spec({"drive": {"ratio": "1/4000"}})
    log = EncoderLog.from_arrays(
        time, driving, driving / 4000 + 0.03 * crossed, pair=pair, unit="deg"
    )
    residual = log.driven_angle - slope(log.driving_angle, log.driven_angle)[0] * log.driving_angle
    assert np.std(residual) > APART * np.ptp(log.driven_angle)
    if not turned:
        check_ratio(log)
        return
    # The same scatter that does not follow the direction of motion is refused.
    stray = 0.03 * np.tanh(8 * np.sin(1.7 * time))
    apart = EncoderLog.from_arrays(time, driving, driving / 4000 + stray, pair=pair, unit="deg")
    with pytest.raises(LogError, match="do not turn together"):
        check_ratio(apart)


def test_channels_that_do_not_turn_together_are_refused():
    """Two shafts of different axes: no ratio is right, so none can be called wrong."""
    time = np.arange(2000) / 100.0
    driving, other = 400 * np.sin(0.9 * time), 30 * np.sin(1.7 * time + 1.0)
    pair = parse_pair_spec({"drive": {"ratio": "1/10"}})
    apart = EncoderLog.from_arrays(time, driving, other, pair=pair, unit="deg")
    with pytest.raises(LogError, match="do not turn together"):
        check_ratio(apart)
    together = EncoderLog.from_arrays(
        time, driving, driving / 10 + 0.3 * np.sin(0.1 * driving), pair=pair, unit="deg"
    )
    assert check_ratio(together).verdict == "agrees"


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
def test_a_fraction_is_named_that_fits_better(given, seen, std, better):
    found = better_fraction(Fraction(given), seen, std)
    assert found == (None if better is None else Fraction(better))


def test_the_better_fraction_is_said():
    pair = drive("0.3594")
    found = check_ratio(EncoderLog.from_arrays(TIME, ANGLE, 23 / 64 * ANGLE, pair=pair, unit="deg"))
    assert found.verdict == "agrees" and found.better == Fraction(23, 64)
    assert "23/64 fits, so write that" in found.sentence


def test_a_rounded_inverse_is_answered_with_the_fraction_of_the_log():
    """16/9 given as 1.7778 for a log of 9/16: the inverse of 1.7778 would be a wrong ratio."""
    pair = parse_pair_spec({"drive": {"ratio": "1.7778"}})
    made = EncoderLog.from_arrays(TIME, ANGLE, WHEEL, pair=pair, unit="deg")
    ratio = seen_ratio(made)
    assert ratio.verdict == "swapped" and "--ratio 16:9 (in the pair file 9/16)" in ratio.sentence
    teeth = parse_pair_spec({"drive": {"ratio": "16/9"}})
    exact = EncoderLog.from_arrays(TIME, ANGLE, WHEEL, pair=teeth, unit="deg")
    assert "--ratio 16:9 (in the pair file 9/16)" in seen_ratio(exact).sentence
