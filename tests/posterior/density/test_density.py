"""The density of a fit: what the prior changes, which coordinates there are, what is refused."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.posterior import quick_fits
from vttig_jax.base.errors import NoAnswerError, UsageError
from vttig_jax.base.units import ARCSEC
from vttig_jax.posterior.density.density import NOISE_STD, FitTarget, fit_target
from vttig_jax.posterior.density.prior import Prior
from vttig_jax.posterior.sampling.target import Target


@pytest.fixture(scope="module")
def target() -> FitTarget:
    return fit_target(quick_fits.plain(), Prior(encoder_arcsec=1e6))


def points_of(target: FitTarget, count: int = 8) -> np.ndarray:
    return target.starts(count, np.random.default_rng(3))


def plane(target: FitTarget, name: str, points: np.ndarray) -> np.ndarray:
    """Amplitude of a pair of coordinates."""
    return np.hypot(*(points[:, target.names.index(f"{name}_{axis}")] for axis in "xy"))


def test_it_is_a_target_of_the_sampler(target):
    assert isinstance(fit_target(quick_fits.one_flank()), Target)
    values = target.log_density(points_of(target))
    assert values.dtype == np.float64 and np.isfinite(values).all()
    assert len(target.names) == len(target.units) == len(target.centre)


def test_flat_in_the_amplitude_divides_by_it(target):
    points = points_of(target)
    flat = fit_target(quick_fits.plain(), Prior(encoder_arcsec=1e6, flat_in="amplitude"))
    change = flat.log_density(points) - target.log_density(points)
    expected = -np.log(plane(target, "driving", points)) - np.log(plane(target, "driven", points))
    np.testing.assert_allclose(change, expected, atol=1e-7)


def test_encoders_are_normal(target):
    points = points_of(target)
    narrow = fit_target(quick_fits.plain(), Prior(encoder_arcsec=7.0))
    change = narrow.log_density(points) - target.log_density(points)
    squares = sum(plane(target, f"{s}_encoder", points) ** 2 for s in ("driving", "driven"))
    expected = -0.5 * squares * ((7 * ARCSEC) ** -2 - (1e6 * ARCSEC) ** -2)
    np.testing.assert_allclose(change, expected, atol=1e-7)


@pytest.mark.parametrize("name", ["driven_x", "constant_backlash", "partial_1"])
def test_outside_the_bound_there_is_nothing(target, name):
    place = target.names.index(name)
    bound = {"driven_x": 1.0, "constant_backlash": np.radians(5.0), "partial_1": 0.999}[name]
    points = np.repeat(target.centre[None], 2, axis=0)
    points[:, place] = bound * np.array([1 + 1e-9, -1 - 1e-9])
    assert (target.log_density(points) == -np.inf).all()


def test_the_disc_is_round(target):
    """Both components inside, their length outside."""
    points = target.centre[None].copy()
    points[0, [target.names.index(f"driving_{axis}") for axis in "xy"]] = 0.8
    assert target.log_density(points)[0] == -np.inf


def test_the_fit_is_the_maximum(target):
    """The gradient, in standard errors, is small there."""
    slope = np.asarray(jax.jit(jax.grad(lambda x: target.density(x)))(target.centre))
    assert np.abs(slope * np.sqrt(np.diag(target.covariance))).max() < 0.5


@pytest.mark.parametrize(
    ("prior", "words"),
    [
        (
            Prior(eccentricity_mm=1e-3),
            "(driving eccentricity: flat in the plane up to 0.001 mm); widen it with"
            " --largest-eccentricity-mm (in Python Prior(eccentricity_mm=…)).",
        ),
        (
            Prior(backlash_deg=1e-3),
            "(constant backlash: flat within ±0.001°); widen it with --largest-backlash-deg"
            " (in Python Prior(backlash_deg=…)).",
        ),
    ],
)
def test_a_prior_that_excludes_the_fit_is_refused_by_name(prior, words):
    with pytest.raises(UsageError, match="the prior excludes the fit") as error:
        fit_target(quick_fits.plain(), prior)
    assert str(error.value).endswith(words)


def test_without_noise_there_is_no_posterior():
    result = quick_fits.plain()
    noiseless = replace(result, noise=replace(result.noise, innovation_std=0.0))
    with pytest.raises(NoAnswerError, match="only rounding error"):
        fit_target(noiseless)


def test_a_fit_without_lag_products_is_refused():
    with pytest.raises(UsageError, match="holds no lag products"):
        fit_target(replace(quick_fits.plain(), evidence=None))


def test_nothing_determined_is_no_answer():
    result = quick_fits.plain()
    assert result.evidence is not None
    empty = replace(result, evidence=replace(result.evidence, determined=("offset",)))
    with pytest.raises(NoAnswerError, match="determines no parameter"):
        fit_target(empty)


def test_a_robust_loss_has_its_maximum_at_the_scatter_of_the_fit():
    """The variance factor of the loss is in both."""
    target = fit_target(quick_fits.robust())
    evidence = quick_fits.robust().evidence
    assert evidence is not None and evidence.variance_factor > 1.02
    place = target.names.index(NOISE_STD)
    points = np.repeat(target.centre[None], 3, axis=0)
    points[:, place] += 2.0 * np.sqrt(target.covariance[place, place]) * np.array([-1, 0, 1])
    values = target.log_density(points)
    assert values[1] > max(values[0], values[2])


def test_noise_of_every_speed_is_refused():
    result = quick_fits.one_flank()
    noise = replace(result.noise, plateaus=((6.3, result.noise),))
    with pytest.raises(UsageError, match="this fit has one per speed"):
        fit_target(replace(result, noise=noise))


def test_one_flank_has_no_constant_backlash():
    names = fit_target(quick_fits.one_flank()).names
    assert names[:4] == ("driving_x", "driving_y", "driven_x", "driven_y")
    assert names[4] == NOISE_STD and "constant_backlash" not in names


def test_a_shaft_that_turned_too_little_is_left_out():
    result = quick_fits.short()
    names = fit_target(result).names
    assert not result.parameters["driven_eccentricity_mm"].determined
    assert "driven_x" not in names and "driving_x" in names


def test_own_columns_of_logs_are_integrated_out():
    """Offsets, drift and the start angles of a second log are nobody's question."""
    target = fit_target(quick_fits.two_speeds())
    assert not [name for name in target.names if "start" in name or "offset" in name]
    assert "delay" in target.names and target.units[target.names.index("delay")] == "s"
    unit = dict(zip(target.names, target.units, strict=True))
    assert unit["driving_x"] == "mm" and unit["driving_encoder_x"] == "rad"


def test_the_identity_tells_data_and_prior_apart(target):
    own = target.identity
    other = fit_target(quick_fits.plain(), Prior(encoder_arcsec=7.0)).identity
    assert own != other and {key for key in own if own[key] != other[key]} == {"prior"}
