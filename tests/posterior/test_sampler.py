"""From fits of every kind to their posteriors."""

import numpy as np
import pytest

from tests.posterior import quick_fits
from vttig_jax.base.errors import InputError
from vttig_jax.posterior.density.density import fit_target
from vttig_jax.posterior.density.prior import Prior
from vttig_jax.posterior.sampler import read_posterior, sample

STEPS = 400
DIFFERENT = {
    "one flank": quick_fits.one_flank,
    "a shaft that turned too little": quick_fits.short,
    "a drive": quick_fits.drive,
    "perfect gears": quick_fits.perfect_gears,
    "a delay and two zeros": quick_fits.two_speeds,
    "a robust loss": quick_fits.robust,
}


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind in ("one flank", "a drive") else pytest.mark.slow)
        for kind in DIFFERENT
    ],
)
def test_what_is_determined_is_sampled(kind):
    """Words, numbers, and a spread that is the fit's."""
    result = DIFFERENT[kind]()
    found = sample(result, steps=STEPS)
    target = fit_target(result)
    assert found.names == target.names and np.isfinite(found.log_density).all()
    assert set(found.parameters) == set(result.parameters)
    for name, known in result.parameters.items():
        assert found.parameters[name].determined == known.determined
        if not known.determined:
            assert found.parameters[name].value is None
            assert found.parameters[name].reason == known.reason
    assert str(found) and found.to_json()["draws"]["ensembles"] == 4
    # Perfect gears are a wrong model: its residual is no noise whose parameters are nearly normal.
    if kind != "perfect gears":
        ratio = found.flat.std(axis=0) / np.sqrt(np.diag(target.covariance))
        physical = len(found.physical)
        assert (np.abs(np.log(ratio[:physical])) < np.log(1.4)).all(), ratio


def test_draws_belong_to_their_fit(tmp_path):
    """A checkpoint is read back as it was written, and refused for another fit or prior."""
    result, place = quick_fits.one_flank(), tmp_path / "chains.h5"
    prior = Prior(eccentricity_mm=0.5)
    made = sample(result, prior=prior, steps=200, checkpoint=place, seed=3)
    read = read_posterior(place, result)
    np.testing.assert_array_equal(made.draws, read.draws)
    np.testing.assert_array_equal(made.cosine, read.cosine)
    assert read.prior == made.prior and read.seed == 3
    without = read_posterior(place, result, model_draws=0)
    np.testing.assert_array_equal(without.draws, made.draws)
    assert without.cosine.shape == (0, *made.cosine.shape[1:]) and len(made.cosine) > 0
    with pytest.raises(InputError, match="belong to another fit"):
        read_posterior(place, quick_fits.short())


def test_equal_seeds_give_equal_draws():
    result = quick_fits.one_flank()
    first, again, other = (sample(result, steps=200, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.draws, again.draws)
    assert not np.array_equal(first.draws, other.draws)


def test_coefficients_follow_the_draws():
    """Drawn first orders are those of the drawn parameters, not of the fit."""
    result = quick_fits.drive()
    found = sample(result, steps=STEPS)
    assert result.evidence is not None
    terms = result.evidence.summary.terms
    place = [harmonic.term for harmonic in terms.free + terms.tied].index((1, 0))
    common = 0.5 * (found.sine[:, 0, place] + found.sine[:, 1, place])
    drawn = found.values("driving_x")[found.chosen]
    np.testing.assert_allclose(common, drawn, rtol=1e-6, atol=1e-12)
