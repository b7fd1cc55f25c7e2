"""From fits of every kind to their posteriors."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from tests.identify.quick import quick_rig
from tests.posterior.made import drive_fit, quick_fit, quick_posterior
from vttig_jax.base import InputError
from vttig_jax.identify import Fit, fit
from vttig_jax.pair import HarmonicOrders
from vttig_jax.posterior import read_posterior, sample
from vttig_jax.posterior.sampler import settings_of

RIG = quick_rig(0)

DIFFERENT: dict[str, Callable[[], Fit]] = {
    "one flank": lambda: quick_fit(flank="A"),
    "a drive": drive_fit,
    "perfect encoders": lambda: quick_fit(perfect_encoders=True),
    "perfect gears": lambda: quick_fit(perfect_gears=True),
    "a known delay": lambda: quick_fit(delay="off"),
    "two logs": lambda: fit([RIG.log(0), RIG.log(1)], RIG.pair, same_zero=False),
    "fractional orders": lambda: drive_fit(
        orders=HarmonicOrders((*range(1, 9), 23 / 64), tuple(range(1, 9)), 0)
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", DIFFERENT)
def test_what_is_determined_is_sampled(kind):
    """Words, numbers, and a spread that is the fit's."""
    result = DIFFERENT[kind]()
    found = sample(result, steps=200)
    assert list(found.parameters) == list(result.parameters)
    for name, known in result.parameters.items():
        drawn = found.parameters[name]
        assert (drawn.determined, drawn.unit) == (known.determined, known.unit)
        if not known.determined:
            assert drawn.value is None and drawn.reason == known.reason
    assert str(found) and found.to_json()["draws"]["ensembles"] == 4
    # Perfect gears and perfect encoders are wrong models of this rig.
    if not kind.startswith("perfect"):
        places = [result.covariance_names.index(name) for name in found.physical]
        known = np.sqrt(np.diag(result.covariance))[places]
        drawn = np.array([found.values(name).std() for name in found.physical])
        assert (np.abs(np.log(drawn / known)) < np.log(1.4)).all(), drawn / known


def test_values_and_intervals_are_those_of_the_fit():
    """The posterior of this log is nearly normal, so that Laplace and Student quantiles hold."""
    found, result = quick_posterior(), quick_fit()
    for name, known in result.parameters.items():
        drawn = found.parameters[name]
        if known.std is None or known.low95 is None or drawn.low95 is None:
            continue
        assert drawn.value == pytest.approx(known.value, abs=0.2 * known.std), name
        assert drawn.low95 == pytest.approx(known.low95, abs=0.3 * known.std), name
        assert drawn.high95 == pytest.approx(known.high95, abs=0.3 * known.std), name


def test_draws_belong_to_their_fit_and_have_its_flank_model(tmp_path):
    """A checkpoint is read back as it was written, and refused for another fit."""
    result, place = drive_fit(), tmp_path / "chains.h5"
    found = sample(result, steps=50, checkpoint=place, seed=3, walkers=34)
    read = read_posterior(place, result)
    np.testing.assert_array_equal(found.draws, read.draws)
    np.testing.assert_array_equal(found.cosine, read.cosine)
    assert read.seed == 3
    other_seed = sample(result, steps=50, walkers=34)
    assert not np.array_equal(other_seed.draws, read.draws)
    assert settings_of(place) == {"seed": 3, "ensembles": 4, "walkers": 34}
    for other in (drive_fit(1), quick_fit()):
        with pytest.raises(InputError):
            read_posterior(place, other)
        with pytest.raises(InputError):
            sample(other, checkpoint=place, resume=True, steps=50, seed=3, walkers=34)
    place = list(found.fit.model.terms).index((1, 0))
    common = 0.5 * (found.sine[:, 0, place] + found.sine[:, 1, place])
    np.testing.assert_allclose(common, found.values("driving_x"), rtol=1e-6, atol=1e-12)
    mean, several = found.model(slice(None)), found.model(np.array([3, 5]))
    assert mean.offset.shape == (len(found.flat), 2) and several.offset.shape == (2, 2)
    gap = several.offset[:, 1] - several.offset[:, 0]
    np.testing.assert_allclose(gap, found.values("constant_backlash")[[3, 5]], atol=1e-12)


class Wavy(eqx.Module):
    """Two waves of the driving shaft and a gap, in rad."""

    gap: Array
    wave: Array

    def transmission_error(self, angle: Array, flank: str) -> Array:
        side = -0.5 if flank == "A" else 0.5
        return side * self.gap + self.wave[0] * jnp.sin(angle) + self.wave[1] * jnp.cos(angle)


@pytest.mark.slow
@pytest.mark.parametrize("orders", [HarmonicOrders((2, 3), (1, 2, 3), 0), None], ids=str)
def test_a_flank_model_of_the_user_is_sampled(orders):
    start = Wavy(jnp.asarray(0.0), jnp.zeros(2))
    result = fit(RIG.log(0), RIG.pair, model=start, orders=orders, lines="report")
    found = sample(result, steps=100)
    told = [name for name, one in result.parameters.items() if one.determined]
    assert "model.wave[0]" in told
    for name in told:
        drawn, known = found.parameters[name], result.parameters[name]
        assert known.std is not None
        assert drawn.value == pytest.approx(known.value, abs=0.3 * known.std), name
        assert drawn.std == pytest.approx(known.std, rel=0.4), name
    assert str(found) and found.to_json()["smallest_gap"] is None
