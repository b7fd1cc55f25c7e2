"""What a posterior says in numbers, JSON and words."""

import json
from dataclasses import replace
from fractions import Fraction

import jsonschema
import numpy as np
import pytest

from tests.posterior.made import quick_posterior
from tests.schemas import load_schema
from vttig_jax.base.angles import difference_deg
from vttig_jax.base.files.json_io import dumps
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.model.parameter import Parameter
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.posterior.summary.draws import (
    parameters_of_draws,
    polar_of_draws,
    scalar_of_draws,
    shown_unit,
)
from vttig_jax.posterior.summary.posterior import priors


@pytest.fixture(scope="module")
def posterior():
    return quick_posterior()


def _plane(x: float, y: float, std: float, count: int = 40_000) -> np.ndarray:
    return [x, y] + std * np.random.default_rng(0).standard_normal((count, 2))


def test_moved_draws_move_the_parameter(posterior):
    """The agreement above is with the draws, not with the fit copied."""
    place = posterior.names.index("constant_backlash")
    draws = posterior.draws.copy()
    draws[..., place] += 0.01 * DEG
    found = replace(posterior, draws=draws).parameters["constant_backlash_deg"]
    known = posterior.parameters["constant_backlash_deg"]
    for field in ("value", "median", "low95", "high95"):
        assert getattr(found, field) - getattr(known, field) == pytest.approx(0.01, abs=1e-9)


def test_quantiles_of_a_skewed_coordinate_are_equal_tailed():
    draws = np.random.default_rng(0).exponential(size=40_000)
    found = scalar_of_draws("x", "", draws)
    assert (found.median or np.inf) < (found.value or 0.0)
    expected = -np.log1p(-np.array([0.025, 0.975]))
    assert [found.low95, found.high95] == pytest.approx(list(expected), rel=0.05)


def test_the_value_of_an_amplitude_is_not_made_too_long_by_noise():
    plane = _plane(3.5, 0.0, 1.0)
    amplitude, phase = polar_of_draws(("a", "p"), "mm", plane)
    assert amplitude.value == pytest.approx(3.5, abs=0.02)
    assert np.hypot(*plane.T).mean() > 3.6  # the mean length, which it would be otherwise
    assert amplitude.significant
    assert (amplitude.low95 or 9.0) < (amplitude.value or 0.0) < (amplitude.high95 or 0.0)
    assert phase.value is not None and phase.std == pytest.approx(17, abs=1)


def test_below_three_standard_errors_an_upper_limit_and_no_phase():
    plane = _plane(0.02, 0.0, 0.01)
    amplitude, phase = polar_of_draws(("a", "p"), "mm", plane)
    assert not amplitude.significant and amplitude.low95 == 0.0
    assert amplitude.upper95 == amplitude.high95 == np.quantile(np.hypot(*plane.T), 0.95)
    assert (
        phase.value is None
        and phase.determined
        and phase.reason == ("a is below three standard errors")
    )
    clear, _ = polar_of_draws(("a", "p"), "mm", _plane(0.04, 0.0, 0.01))
    assert clear.significant and clear.upper95 is None


def test_a_phase_near_zero_has_an_interval_around_it():
    _, phase = polar_of_draws(("a", "p"), "mm", _plane(1.0, 0.0, 0.05))
    assert phase.low95 is not None and phase.high95 is not None
    value = float(difference_deg(phase.value or 0.0, 0.0))
    span = phase.high95 - phase.low95
    assert abs(value) < 0.2 and span == pytest.approx(2 * 1.96 * 0.05 / DEG, rel=0.03)
    assert phase.low95 < 0 < phase.high95 or phase.low95 < 360 < phase.high95


def test_what_the_fit_calls_undetermined_stays_so_whatever_the_draws_are(posterior):
    fit = posterior.fit
    unknown = {
        name: Parameter(name, fit.parameters[name].unit, reason="one direction")
        for name in ("driving_encoder_arcsec", "driving_encoder_phase_deg")
    }
    found = replace(posterior, fit=replace(fit, parameters=fit.parameters | unknown)).parameters
    for name in unknown:
        assert not found[name].determined and found[name].value is None
        assert found[name].low95 is None and found[name].reason == "one direction"
    assert posterior.parameters["driving_encoder_arcsec"].value is not None


def test_a_drive_is_in_arcsec(posterior):
    drive = Drive(Fraction(9, 16), name="drive")
    names = ("driving_x", "driving_y")
    known = {
        name: Parameter(name, unit, 1.0, 0.1, determined=True)
        for name, unit in (("driving_amplitude_arcsec", "arcsec"), ("driving_phase_deg", "deg"))
    }
    fit = replace(posterior.fit, pair=drive, parameters=known)
    found = parameters_of_draws(fit, names, _plane(30.0, 40.0, 0.5) * ARCSEC)
    assert found["driving_amplitude_arcsec"].value == pytest.approx(50, abs=0.05)
    assert found["driving_phase_deg"].value == pytest.approx(53.13, abs=0.1)


def test_units_at_the_border():
    assert shown_unit("constant_backlash", "rad") == ("deg", DEG)
    assert shown_unit("driving_x", "rad") == ("arcsec", ARCSEC)
    assert shown_unit("driving_x", "mm") == ("mm", 1.0)
    assert shown_unit("partial_1", "1") == ("1", 1.0)


def test_correlation_is_that_of_the_draws(posterior):
    places = [posterior.place(name) for name in posterior.physical]
    expected = np.corrcoef(posterior.flat.T)[np.ix_(places, places)]
    np.testing.assert_allclose(posterior.correlation, expected, atol=1e-12)
    driving, encoder = (posterior.physical.index(n) for n in ("driving_x", "driving_encoder_x"))
    assert posterior.correlation[driving, encoder] > 0.9
    assert "log_innovation_std" in posterior.names
    assert not {"log_innovation_std", "gap_over_angles_covered"} & set(posterior.physical)


def test_the_rig_of_the_mean_is_near_that_of_the_fit(posterior):
    found, known = posterior.eccentricities(), posterior.fit.eccentricities()
    for name in ("driving_mm", "driven_mm", "constant_backlash_deg"):
        assert float(getattr(found, name)) == pytest.approx(float(getattr(known, name)), abs=5e-4)


def test_an_unknown_coordinate_is_refused(posterior):
    with pytest.raises(ValueError, match="nonesuch"):
        posterior.values("nonesuch")


def test_every_order_has_one_prior(posterior):
    """Order 1 of gears is flat, and orders that stand out have a width of their own."""
    told = [sentence.partition(", each coefficient")[0] for sentence in priors(posterior.fit)]
    names = [name for text in told for name in text.removeprefix("flat: ").split(", ")]
    assert "driving order 1" in names and len(set(names)) == len(names)
    assert any(" order " in name and not name.endswith(" 1") for name in names)


def test_json_fits_its_schema(posterior):
    record = json.loads(dumps(posterior.to_json()))
    validator = jsonschema.Draft202012Validator(load_schema("vttig.posterior/1"))
    validator.validate(record)
    assert record["parameters"]["driven_eccentricity_mm"]["median"] > 0
    closing = record["smallest_gap"]["safe_closing_mm"]
    assert closing["low95"] < closing["median"] < closing["high95"]
    assert record["correlation"]["names"] == list(posterior.physical)
    assert set(record["diagnosis"]["r_hat"]) == set(posterior.chains.header.names)
    assert record["converged"] == posterior.diagnosis.converged and record["prior"]
    for spoil in (
        lambda r: r["parameters"]["delay_s"].pop("median"),
        lambda r: r.pop("diagnosis"),
        lambda r: r["smallest_gap"]["backlash_deg"].pop("low95"),
        lambda r: r["correlation"]["matrix"][0].append(2.0),
    ):
        broken = json.loads(dumps(record))
        spoil(broken)
        assert not validator.is_valid(broken)


def test_json_of_one_flank_says_why_there_is_no_gap(posterior):
    fit = posterior.fit
    unknown = Parameter("constant_backlash_deg", "deg", reason="one direction")
    parameters = fit.parameters | {"constant_backlash_deg": unknown}
    one = replace(posterior, fit=replace(fit, flanks=("A",), parameters=parameters))
    record = json.loads(dumps(one.to_json()))
    jsonschema.validate(record, load_schema("vttig.posterior/1"))
    assert record["smallest_gap"] is None and "record both" in record["smallest_gap_reason"]
    assert "one direction" in str(one)


def test_words_show_an_upper_limit(posterior):
    draws = posterior.draws.copy()
    for axis in "xy":
        place = posterior.names.index(f"driven_encoder_{axis}")
        draws[..., place] -= draws[..., place].mean()
    text = str(replace(posterior, draws=draws))
    (line,) = [line for line in text.splitlines() if line.startswith("driven_encoder_arcsec")]
    assert "<" in line and "upper limit" in line
