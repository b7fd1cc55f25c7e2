"""The second sampler, against emcee on the same density."""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.posterior import quick_fits
from vttig_jax.base.errors import UsageError
from vttig_jax.posterior.density.density import fit_target
from vttig_jax.posterior.nuts import NutsDiagnosis, sample_nuts, whitened_of
from vttig_jax.posterior.sampler import sample
from vttig_jax.posterior.sampling.stop_rule import Until
from vttig_jax.posterior.summary.posterior import Posterior

pytestmark = pytest.mark.slow

pytest.importorskip("blackjax")


@pytest.fixture(scope="module")
def found() -> Posterior:
    return sample_nuts(quick_fits.one_flank(), draws=300, warmup=150)


def test_both_samplers_agree_within_their_error(found):
    """Means and spreads of all coordinates, noise too."""
    other = sample(quick_fits.one_flank(), steps=1500)
    assert found.names == other.names
    share = np.sqrt(1 / found.diagnosis.effective + 1 / other.diagnosis.effective)
    spread = other.flat.std(axis=0)
    shift = (found.flat.mean(axis=0) - other.flat.mean(axis=0)) / spread
    assert (np.abs(shift) < 4 * share).all(), shift / share
    widths = np.log(found.flat.std(axis=0) / spread)
    assert (np.abs(widths) < 4 * share).all(), widths / share


def test_a_chain_is_an_ensemble_of_one(found):
    assert found.draws.shape[:3] == (4, 300, 1)
    assert found.log_density.shape == (4, 300, 1)
    record = found.to_json()
    assert record["diagnosis"]["sampler"] == "nuts" and "resume" not in str(found.diagnosis)
    target = fit_target(quick_fits.one_flank())
    np.testing.assert_allclose(
        found.log_density[1, :8, 0], target.log_density(found.draws[1, :8, 0]), rtol=1e-12
    )


def test_the_whitened_density_has_the_jacobian_of_its_coordinates():
    """Log-determinant of dx/dy, by automatic differentiation."""
    target = fit_target(quick_fits.one_flank())
    whitened = whitened_of(target)
    points = np.random.default_rng(0).standard_normal((3, len(target.names)))
    value = eqx.filter_jit(lambda y: jax.vmap(whitened)(y))
    place = eqx.filter_jit(lambda y: jax.vmap(whitened.point)(y))
    jacobian = eqx.filter_jit(lambda y: jax.vmap(jax.jacobian(whitened.point))(y))
    density = target.log_density(np.asarray(place(jnp.asarray(points))))
    volumes = np.linalg.slogdet(np.asarray(jacobian(jnp.asarray(points))))[1]
    difference = np.asarray(value(jnp.asarray(points))) - density - volumes
    np.testing.assert_allclose(difference, difference[0], atol=1e-7)


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(UsageError, match=r"pip install `vttig-jax\[nuts\]`"):
        sample_nuts(quick_fits.one_flank())


@pytest.mark.parametrize(
    "options", [{"chains": 3}, {"draws": 7}, {"warmup": 10}, {"acceptance": 1.0}]
)
def test_wrong_arguments_are_named(options):
    with pytest.raises(ValueError, match=f"Argument `{next(iter(options))}` must be"):
        sample_nuts(quick_fits.one_flank(), **options)


def test_a_divergence_is_not_converged():
    settings = {
        "names": ("x",),
        "tau": np.ones(1),
        "shortest": 300.0,
        "r_hat": np.ones(1),
        "acceptance": 0.9,
        "effective": np.full(1, 1200.0),
        "steps": 300,
        "until": Until(),
    }
    assert NutsDiagnosis(**settings).converged
    found = NutsDiagnosis(**settings, divergences=2)
    assert not found.converged and str(found).endswith("; 2 trajectories diverged")
    assert "raise `acceptance`" in str(found) and found.to_json()["divergences"] == 2
