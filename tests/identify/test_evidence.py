"""The compressed logs of a fit come back from arrays as they were."""

from dataclasses import fields, replace

import numpy as np
import pytest

from tests.identify.summaries import lag_products_of
from tests.posterior import quick_fits
from vttig_jax.identify.evidence import Evidence, evidence_from
from vttig_jax.posterior.density.density import fit_target


def again(evidence: Evidence) -> Evidence:
    return evidence_from(evidence.to_arrays(), evidence.summary.terms.ratio)


@pytest.mark.parametrize("make", [quick_fits.plain, quick_fits.two_speeds, quick_fits.one_flank])
def test_arrays_hold_all_of_it(make):
    result = make()
    evidence = result.evidence
    assert evidence is not None
    found = again(evidence)
    for field in fields(Evidence):
        if field.name != "summary":
            own, other = getattr(evidence, field.name), getattr(found, field.name)
            np.testing.assert_array_equal(own, other, err_msg=field.name)
    assert found.summary.columns == evidence.summary.columns
    assert found.summary.terms.free == evidence.summary.terms.free
    assert found.summary.terms.tied == evidence.summary.terms.tied
    assert found.summary.block_s == evidence.summary.block_s
    for own, other in zip(evidence.summary.flanks, found.summary.flanks, strict=True):
        assert own.flank == other.flank and own.rows == other.rows
        for part in ("triangle", "lag_products", "heads", "tails"):
            np.testing.assert_array_equal(getattr(own, part), getattr(other, part))
    assert found.relation(result.pair).names == result.covariance_names


@pytest.mark.parametrize("make", [quick_fits.plain, quick_fits.two_speeds])
def test_folders_that_hold_products_of_the_rows_are_read(make):
    """Half the digits are gone with the products; what is left is far below a standard error."""
    result = make()
    evidence = result.evidence
    assert evidence is not None
    arrays = evidence.to_arrays()
    for flank in evidence.summary.flanks:
        name = f"{flank.flank}_"
        arrays[name + "lag_products"] = lag_products_of(flank)
        for ends in ("heads", "tails"):
            arrays[name + ends] = arrays[name + ends] @ flank.triangle
        del arrays[name + "triangle"]
    found = evidence_from(arrays, evidence.summary.terms.ratio)
    target, read = (fit_target(replace(result, evidence=one)) for one in (evidence, found))
    points = target.starts(8, np.random.default_rng(0))
    here, there = target.log_density(points), read.log_density(points)
    np.testing.assert_allclose(here - here[0], there - there[0], atol=1e-4)
    assert np.ptp(here) > 1.0


def test_arrays_are_numbers_and_text_only():
    evidence = quick_fits.plain().evidence
    assert evidence is not None
    assert {array.dtype.kind for array in evidence.to_arrays().values()} <= set("fiubU")


def test_the_density_is_the_same_afterwards():
    result = quick_fits.plain()
    assert result.evidence is not None
    target = fit_target(result)
    read = fit_target(replace(result, evidence=again(result.evidence)))
    points = target.starts(8, np.random.default_rng(0))
    np.testing.assert_array_equal(target.log_density(points), read.log_density(points))
