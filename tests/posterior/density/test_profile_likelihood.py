"""Profile intervals against densities whose profiles are known, and against constrained maxima."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.stats import chi2

from tests.posterior import quick_fits
from vttig_jax.posterior.density.density import FitTarget, fit_target
from vttig_jax.posterior.density.evaluation import Density
from vttig_jax.posterior.density.prior import Prior
from vttig_jax.posterior.density.profile_likelihood import Profiler, profile, profiles

Q95 = float(chi2.ppf(0.95, 1))


@pytest.fixture(scope="module")
def target() -> FitTarget:
    return fit_target(quick_fits.one_flank())


class Made(Density):
    """A density of (a, b, …) in standard errors of the fit from its centre."""

    kind: str = eqx.field(static=True)
    middle: np.ndarray
    inverse: np.ndarray

    def __call__(self, point, rows=None):
        z = self.inverse @ (point - self.middle)
        rest = -0.5 * z[2:] @ z[2:]
        if self.kind == "normal":
            return rest - 0.5 * (z[0] ** 2 + z[1] ** 2 - 1.6 * z[0] * z[1]) / (1 - 0.8**2)
        if self.kind == "bent":  # b follows a²: the profile of a stays normal
            return rest - 0.5 * z[0] ** 2 - 5.0 * (z[1] - z[0] ** 2) ** 2
        if self.kind == "skewed":
            return rest + 4.0 * (z[0] - jnp.exp(z[0])) - 0.5 * z[1] ** 2
        flat = -0.5 * z[1] ** 2 + rest
        if self.kind == "flat":
            return flat
        return jnp.where(jnp.abs(z[0]) <= 0.5, flat, -jnp.inf)


def made(target: FitTarget, kind: str) -> tuple[FitTarget, np.ndarray]:
    size = np.sqrt(np.diag(target.covariance))
    fields = {name: getattr(target.density, name) for name in Density.__dataclass_fields__}
    density = Made(**fields, kind=kind, middle=target.centre, inverse=np.diag(1 / size))
    return replace(target, density=density, covariance=np.diag(size**2)), size


def ends(target: FitTarget, kind: str, name: str, probability: float = 0.95) -> tuple[Any, Any]:
    """Interval in standard errors from the centre, and as it was found."""
    changed, size = made(target, kind)
    place = target.names.index(name)
    found = profile(changed, name, probability)
    return [
        None if end is None else (end - target.centre[place]) / size[place]
        for end in (found.low, found.high)
    ], found


@pytest.mark.parametrize("name", ["driving_x", "driving_y"])
def test_a_normal_density_has_normal_intervals(target, name):
    """Correlated 0.8: the other coordinate has to follow."""
    found, _ = ends(target, "normal", name)
    np.testing.assert_allclose(found, [-1.959964, 1.959964], atol=1e-3)


def test_others_follow_along_a_bend(target):
    found, _ = ends(target, "bent", "driving_x")
    np.testing.assert_allclose(found, [-1.959964, 1.959964], atol=2e-3)


def test_a_skewed_density_has_a_skewed_interval(target):
    found, interval = ends(target, "skewed", "driving_x")
    fall = lambda z: 8.0 * (np.exp(z) - z - 1) - Q95  # noqa: E731
    roots: Any = [brentq(fall, -5, 0), brentq(fall, 0, 5)]
    np.testing.assert_allclose(found, roots, atol=1e-3)
    assert interval.best == pytest.approx(target.centre[0], abs=1e-4 * interval.half_width)


def test_a_side_without_an_end_is_said(target):
    found, interval = ends(target, "flat", "driving_x")
    assert found == [None, None] and interval.half_width == np.inf
    assert "below: the density does not fall off" in str(interval)
    assert "unbounded" in str(interval) and interval.to_json()["low"] is None


def test_an_end_at_the_bound_is_said(target):
    found, interval = ends(target, "walled", "driving_x")
    np.testing.assert_allclose(found, [-0.5, 0.5], atol=1e-3)
    assert interval.reason is not None and "ends at the bound of the prior" in interval.reason


@pytest.mark.parametrize("probability", [0.68, 0.95])
def test_ends_of_a_fit_are_where_the_constrained_maximum_has_fallen(target, probability):
    """Climbed anew by a simplex that knows no gradient."""
    found = profile(target, "driven_y", probability)
    place = target.names.index("driven_y")
    others = np.delete(np.arange(len(target.centre)), place)
    size = np.sqrt(np.diag(target.covariance))

    def best(value):
        point = target.centre.copy()
        point[place] = value

        def minus(z):
            point[others] = target.centre[others] + size[others] * z
            return -float(target.log_density(point[None])[0])

        options = {"xatol": 1e-3, "fatol": 1e-6, "maxiter": 6000, "adaptive": True}
        start = minimize(minus, np.zeros(len(others)), method="Powell").x
        return -float(minimize(minus, start, method="Nelder-Mead", options=options).fun)

    falls = [2 * (best(found.best) - best(end)) for end in (found.low, found.high)]
    np.testing.assert_allclose(falls, chi2.ppf(probability, 1), atol=2e-3)


def test_all_physical_coordinates_by_name(target):
    found = profiles(target)
    assert tuple(found) == Profiler(target).physical == target.names[:4]
    std = np.sqrt(np.diag(target.covariance))
    for place, one in enumerate(found.values()):
        assert one.half_width == pytest.approx(1.96 * std[place], rel=0.1)


def test_the_prior_takes_part(target):
    """A narrow encoder prior narrows the profile."""
    wide, narrow = (
        profile(fit_target(quick_fits.plain(), Prior(encoder_arcsec=std)), "driven_encoder_x")
        for std in (1e4, 0.5)
    )
    assert narrow.half_width < 0.5 * wide.half_width


def test_wrong_arguments_are_named(target):
    with pytest.raises(ValueError, match="Argument `name` must be one of driving_x"):
        profile(target, "partial_1")
    with pytest.raises(ValueError, match="Argument `probability` must be between 0 and 1"):
        profile(target, "driving_x", 1.0)


@pytest.mark.parametrize("wall", [0.31, 1.1])
def test_both_ends_at_the_bound_are_said_wherever_it_is(target, wall):
    """Both sides of a flat density end there, whether the bound is near or far."""
    changed, _ = made(target, "walled")
    size = np.sqrt(np.diag(target.covariance))
    density = replace(changed.density, inverse=np.diag(0.5 / (wall * size)))
    found = profile(replace(changed, density=density), "driving_x")
    ends = np.array([found.low, found.high], float)
    np.testing.assert_allclose((ends - target.centre[0]) / size[0], [-wall, wall], atol=2e-3)
    assert found.reason == "; ".join(
        f"{side}: ends at the bound of the prior" for side in ("below", "above")
    )
