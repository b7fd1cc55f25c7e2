import numpy as np
import pytest

from tests.logs.profiles import counts, drive, geared, played, spec, trapezoid
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


def _wide_gap(first_deg: float = 0.0) -> EncoderLog:
    """A tendon of 1:1 that crosses 30° after each reversal; friction holds it at first."""
    time = np.arange(6000) / 500
    driving = 60 * np.sin(time)
    driven = played(driving - first_deg, 30.0 + first_deg)
    return EncoderLog.from_arrays(time, driving, driven, pair=drive("1/1"), unit="deg")


@pytest.mark.parametrize("first_deg", [0.0, 2.0])
def test_a_standstill_behind_every_reversal_is_a_gap(first_deg):
    assert len(_wide_gap(first_deg)) == 6000


def test_a_standstill_from_a_reversal_to_the_end_is_none():
    log = _wide_gap()
    turn = int(np.argmax(np.degrees(log.driving_angle[:1000])))
    driven = np.degrees(log.driven_angle)[:1200]
    driven[turn:] = driven[turn]
    driving, time = np.degrees(log.driving_angle)[:1200], log.time[:1200]
    with pytest.raises(LogError, match="the driven channel stands still"):
        EncoderLog.from_arrays(time, driving, driven, pair=drive("1/1"), unit="deg")


def test_a_driving_shaft_that_stands_still_behind_a_reversal_is_stuck():
    log = _wide_gap()
    driving, driven = np.degrees(log.driven_angle), np.degrees(log.driving_angle)
    with pytest.raises(LogError, match="the driving channel stands still"):
        EncoderLog.from_arrays(log.time, driving, driven, pair=drive("1/1"), unit="deg")


def test_saturated():
    with pytest.raises(LogError, match="the driven channel stands still"):
        log(second=np.minimum(SECOND, 120_000))
    assert len(log(second=np.minimum(SECOND, SECOND.max() - 500))) == len(TIME)


def test_a_wrong_ratio_is_no_standstill():
    assert len(log(second=SECOND // 60)) == len(TIME)
    worm = EncoderLog.from_arrays(TIME, ANGLE, ANGLE / 225, pair=drive("1/225"), unit="deg")
    assert len(worm) == len(TIME)


def test_a_coarse_encoder_is_no_standstill():
    pair = spec(driven_encoder={"counts_per_rev": 36})
    assert len(log(second=SECOND // 2500, pair=pair)) == len(TIME)
