"""Where the driven encoder reads zero is nobody's business but that of the driven phase."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vttig_jax
from tests.identify.quick import quick_rig
from vttig_jax.base.angles import difference_deg
from vttig_jax.base.units import DEG, REV
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.model.mounting import mounted_closed, mounted_exact, mounting_of
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.first_order import closed_model
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.load import pair_from_spec, pair_spec
from vttig_jax.rig.fixed_gear import fixed_gear_readings

ANGLES = np.linspace(0.0, 16 * REV, 500)
GAP_DEG = 0.038
COUNTS = 90_000
ALONE = {"perfect_encoders": True}
OPTIONS = {"AB": {}, "A": {"flank": "A", **ALONE}, "B": {"flank": "B", **ALONE}}
SAME = 2e-9
"""Of mm and degrees; phases of encoder and gear together are known a thousand times worse."""


class Bench:
    """A short run of five turns, its driven encoder mounted at any angle."""

    def __init__(self) -> None:
        self.rig = quick_rig(3)
        self.log = self.rig.log(3)
        self.spec = pair_spec(self.rig.pair)
        self.pair = pair_from_spec(
            msgspec.structs.replace(
                self.spec, log=msgspec.structs.replace(self.spec.log, zero="reading")
            )
        )

    def fitted(self, flanks: str, counts: int, **options) -> Fit:
        assert self.log.driven is not None
        reading = self.log.driven.reading + counts
        mounted = EncoderLog.from_arrays(
            self.log.time, self.log.driving.reading, reading, pair=self.pair
        )
        return fit(mounted, self.pair, **OPTIONS[flanks], **options)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


@pytest.fixture(scope="module")
def plain(bench) -> dict[str, Fit]:
    return {flanks: bench.fitted(flanks, 0) for flanks in OPTIONS}


def maps(fitted: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Gap and first-order gap over the hunting period, degrees."""
    known = None if len(fitted.flanks) == 2 else GAP_DEG
    grid = backlash_map(fitted, constant_backlash_deg=known)
    return grid.over(ANGLES) / DEG, grid.first_order_over(ANGLES) / DEG


def assert_same_rig(found: Fit, plain: Fit, counts: int) -> None:
    """Everything but the driven phase, which moves by the counts, and the offset."""
    assert found.outcome == plain.outcome
    assert found.residual_rms_deg == pytest.approx(plain.residual_rms_deg, abs=SAME)
    for name in ("driving_eccentricity_mm", "driven_eccentricity_mm", "constant_backlash_deg"):
        if plain.parameters[name].value is not None:
            assert found.value(name) == pytest.approx(plain.value(name), abs=SAME), name
    turned = {"driving": 0.0, "driven": 360.0 * counts / COUNTS}
    for shaft, by in turned.items():
        name = f"{shaft}_phase_deg"
        off = difference_deg(found.value(name) + by, plain.value(name))
        assert abs(off) < 1000 * SAME, name
    for gap, expected in zip(maps(found), maps(plain), strict=True):
        np.testing.assert_allclose(gap, expected, atol=SAME)
    jumps = [f.checks.reversals[0].variable_backlash_deg for f in (found, plain)]
    assert jumps[0] == pytest.approx(jumps[1], abs=SAME)
    offset = np.nanmedian(np.asarray(found.model.offset) - np.asarray(plain.model.offset))
    assert offset == pytest.approx(counts / COUNTS * REV, abs=SAME)
    middle = [np.median(f.curves[0].transmission_error) for f in (found, plain)]
    assert middle[0] - middle[1] == pytest.approx(counts / COUNTS * REV, abs=SAME)


@pytest.mark.parametrize("flanks", ["AB", "A", "B"])
@settings(max_examples=3, deadline=None)
@given(counts=st.integers(0, COUNTS))
def test_any_mounting_gives_the_same_rig(bench, plain, flanks, counts):
    assert_same_rig(bench.fitted(flanks, counts), plain[flanks], counts)


@pytest.mark.parametrize("flanks", ["AB", "A"])
def test_two_radians_and_a_thousand_turns_too(bench, plain, flanks):
    assert_same_rig(bench.fitted(flanks, 30_001), plain[flanks], 30_001)
    many = bench.fitted(flanks, 123_456_789)
    assert many.residual_rms_deg == pytest.approx(plain[flanks].residual_rms_deg, abs=SAME)
    np.testing.assert_allclose(maps(many), maps(plain[flanks]), atol=SAME)


def test_models_that_forget_the_mounting_are_seen(bench, plain):
    """The negative control: e₂ at i φ₁ + θ₂ is as wrong as the variable backlash is large."""
    found = bench.fitted("A", 30_001)
    rig = found.eccentricities(GAP_DEG)
    mounting = mounting_of(found.covariance_names, found.values, found.flanks, GAP_DEG * DEG)
    assert mounting == pytest.approx(30_001 / COUNTS * REV, abs=0.1 * DEG)
    pairs = ((exact_model, mounted_exact), (closed_model, mounted_closed))
    for (bare, mounted), gap in zip(pairs, maps(plain["A"]), strict=True):
        there = mounted(found.pair, rig, mounting).backlash(ANGLES)
        np.testing.assert_allclose(np.asarray(there) / DEG, gap, atol=SAME)
        forgot = np.asarray(bare(found.pair, rig).backlash(ANGLES)) / DEG
        assert np.abs(forgot - gap).max() > 0.02


@pytest.mark.portable
@pytest.mark.usefixtures("fully_optimised")
def test_readings_on_one_flank_meet_the_gap_where_the_gear_stands(bench):
    readings = fixed_gear_readings(bench.rig, np.arange(0.0, 1800.0, 37.0))
    found = [
        bench.fitted("A", counts, readings=readings, use_readings=True) for counts in (0, 30_001)
    ]
    gaps = [f.value("constant_backlash_deg") for f in found]
    scatter = [f.checks.readings.scatter_deg for f in found]
    assert gaps[1] == pytest.approx(gaps[0], abs=1e-8) == pytest.approx(GAP_DEG, abs=0.001)
    assert scatter[1] == pytest.approx(scatter[0], abs=1e-8)
    np.testing.assert_allclose(
        backlash_map(found[1]).over(ANGLES), backlash_map(found[0]).over(ANGLES), atol=1e-8 * DEG
    )


def test_the_offset_of_flank_b_alone_holds_the_gap():
    assert mounting_of(("x", "offset"), np.array([1.0, 2.0]), ("A",), 0.5) == 2.0
    assert mounting_of(("x", "offset"), np.array([1.0, 2.0]), ("B",), 0.5) == 1.5
    names, values = ("offset_of_1", "offset_of_2"), np.array([1.0, 2.0])
    assert [mounting_of(names, values, ("A", "B"), 0.5, log) for log in (0, 1)] == [1.0, 2.0]


def test_from_the_first_sample_the_mounting_is_the_te_of_the_start(clean_rig, clean_fit, clean_log):
    """Small, but e₂ stands at φ₂ + θ₂ all the same: with it one flank says what both do."""
    one = fit(clean_log, clean_rig.pair, flank="A", perfect_encoders=True)
    rig = one.eccentricities(GAP_DEG)
    mounting = mounting_of(one.covariance_names, one.values, one.flanks, GAP_DEG * DEG)
    start = vttig_jax.exact_transmission_error(0.0, clean_rig.pair, clean_rig.eccentricities)
    assert mounting == pytest.approx(-float(start), abs=1e-6)
    both, _ = maps(clean_fit)
    alone, _ = maps(one)
    forgot = np.asarray(exact_model(clean_rig.pair, rig).backlash(ANGLES)) / DEG
    assert np.abs(alone - both).max() < 2e-6 < 8e-6 < np.abs(forgot - both).max()


def test_a_further_log_has_its_jump_where_its_own_zero_lies(bench):
    """The same run cut by a turn counts from another zero, and turns at the same place."""
    log, pair = bench.log, bench.rig.pair
    assert log.driven is not None
    cut = int(np.searchsorted(log.driving_angle, REV + 1.0))
    parts = (log.time, log.driving.reading, log.driven.reading)
    late = EncoderLog.from_arrays(*(part[cut:] for part in parts), pair=pair)
    first, second = fit([log, late], pair).checks.reversals
    assert second.driving_deg == pytest.approx(first.driving_deg - 360 - 1 / DEG, abs=0.5)
    variable = first.variable_backlash_deg
    assert variable is not None
    assert second.variable_backlash_deg == pytest.approx(variable, abs=2e-4)
    rig = bench.rig.eccentricities
    forgot = float(vttig_jax.backlash(second.driving_deg * DEG, pair, rig)) / DEG - GAP_DEG
    assert abs(forgot - variable) > 2e-3


def test_the_zero_is_told_as_the_reading_that_is_angle_zero(bench):
    """Not a spike that stands in its place."""
    log = bench.log
    assert log.driven is not None
    reading = log.driven.reading + 5_000
    reading[0] += 700
    spiked = EncoderLog.from_arrays(log.time, log.driving.reading, reading, pair=bench.rig.pair)
    assert spiked.driven is not None
    told = fit(spiked, bench.rig.pair).zero_readings
    assert told == {"driving": spiked.driving.origin, "driven": spiked.driven.origin}
    assert told["driven"] != spiked.driven.reading[0]
    clean = replace(spiked, driven=replace(spiked.driven, reading=log.driven.reading + 5_000))
    assert fit(clean, bench.rig.pair).zero_readings["driven"] == told["driven"]
