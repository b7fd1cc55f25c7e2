"""A ratio of the log that is not quite the given one is told with what explains it."""

from fractions import Fraction

import numpy as np
import pytest

from tests.logs.profiles import drive, of_degrees
from vttig_jax.logs.checks.ratio import SeenRatio, check_ratio, seen_ratio
from vttig_jax.logs.slope import likely_fraction, ratio_option

pytestmark = pytest.mark.smoke

TIME = np.arange(6000) / 100.0
STEADY = 360.0 * TIME
BOTH_WAYS = 9000.0 * np.sin(0.19 * TIME) + 1200.0 * np.sin(0.53 * TIME)


def log(given: str, true: float, driving=STEADY, *, delay_s=0.0, drift=0.0, seed=0):
    """A log with noise, first orders and the ratio `true`, read with the ratio `given`."""
    noise = 0.05 * np.random.default_rng(seed).standard_normal(len(TIME))
    angle = np.radians(driving)
    error = 0.2 * np.cos(angle + 1) + 0.1 * np.cos(true * angle)
    late = true * (driving - delay_s * np.gradient(driving, TIME))
    driven = late + error + noise + drift * TIME
    return of_degrees(TIME, driving, driven, drive(given))


@pytest.mark.parametrize("driving", [STEADY, BOTH_WAYS], ids=["steady", "both ways"])
@pytest.mark.parametrize(
    ("given", "true", "option"),
    [("1:6.01", 6.0, "1:6"), ("6.01:1", 1 / 6, "6:1"), ("5:3.01", 0.6, "5:3")],
)
def test_whole_turns_of_another_ratio_are_told_with_the_ratio_to_copy(driving, given, true, option):
    found = check_ratio(log(given, true, driving))
    assert found.is_doubtful and found.sentence.endswith(f"--ratio {option}.")
    assert "° of the driven shaft over this log, which biases gap" in found.sentence


@pytest.mark.parametrize(
    ("given", "true", "told"),
    [
        ("0.3594", 23 / 64, "23/64 fits, so write that if these are the teeth: --ratio 64:23"),
        ("1/7.3310", 1 / 7.33097, "may be"),
        ("1:6", 6 * (1 - 0.0037123), "a belt"),
        ("16:9", 0.5625 * (1 - 0.0021347), "a belt"),
    ],
)
def test_rounding_and_creep_are_told_and_not_refused(given, true, told):
    """A decimal stands for what rounds to it, and a belt that creeps has no ratio of teeth."""
    found = check_ratio(log(given, true, 20 * STEADY))
    assert found.verdict == "agrees" and found.is_doubtful
    assert "which biases gap, delay and orders" in found.sentence
    assert told in found.sentence or "is slightly wrong" in found.sentence
    if found.better is None:
        option = found.sentence.partition("--ratio ")[2].partition(",")[0]
        shown = [float(part) for part in option.split(":")]
        assert shown[1] / shown[0] == pytest.approx(true, rel=2e-5)
        assert not check_ratio(log(option, true, 20 * STEADY)).is_doubtful


@pytest.mark.parametrize("seed", range(3))
def test_a_delay_is_no_wrong_ratio(seed):
    """The speed grows, and so does the lateness: it has a slope over the angle."""
    driving = 40.0 * TIME + 9.0 * TIME**2 + 100 * np.sin(TIME)
    found = seen_ratio(log("1:1", 1.0, driving, delay_s=0.02, seed=seed))
    assert found.is_doubtful and found.cause == "delay"
    assert "A delay between the channels explains this better" in found.sentence
    assert "keep the ratio" in found.sentence and "wrong" not in found.sentence


@pytest.mark.parametrize(("cause", "word"), [("open", "slip or twist"), ("ratio", "lost counts")])
def test_teeth_of_whole_numbers_are_never_called_a_wrong_ratio(cause, word):
    for given in ("1", "9/16", "6"):
        one = drive(given).ratio
        found = SeenRatio(float(one) * 1.0002, float(one) * 2e-5, one, "agrees", cause, 100.0)
        assert found.is_doubtful and "slightly wrong" not in found.sentence
        assert f"Shafts coupled {one.denominator}:{one.numerator} by teeth keep" in found.sentence
        assert word in found.sentence


def test_a_fraction_must_be_likelier_than_any_other_number():
    rng = np.random.default_rng(1)
    found = [likely_fraction(0.1 + 0.8 * rng.random(), 1e-6) for _ in range(200)]
    assert sum(one is not None for one in found) < 0.15 * len(found)
    assert ratio_option(0.99984, 8e-5) == "1:1" and ratio_option(1 / 6, 1e-5) == "6:1"
    assert likely_fraction(0.5625001, 1e-5) == Fraction(9, 16)
    assert likely_fraction(0.5, 0.0) == Fraction(1, 2) and likely_fraction(2**0.5 / 3, 1e-9) is None
