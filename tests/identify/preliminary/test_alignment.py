"""Logs that start anywhere: found start angles, and a joint fit as good as with a common zero."""

from dataclasses import replace

import numpy as np
import pytest

from vttig_jax.base.errors import LogError, NoAnswerError
from vttig_jax.base.units import DEG
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.eccentricities import Eccentricities
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

MOTION = PassMotion(speed_rpm=120.0, reversal_deg=2160.0, dwell_s=0.3, ramp_s=0.3)
CUT = 700


@pytest.fixture(scope="module")
def rig() -> SyntheticRig:
    return replace(paper_rig(0, MOTION), rate_hz=997.0)


@pytest.fixture(scope="module")
def logs(rig) -> tuple[EncoderLog, EncoderLog]:
    """Two runs, and the second one once more without its first 700 samples."""
    return rig.log(0), rig.log(1)


def _late(log: EncoderLog, rig: SyntheticRig) -> EncoderLog:
    assert log.driven is not None
    part = slice(CUT, None)
    return EncoderLog.from_arrays(
        log.time[part],
        log.driving.reading[part],
        log.driven.reading[part],
        pair=rig.pair,
        source="late",
    )


def _one_way(log: EncoderLog, rig: SyntheticRig, ahead: bool) -> EncoderLog:
    """The log from its 700th sample to its farthest angle, or from there to its end."""
    assert log.driven is not None
    turn = int(np.argmax(log.driving_angle))
    part = slice(CUT, turn) if ahead else slice(turn, None)
    readings = (log.driving.reading[part], log.driven.reading[part])
    return EncoderLog.from_arrays(log.time[part], *readings, pair=rig.pair, source="one way")


def test_start_angles_are_found(rig, logs):
    first, second = logs
    result = fit([first, _late(second, rig)], rig.pair, delay="off")
    start = result.logs[1].start
    for value_deg, std_deg, angle in (
        (start.driving_deg, start.driving_std_deg, second.driving_angle),
        (start.driven_deg, start.driven_std_deg, second.driven_angle),
    ):
        assert value_deg is not None and std_deg is not None
        off = (value_deg - angle[CUT] / DEG + 180.0) % 360.0 - 180.0
        assert abs(off) < 4 * std_deg
        assert 0 < std_deg < 2.0
    assert result.logs[0].start.driving_std_deg == 0.0


def test_logs_without_a_common_flank_are_refused(rig, logs):
    """One forward and one backward log, which count from places of their own."""
    ways = [_one_way(log, rig, ahead) for log, ahead in zip(logs, (True, False), strict=True)]
    with pytest.raises(NoAnswerError, match="log 2 has enough samples on flank B and log 1 on"):
        fit(ways, rig.pair, delay="off")
    assert set(fit(ways, rig.pair, delay="off", same_zero=True).flanks) == {"A", "B"}


@pytest.mark.parametrize("whole", [0, 1])
def test_one_of_the_logs_may_move_in_one_direction(rig, logs, whole):
    pair = [log if place == whole else _one_way(log, rig, True) for place, log in enumerate(logs)]
    start = fit(pair, rig.pair, delay="off").logs[1].start
    turned = (-1 if whole else 1) * logs[1 - whole].driving_angle[CUT] / DEG
    assert start.driving_deg is not None and start.driving_std_deg is not None
    off = (start.driving_deg - turned + 180.0) % 360.0 - 180.0
    assert abs(off) < 4 * start.driving_std_deg < 8.0


def test_a_wrong_common_zero_is_refused(rig, logs):
    first, second = logs
    with pytest.raises(LogError, match="same zero"):
        fit([first, _late(second, rig)], rig.pair, same_zero=True, delay="off")


def test_two_logs_know_more_than_one(rig, logs):
    alone = fit(logs[0], rig.pair, delay="off")
    common = fit(list(logs), rig.pair, same_zero=True, delay="off")
    own = fit(list(logs), rig.pair, delay="off")
    name = "constant_backlash_deg"
    for both in (common, own):
        ratio = _std(both, name) / _std(alone, name)
        assert ratio == pytest.approx(2**-0.5, rel=0.15)
        truth = float(rig.eccentricities.constant_backlash_deg)
        assert abs(both.value(name) - truth) < 4 * _std(both, name)
    assert np.isclose(own.value(name), common.value(name), atol=_std(common, name))
    assert "driving_start_of_2" in own.covariance_names
    assert "driving_start_of_2" not in common.covariance_names


def test_logs_of_one_rig_share_their_eccentricities_whatever_their_length(rig, logs):
    assert logs[1].driven is not None
    part = slice(0, 2500)
    short = EncoderLog.from_arrays(
        logs[1].time[part],
        logs[1].driving.reading[part],
        logs[1].driven.reading[part],
        pair=rig.pair,
    )
    result = fit([logs[0], short], rig.pair, same_zero=True, delay="off")
    assert result.samples["read"] == len(logs[0]) + 2500
    assert [one.samples["read"] for one in result.logs] == [len(logs[0]), 2500]
    error = result.value("driving_eccentricity_mm") - 0.0226
    assert abs(error) < 4 * _std(result, "driving_eccentricity_mm")


@pytest.mark.parametrize("same_zero", [True, None])
def test_logs_of_two_rigs_are_refused(rig, logs, same_zero):
    other = replace(rig, eccentricities=Eccentricities(0.035, 10.0, 0.02, 200.0, 0.05))
    with pytest.raises(LogError, match=r"first order of .*″.*not logs of one rig"):
        fit([logs[0], other.log(3)], rig.pair, same_zero=same_zero, delay="off")


def test_agreement_is_reported(rig, logs):
    result = fit(list(logs), rig.pair, same_zero=True, delay="off")
    entries = result.checks.agreement
    assert {(e.shaft, e.flank) for e in entries} == {
        (shaft, flank) for shaft in ("driving", "driven") for flank in "AB"
    }
    for entry in entries:
        assert entry.difference_arcsec < 5 * entry.std_arcsec


def _std(result: Fit, name: str) -> float:
    std = result.parameters[name].std
    assert std is not None
    return std
