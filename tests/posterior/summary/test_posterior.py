"""What a posterior says in numbers, JSON and words."""

import json
from dataclasses import replace
from fractions import Fraction
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.posterior.made import quick_posterior
from tests.schemas import load_schema
from vttig_jax.base import ARCSEC, DEG
from vttig_jax.base.angles import difference_deg
from vttig_jax.base.files.json_io import dumps
from vttig_jax.model import Parameter
from vttig_jax.pair import Drive
from vttig_jax.posterior import Posterior
from vttig_jax.posterior.summary.draws import (
    parameters_of_draws,
    phase_of_draws,
    polar_of_draws,
    scalar_of_draws,
    shown_unit,
)
from vttig_jax.posterior.summary.posterior import priors


def _phase(draws: np.ndarray) -> Any:
    """The parameter of draws, whose numbers are all given."""
    return phase_of_draws("phase_deg", draws)


@given(st.floats(0, 360), st.floats(0.01, 20))
@example(359.0, 3.0)
@example(1.0, 3.0)
def test_a_phase_is_that_of_the_line_wherever_it_lies(mean, std):
    draws = mean + std * np.random.default_rng(0).standard_normal(20_000)
    found = _phase(np.mod(draws, 360.0))
    assert abs(difference_deg(found.value, mean)) < 0.03 * std + 1e-9
    assert found.std == pytest.approx(std, rel=0.03)
    assert found.high95 - found.low95 == pytest.approx(2 * 1.96 * std, rel=0.05)
    assert found.low95 < found.value < found.high95 and 0 <= found.value < 360
    off = np.asarray(difference_deg(draws, found.value))
    inside = (off >= found.low95 - found.value) & (off <= found.high95 - found.value)
    assert np.mean(inside) == pytest.approx(0.95, abs=1e-3)


def test_whole_turns_change_nothing():
    for shift in (0.0, 1e-14, -1e-14, 360.0):
        found = _phase(np.array([350.0, 355.0, 0.0, 5.0, 370.0]) + shift)
        assert found.low95 < found.value < found.high95 and 0 <= found.value < 360
    random = np.random.default_rng(0)
    draws = 100.0 + 5.0 * random.standard_normal(20_000)
    one, other = _phase(draws), _phase(draws + 360.0 * random.integers(-3, 4, len(draws)))
    assert vars(other) == pytest.approx(vars(one), abs=1e-9)


@pytest.fixture(scope="module")
def posterior():
    return quick_posterior()


def _plane(x: float, y: float, std: float) -> np.ndarray:
    return [x, y] + std * np.random.default_rng(0).standard_normal((40_000, 2))


def without(posterior: Posterior, *names: str, **changes: Any) -> Posterior:
    """The posterior whose fit does not tell these parameters."""
    fit = posterior.fit
    unknown = {n: Parameter(n, fit.parameters[n].unit, reason="one direction") for n in names}
    changed = replace(fit, parameters=fit.parameters | unknown, **changes)
    return replace(posterior, fit=changed)


def test_moved_draws_move_the_parameter_and_its_words(posterior):
    """Parameters are those of the draws, not the fit copied."""
    place = posterior.names.index("constant_backlash")
    draws = posterior.draws.copy()
    draws[..., place] += 0.01 * DEG
    found, known = (
        one.parameters["constant_backlash_deg"]
        for one in (replace(posterior, draws=draws), posterior)
    )
    for field in ("value", "median", "low95", "high95"):
        assert getattr(found, field) - getattr(known, field) == pytest.approx(0.01, abs=1e-9)
    for axis in "xy":
        place = posterior.names.index(f"driven_encoder_{axis}")
        draws[..., place] -= draws[..., place].mean()
    text = str(replace(posterior, draws=draws))
    (line,) = [line for line in text.splitlines() if line.startswith("driven_encoder_arcsec")]
    assert "<" in line and "upper limit" in line


def test_quantiles_of_a_skewed_coordinate_are_equal_tailed():
    draws = np.random.default_rng(0).exponential(size=40_000)
    found: Any = scalar_of_draws("x", "", draws)
    expected = -np.log1p(-np.array([0.025, 0.5, 0.975]))
    quantiles = [found.low95, found.median, found.high95]
    assert quantiles == pytest.approx(list(expected), rel=0.05) and found.value > found.median


def test_the_value_of_an_amplitude_is_not_made_too_long_by_noise():
    """Below three standard errors it has an upper limit and no phase."""
    plane = _plane(3.5, 0.0, 1.0)
    clear: Any = polar_of_draws(("a", "p"), "mm", plane)
    assert clear[0].value == pytest.approx(3.5, abs=0.02)
    assert np.hypot(*plane.T).mean() > 3.6  # the mean length, which it would be otherwise
    assert clear[0].significant and clear[0].low95 < clear[0].value < clear[0].high95
    assert clear[0].upper95 is None and clear[1].std == pytest.approx(17, abs=1)
    plane = _plane(0.02, 0.0, 0.01)
    amplitude, phase = polar_of_draws(("a", "p"), "mm", plane)
    assert not amplitude.significant and amplitude.low95 == 0.0
    assert amplitude.upper95 == amplitude.high95 == np.quantile(np.hypot(*plane.T), 0.95)
    assert phase.value is None and phase.determined
    assert phase.reason == "a is below three standard errors"


def test_what_the_fit_calls_undetermined_stays_so_whatever_the_draws_are(posterior):
    names = "driving_encoder_arcsec", "driving_encoder_phase_deg"
    one_way = without(posterior, *names).parameters
    for name in names:
        assert not one_way[name].determined and one_way[name].value is None
        assert one_way[name].low95 is None and one_way[name].reason == "one direction"
        assert posterior.parameters[name].value is not None


def test_a_drive_is_in_arcsec_and_units_are_those_of_people(posterior):
    known = {
        name: Parameter(name, unit, 1.0, 0.1, determined=True)
        for name, unit in (("driving_amplitude_arcsec", "arcsec"), ("driving_phase_deg", "deg"))
    }
    fit = replace(posterior.fit, pair=Drive(Fraction(9, 16), name="drive"), parameters=known)
    plane = _plane(30.0, 40.0, 0.5) * ARCSEC
    found = parameters_of_draws(fit, ("driving_x", "driving_y"), plane)
    assert found["driving_amplitude_arcsec"].value == pytest.approx(50, abs=0.05)
    assert found["driving_phase_deg"].value == pytest.approx(53.13, abs=0.1)
    assert shown_unit("constant_backlash", "rad") == ("deg", DEG)
    assert shown_unit("driving_x", "rad") == ("arcsec", ARCSEC)
    assert shown_unit("driving_x", "mm") == ("mm", 1.0)


def test_correlation_is_that_of_the_draws(posterior):
    places = [posterior.place(name) for name in posterior.physical]
    expected = np.corrcoef(posterior.flat.T)[np.ix_(places, places)]
    np.testing.assert_allclose(posterior.correlation, expected, atol=1e-12)
    driving, encoder = (posterior.physical.index(n) for n in ("driving_x", "driving_encoder_x"))
    assert posterior.correlation[driving, encoder] > 0.9
    assert "log_innovation_std" in posterior.names
    assert not {"log_innovation_std", "gap_over_angles_covered"} & set(posterior.physical)
    found, known = posterior.eccentricities(), posterior.fit.eccentricities()
    for name in ("driving_mm", "driven_mm", "constant_backlash_deg"):
        assert float(getattr(found, name)) == pytest.approx(float(getattr(known, name)), abs=5e-4)
    with pytest.raises(ValueError, match="nonesuch"):
        posterior.values("nonesuch")


def test_every_order_has_one_prior(posterior):
    """Order 1 of gears is flat, and orders that stand out have a width of their own."""
    told = [sentence.partition(", each coefficient")[0] for sentence in priors(posterior.fit)]
    names = [name for text in told for name in text.removeprefix("flat: ").split(", ")]
    assert "driving order 1" in names and len(set(names)) == len(names)
    assert any(" order " in name and not name.endswith(" 1") for name in names)


def test_json_fits_its_schema_and_says_why_there_is_no_gap(posterior):
    record = json.loads(dumps(posterior.to_json()))
    validator = jsonschema.Draft202012Validator(load_schema("vttig.posterior/1"))
    validator.validate(record)
    assert record["parameters"]["driven_eccentricity_mm"]["median"] > 0
    closing = record["smallest_gap"]["safe_closing_mm"]
    assert closing["low95"] < closing["median"] < closing["high95"]
    assert record["correlation"]["names"] == list(posterior.physical)
    assert set(record["diagnosis"]["r_hat"]) == set(posterior.chains.header.names)
    assert record["converged"] == posterior.diagnosis.converged and record["prior"]
    gap = record["smallest_gap"]["backlash_deg"]
    parts = (record["parameters"]["delay_s"], "median"), (gap, "low95"), (record, "diagnosis")
    for part, key in parts:
        kept = part.pop(key)
        assert not validator.is_valid(record)
        part[key] = kept
    record["correlation"]["matrix"][0].append(2.0)
    assert not validator.is_valid(record)
    one = without(posterior, "constant_backlash_deg", flanks=("A",))
    record = json.loads(dumps(one.to_json()))
    jsonschema.validate(record, load_schema("vttig.posterior/1"))
    assert record["smallest_gap"] is None and "record both" in record["smallest_gap_reason"]
    assert "one direction" in str(one)
