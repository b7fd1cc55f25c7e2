"""Rigs drawn from a posterior."""

import dataclasses

import numpy as np
import pytest

from tests.posterior import quick_fits
from tests.posterior.made import made_posterior
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.base.units import DEG
from vttig_jax.identify.report.parameters import undetermined
from vttig_jax.posterior.summary.rig_draws import rig_draws


@pytest.fixture(scope="module")
def posterior():
    return made_posterior(quick_fits.plain())


def offsets(rigs, shaft: str) -> np.ndarray:
    return np.array([rig.cartesian[shaft == "driven"] for rig in rigs])


def test_they_scatter_as_the_draws_do_and_go_together(posterior):
    rigs = rig_draws(posterior, 2000)
    for shaft in ("driving", "driven"):
        found = offsets(rigs, shaft)
        expected = posterior.values(f"{shaft}_x") + 1j * posterior.values(f"{shaft}_y")
        assert abs(found.mean() - expected.mean()) < 5 * expected.std() / np.sqrt(2000)
        assert found.std() == pytest.approx(expected.std(), rel=0.1)
    gaps = np.array([float(rig.constant_backlash_deg) for rig in rigs])
    both = np.corrcoef(gaps, np.real(offsets(rigs, "driven")))[0, 1]
    known = np.corrcoef(posterior.values("constant_backlash"), posterior.values("driven_x"))[0, 1]
    std = posterior.parameters["constant_backlash_deg"].std
    assert gaps.std() == pytest.approx(std, rel=0.1)  # with the gap of a delay taken as zero
    share = posterior.values("constant_backlash").std() / DEG / std
    assert both == pytest.approx(known * share, abs=0.1)


def test_none_is_drawn_twice_and_the_seed_chooses(posterior):
    first, again, other = (offsets(rig_draws(posterior, 50, seed), "driving") for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert len(set(first.tolist())) == 50 and not np.array_equal(first, other)


def test_an_eccentricity_that_is_not_known_counts_as_zero(posterior):
    fit = posterior.fit
    name = "driven_eccentricity_mm"
    parameters = fit.parameters | {name: undetermined(name, "mm", "one turn")}
    rigs = rig_draws(
        dataclasses.replace(posterior, fit=dataclasses.replace(fit, parameters=parameters)), 5
    )
    assert {float(rig.driven_mm) for rig in rigs} == {0.0}
    assert min(float(rig.driving_mm) for rig in rigs) > 0


def test_what_cannot_be_drawn_is_said(posterior):
    with pytest.raises(NoAnswerError, match=r"the posterior holds \d+; sample longer"):
        rig_draws(posterior, 10**6)
    fit, name = posterior.fit, "constant_backlash_deg"
    parameters = fit.parameters | {name: undetermined(name, "deg", "one direction")}
    without = dataclasses.replace(fit, parameters=parameters)
    with pytest.raises(NoAnswerError, match="no gap to simulate"):
        rig_draws(dataclasses.replace(posterior, fit=without))
    drive = dataclasses.replace(fit, pair=quick_fits.drive().pair)
    with pytest.raises(NoAnswerError, match="no eccentricities"):
        rig_draws(dataclasses.replace(posterior, fit=drive))
