"""Three routes to the same interval, and what is said where they part."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.posterior import quick_fits
from vttig_jax.posterior.density.prior import Prior
from vttig_jax.posterior.sampler import sample
from vttig_jax.posterior.summary.posterior import Posterior
from vttig_jax.posterior.summary.route_agreement import Agreement, Route, RouteComparison, agreement


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    return sample(quick_fits.one_flank(), steps=1000)


def test_a_fit_with_white_residual_agrees(posterior):
    found = agreement(posterior)
    assert found.agreed, found.sentences
    assert [one.name for one in found.compared] == list(posterior.physical)
    assert str(found).endswith("the three routes agree.")
    other = replace(found, takes_delay_as_zero=True)
    assert str(other).endswith("constant backlash of this table is that of a delay of zero.")


def test_it_can_be_written(posterior):
    record = json.loads(json.dumps(agreement(posterior).to_json(), allow_nan=False))
    first = record["coordinates"][0]
    assert first["name"] == "driving_x" and set(first["profile"]) == {"centre", "half68", "half95"}
    assert record["agreed"] is True and record["sentences"] == []


def test_the_delay_of_all_routes_is_that_of_the_report():
    result = quick_fits.two_speeds()
    found = agreement(sample(result, steps=400))
    [delay] = [one for one in found.compared if one.name == "delay"]
    stated = result.parameters["delay_s"]
    assert stated.value is not None and stated.std is not None and stated.value > 20 * stated.std
    for route in (delay.fit, delay.profile, delay.sampled):
        assert route.centre == pytest.approx(stated.value, abs=3 * stated.std)
    assert delay.fit.centre == pytest.approx(stated.value, rel=1e-9)


def test_draws_that_are_too_narrow_and_too_far_off_are_seen(posterior):
    draws = posterior.draws.copy()
    place = posterior.names.index("driven_x")
    values = draws[..., place]
    draws[..., place] = values.mean() + 0.5 * (values - values.mean()) + 2 * values.std()
    found = agreement(replace(posterior, draws=draws))
    assert not found.agreed and len(found.sentences) == 4
    assert "standard error of driven x is 2 times the sampled one." in found.sentences[0]
    moved = draws[..., place]
    half = np.diff(np.quantile(moved, [0.15865525, 0.84134475])) / 2
    fitted = posterior.fit.values[posterior.fit.covariance_names.index("driven_x")]
    away = float(abs(fitted - moved.mean()) / half[0])
    assert away == pytest.approx(4.0, abs=0.3)
    assert f"the fit's value of driven x is {away:.2g} standard deviations" in found.sentences[1]
    assert "profile interval of driven x is" in found.sentences[2]


def test_a_fit_that_is_less_certain_than_its_noise_widens_profile_and_draws(posterior):
    result = posterior.fit
    wider = replace(result.evidence, widening=2.3 * result.evidence.widening)
    wide = replace(result, covariance=2.3**2 * result.covariance, evidence=wider)
    narrow_draws = agreement(replace(posterior, fit=wide))
    assert "2.3 times the sampled one" in narrow_draws.sentences[0]
    place = [posterior.names.index(name) for name in posterior.physical]
    draws = posterior.draws.copy()
    centre = result.values[[result.covariance_names.index(name) for name in posterior.physical]]
    draws[..., place] = centre + 2.3 * (draws[..., place] - centre)
    found = agreement(replace(posterior, fit=wide, draws=draws))
    assert found.agreed and found.widening == pytest.approx(2.3)
    assert "intervals" in str(replace(posterior, fit=wide)) and "up to 2.3" in str(
        replace(posterior, fit=wide)
    )
    assert "times the width" not in str(posterior)


def test_the_prior_has_to_be_that_of_the_draws(posterior):
    with pytest.raises(ValueError, match="Argument `prior` must be that of the draws"):
        agreement(posterior, Prior(eccentricity_mm=0.4))


def one(
    shift: float = 0.0, width: float = 1.0, effective: float = 1e6, **routes
) -> RouteComparison:
    plain = Route(0.0, 1.0, 1.96)
    own = {"fit": Route(shift, width, 1.96 * width), "profile": plain, "sampled": plain} | routes
    return RouteComparison("driving_x", "mm", effective=effective, **own)


@pytest.mark.parametrize(
    ("compared", "agreed"),
    [
        (one(0.29), True),
        (one(0.32), False),
        (one(width=1.14), True),
        (one(width=1.17), False),
        (one(width=1 / 1.17), False),
        (one(0.5, effective=100.0), True),
        (one(width=1.4, effective=100.0), True),
        (one(profile=Route(0.0, np.inf, np.inf)), False),
    ],
)
def test_tolerances_grow_with_what_the_draws_leave_open(compared, agreed):
    assert Agreement((compared,)).agreed is agreed


def test_an_unbounded_profile_is_said_and_can_be_written():
    found = Agreement((one(profile=Route(0.0, np.inf, np.inf)),))
    assert found.sentences == ("the profile interval of driving x is unbounded.",)
    assert found.to_json()["coordinates"][0]["profile"]["half95"] is None


def test_half_widths_scatter_as_they_are_said_to():
    """Relative scatter of the half widths of normal draws is about 1/√n."""
    draws = np.random.default_rng(0).standard_normal((2000, 400))
    for tail in (0.1586553, 0.025):
        low, high = np.quantile(draws, [tail, 1 - tail], axis=1)
        half = (high - low) / 2
        assert half.std() / half.mean() * np.sqrt(400) == pytest.approx(0.95, abs=0.08)
