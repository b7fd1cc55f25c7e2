"""Coverage of the intervals of a fit on rigs like its own."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from scipy.stats import binom

import vttig_jax
from tests.posterior.made import quick_fit
from tests.schemas import load_schema
from vttig_jax.base.files.json_io import dumps
from vttig_jax.identify import read_fit
from vttig_jax.posterior import calibrate, coverage
from vttig_jax.posterior.calibration import calibrate as room
from vttig_jax.rig import PassMotion, paper_rig

GEARS = ("driving_eccentricity_mm", "driven_encoder_arcsec", "constant_backlash_deg")
MOTION = PassMotion(speed_rpm=240.0, reversal_deg=3600.0, ramp_s=0.2)


@pytest.fixture(scope="module")
def fit():
    rig = paper_rig(motion=MOTION)
    return vttig_jax.fit(rig.log(0), rig.pair, lines="report")


@pytest.fixture(scope="module")
def found(fit):
    return calibrate(fit, rigs=80)


@pytest.mark.slow
def test_intervals_hold_the_truth_of_rigs_like_the_own_one(found):
    assert found.is_calibrated and found.failed == ()  # by bounds for all names together
    assert set(GEARS) < set(found.parameters)
    for name, one in found.parameters.items():
        if one.told > 0.9:
            assert 0.5 < one.rms < 1.3, name
    shares = [one.coverage.share for one in found.parameters.values()]
    assert 0.93 < np.mean(shares) < 0.99
    record = json.loads(dumps(found.to_json()))
    jsonschema.validate(record, load_schema("vttig.calibrate/2"))
    assert record["parameters"][GEARS[0]]["share"] == found.parameters[GEARS[0]].coverage.share
    assert GEARS[0] in str(found) and "calibrated: yes" in str(found)


@pytest.mark.slow
def test_intervals_that_are_too_narrow_are_seen(fit, monkeypatch):
    """Intervals of 0.6 times their width hold the truth in three of four rigs."""
    honest = room.told_by

    def narrower(one):
        if one.value is None or one.upper95 is not None:
            return one
        low, high = (one.value + 0.6 * (bound - one.value) for bound in (one.low95, one.high95))
        return replace(one, low95=low, high95=high)

    def narrow(*arguments):
        told, parameters = honest(*arguments)
        return told, {name: narrower(one) for name, one in parameters.items()}

    monkeypatch.setattr(room, "told_by", narrow)
    found = calibrate(fit, rigs=80)
    assert not found.is_calibrated and set(found.failed) & set(GEARS)
    assert f"NO; too narrow: {found.failed[0]}" in str(found)


@pytest.mark.slow
def test_the_seed_decides_the_rigs(fit, found):
    some, again, other = (calibrate(fit, rigs=10, seed=seed) for seed in (1, 1, 2))
    name = "driving_eccentricity_mm"
    assert again.parameters[name] == some.parameters[name]
    assert other.parameters[name].rms != some.parameters[name].rms
    assert found.parameters[name].std == pytest.approx(fit.parameters[name].std, rel=0.15)


def test_bounds_are_binomial():
    """At a bound, so many hits or more extreme have a probability of 2.5 %."""
    for hits, rigs in ((0, 10), (10, 10), (95, 100), (7, 9)):
        one = coverage(hits, rigs)
        assert one.low <= one.share <= one.high
        if hits:
            assert binom.sf(hits - 1, rigs, one.low) == pytest.approx(0.025)
        if hits < rigs:
            assert binom.cdf(hits, rigs, one.high) == pytest.approx(0.025)


def test_wrong_arguments_are_named(tmp_path):
    fit = quick_fit()
    with pytest.raises(ValueError, match="`rigs`"):
        calibrate(fit, rigs=0)
    fit.save(tmp_path / "run", figures=False)
    with pytest.raises(ValueError, match="keeps no rows"):
        calibrate(read_fit(tmp_path / "run", fit.pair))
