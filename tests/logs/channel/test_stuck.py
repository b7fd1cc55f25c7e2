import numpy as np
import pytest

from tests.logs.profiles import counts, drive, geared, of_degrees, played, spec, trapezoid
from vttig_jax.base.errors import LogError
from vttig_jax.logs.encoder_log import EncoderLog

TIME, ANGLE, _ = trapezoid(rate=500.0, reversal=1440.0, dwell=0.3)
FIRST, SECOND = counts(ANGLE), counts(geared(ANGLE, gap=1.0, noise=0.001)[0])


def log(first=FIRST, second=SECOND, pair=None):
    return EncoderLog.from_arrays(TIME, first, second, pair=pair or spec())


def test_a_wide_gap_is_no_standstill():
    assert log().notes == ()


@pytest.mark.parametrize("dither", [0, 1])
def test_stuck(dither):
    noise = np.random.default_rng(0).integers(0, dither + 1, 400)
    for role in ("driving", "driven"):
        first, second = FIRST.copy(), SECOND.copy()
        own = first if role == "driving" else second
        own[900:1300] = own[900] + noise
        own[1300:] += own[900] - own[1300]  # it goes on from there, without a step
        with pytest.raises(LogError) as caught:
            log(first, second)
        text = str(caught.value)
        assert f"the {role} channel stands still from 1." in text, text
        assert "to 2." in text and "cut these lines out" in text and "sample" in text
        start = int(str(caught.value.where).split("sample ")[1].split(",")[0])
        assert abs(start - 900) <= 5


def tendon(first_deg=0.0):
    """Time, and angles of a tendon of 1:1 that crosses 30° after each reversal.

    Friction holds it for the first degrees.
    """
    time = np.arange(6000) / 500
    driving = 60 * np.sin(time)
    return time, driving, played(driving - first_deg, 30.0 + first_deg)


def test_a_standstill_behind_every_reversal_is_a_gap_and_others_are_none():
    pair = drive("1/1")
    for first_deg in (0.0, 2.0):
        assert len(of_degrees(*tendon(first_deg), pair)) == 6000
    time, driving, driven = tendon()
    with pytest.raises(LogError, match="the driving channel stands still"):
        of_degrees(time, driven, driving, pair)
    turn = int(np.argmax(driving[:1000]))
    driven[turn:] = driven[turn]
    with pytest.raises(LogError, match="the driven channel stands still"):
        of_degrees(time[:1200], driving[:1200], driven[:1200], pair)


def test_saturated():
    with pytest.raises(LogError, match="the driven channel stands still"):
        log(second=np.minimum(SECOND, 120_000))
    assert len(log(second=np.minimum(SECOND, SECOND.max() - 500))) == len(TIME)


def test_a_wrong_ratio_and_a_coarse_encoder_are_no_standstill():
    coarse = spec(driven_encoder={"counts_per_rev": 36})
    assert len(log(second=SECOND // 60)) == len(log(second=SECOND // 2500, pair=coarse))
    assert len(of_degrees(TIME, ANGLE, ANGLE / 225, drive("1/225"))) == len(TIME)
