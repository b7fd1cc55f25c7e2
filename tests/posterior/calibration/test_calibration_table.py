"""The vmapped fit is that of `identify`; and the small coverage table, 500 rigs a scenario.

About a minute of one core, half of it compilation, which both share: 1500 logs of 14 000 samples
are drawn and fitted, and fewer rigs could not tell 95 % from 90 %.
"""

import json
from dataclasses import replace

import jsonschema
import msgspec
import numpy as np
import pytest
from vttig_jax.identify.compress.block_rows import block_seconds, log_rows
from vttig_jax.identify.compress.harmonic_summary import summarise
from vttig_jax.identify.compress.regressors import Drift, read_channels
from vttig_jax.identify.noise.noise_model import NoiseModel, whiten
from vttig_jax.identify.solve.least_squares import Solution, solve
from vttig_jax.posterior.calibration.case_result import CaseResult
from vttig_jax.posterior.calibration.coverage import rejected
from vttig_jax.posterior.calibration.program import Batch, Program
from vttig_jax.posterior.calibration.sampled_subset import sampled_coverage
from vttig_jax.posterior.calibration.scenarios import SCENARIOS, terms_of

from vttig_jax.base.files.json_io import dumps, load_schema
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segment
from vttig_jax.pair.load import pair_from_spec, pair_spec
from vttig_jax.pair.schema import LogLayout
from vttig_jax.posterior.calibration.calibrate import Calibration, calibrate

RIGHT = ("white", "ar_4ms75", "counts")


@pytest.fixture(scope="module")
def small() -> Calibration:
    return calibrate([SCENARIOS[name].of_length("short") for name in RIGHT], rigs=500)


def relabelled(case: CaseResult, ranks: np.ndarray) -> CaseResult:
    """The case as if these had been its intervals."""
    return replace(case, ranks=ranks)


@pytest.mark.slow
def test_intervals_hold(small):
    assert small.is_calibrated, str(small)
    for case in small.cases:
        low, high = case.range_of(case.ranks, 0.95)
        assert 0.90 < low <= high < 0.99


@pytest.mark.slow
def test_correlated_noise_taken_for_white_is_seen_to_fail(small):
    white, correlated, _ = small.cases
    assert not rejected(relabelled(white, white.white_samples).cells())
    failed = relabelled(correlated, correlated.white_samples)
    assert len(rejected(failed.cells())) == 2 * len(correlated.names)
    low, high = failed.range_of(failed.ranks, 0.95)
    assert 0.25 < low <= high < 0.45
    assert not Calibration((white, failed), 0).is_calibrated


@pytest.mark.slow
def test_a_wrong_model_that_goes_unseen_is_said(small):
    case = replace(small.cases[0], scenario=replace(small.cases[0].scenario, holds=False))
    found = Calibration((case,), 0)
    assert found.unseen == ("white (short)",)
    assert "wrong models pass unseen in white (short)" in str(found)


@pytest.mark.slow
def test_record_and_table(small):
    record = small.to_json()
    jsonschema.validate(json.loads(dumps(record)), load_schema("vttig.calibrate/1"))
    assert [case["verdict"] for case in record["cases"]] == ["holds"] * 3
    text = str(small)
    assert "ar_4ms75 (short)" in text and text.endswith("calibrated: yes; right models hold")


@pytest.mark.slow
def test_same_seed_same_ranks_and_other_rigs_in_other_cases(small):
    again = calibrate([SCENARIOS["white"].of_length("short")], rigs=40).cases[0]
    np.testing.assert_array_equal(again.ranks, small.cases[0].ranks[:40])
    assert np.abs(again.ranks - small.cases[1].ranks[:40]).min() > 0


@pytest.mark.parametrize(("rigs", "posterior"), [(0, 0), (10, 11), (10, -1)])
def test_arguments_out_of_range(rigs, posterior):
    with pytest.raises(ValueError, match="Argument `"):
        calibrate([SCENARIOS["white"]], rigs=rigs, posterior=posterior)


@pytest.mark.slow
def test_sampled_ranks_are_near_those_of_laplace(small):
    program = Program(SCENARIOS["ar_4ms75"].of_length("short"))
    batches = [step for step in program.batches(3, 0) if isinstance(step, Batch)]
    sampled = sampled_coverage(program, batches, 3, 0, steps=300, burn_in=150)
    assert sampled.ranks.shape == (3, 9)
    assert np.abs(sampled.ranks - small.cases[1].ranks[:3]).max() < 0.15


CASES = ("encoders_left_out", "ar_4ms75", "counts", "one_direction")
"""Ring encoders that the fit leaves out; correlated noise; counts; one flank with a relation of its
own. The tests of `vttig calibrate` run the first one too, so that it is compiled once for both."""


def fitted_by_identify(program: Program, rig: int) -> tuple[NoiseModel, Solution]:
    """Feed the samples of a rig to the rooms that `vttig_jax.fit` goes through."""
    scenario = program.scenario
    _, readings = program.simulated(program.keys(0, np.array([rig]))[0])
    count = scenario.samples
    time = np.concatenate(
        [(np.arange(count) + 2 * k * count) / scenario.rate_hz for k in range(len(program.motion))]
    )
    angles = [np.asarray(part).ravel() for part in (readings.driving, readings.driven)]
    unit = "rad"
    if per_rev := scenario.counts_per_rev:
        unit = "counts"
        angles = [np.rint(angle * per_rev / (2 * np.pi)).astype(np.int64) for angle in angles]
    spec = msgspec.structs.replace(pair_spec(scenario.pair), log=LogLayout(zero="reading"))
    pair = pair_from_spec(spec)
    log = EncoderLog.from_arrays(time, *angles, pair=pair, unit=unit)
    channels, terms = read_channels(log, pair, (), Drift()), terms_of(scenario)
    segments = [
        Segment(k * count, (k + 1) * count, flank, 1.0) for k, flank in enumerate(scenario.flanks)
    ]
    rows = log_rows(channels, segments, terms, block_seconds([channels], [segments], terms))
    assert rows.size == program.size
    noise, whitened = whiten(summarise([rows], terms))
    return noise, solve(program.relation, whitened)


@pytest.mark.parametrize(
    "name", [CASES[0], *[pytest.param(name, marks=pytest.mark.slow) for name in CASES[1:]]]
)
def test_vmapped_fit_is_the_fit(name):
    program = Program(SCENARIOS[name].of_length("short"))
    batch = next(step for step in program.batches(3, 0) if isinstance(step, Batch))
    for rig in range(3):
        noise, solution = fitted_by_identify(program, rig)
        order = int(batch.fitted.order[rig])
        assert order == len(noise.partial)
        np.testing.assert_allclose(batch.fitted.partial[rig, :order], noise.partial, atol=1e-6)
        std = np.sqrt(np.diag(solution.covariance))
        modelled = batch.fitted.modelled
        assert np.abs((modelled.values[rig] - solution.values) / std).max() < 1e-4
        np.testing.assert_allclose(np.sqrt(np.diag(modelled.covariance[rig])), std, rtol=1e-6)
