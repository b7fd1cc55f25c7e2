"""The prior in words and numbers."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest

from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.posterior.density.prior import OPTIONS, Prior, state_prior
from vttig_jax.rig.paper import paper_pair

pytestmark = pytest.mark.smoke

PAIR = paper_pair()
GEARS = ("driving_x", "driving_y", "driven_x", "driven_y")
ENCODERS = ("driving_encoder_x", "driving_encoder_y")


def test_eccentricities_are_flat_up_to_half_the_module():
    found = state_prior(Prior(), PAIR, GEARS, 0.0)
    assert [disc.coordinates for disc in found.discs] == [GEARS[:2], GEARS[2:]]
    assert {disc.bound for disc in found.discs} == {0.5 * float(PAIR.module_mm)}
    assert not any(disc.flat_in_amplitude for disc in found.discs)
    assert found.sentences[0] == "driving eccentricity: flat in the plane up to 1 mm"


def test_flat_in_amplitude_is_said():
    found = state_prior(Prior(flat_in="amplitude", eccentricity_mm=0.2), PAIR, GEARS, 0.0)
    assert all(disc.flat_in_amplitude and disc.bound == 0.2 for disc in found.discs)
    assert found.sentences[1] == "driven eccentricity: flat in its amplitude up to 0.2 mm"


def test_encoders_are_normal_by_their_accuracy():
    accuracy = PAIR.driving.encoder.accuracy_arcsec
    assert accuracy is not None
    found = state_prior(Prior(), PAIR, ENCODERS, 0.0).discs[0]
    assert found.std == pytest.approx(accuracy * ARCSEC) and found.bound == np.inf
    own = state_prior(Prior(encoder_arcsec=5.0), PAIR, ENCODERS, 0.0)
    assert own.discs[0].std == pytest.approx(5 * ARCSEC)
    assert own.sentences[0] == "driving encoder: normal, 5″ in each component"


def test_encoders_without_accuracy_are_flat():
    bare = Drive(Fraction(9, 16))
    found = state_prior(Prior(amplitude_arcsec=90.0), bare, ENCODERS, 0.0)
    assert found.discs[0].bound == pytest.approx(90 * ARCSEC) and found.discs[0].std == np.inf
    assert "no accuracy given" in found.sentences[0]


def test_both_first_orders_of_a_drive_have_a_bound():
    """The part common to both flanks, and the one that differs between them."""
    names = ("driven_x", "driven_y", "driven_x_difference", "driven_y_difference")
    found = state_prior(Prior(amplitude_arcsec=60.0), Drive(Fraction(9, 16)), names, 0.0)
    assert [disc.coordinates for disc in found.discs] == [names[:2], names[2:]]
    assert [disc.bound for disc in found.discs] == pytest.approx([60 * ARCSEC] * 2)
    assert found.sentences[1] == "driven difference first order: flat in the plane up to 60″"


def test_backlash_and_delay_are_bounded():
    found = state_prior(Prior(backlash_deg=2.0), PAIR, ("constant_backlash", "delay"), -0.25)
    assert found.bounds == {"constant_backlash": pytest.approx(2 * DEG), "delay": 1.25}
    assert found.sentences[0] == "constant backlash: flat within ±2°"
    assert found.sentences[1].startswith("delay: flat within")


def test_what_is_not_sampled_is_not_stated():
    found = state_prior(Prior(), PAIR, ("driven_x", "driven_y"), 0.0)
    assert [disc.name for disc in found.discs] == ["driven"] and not found.bounds
    assert found.sentences[-1].startswith("noise: flat")


def test_every_field_has_an_option_and_an_effect_somewhere():
    assert set(OPTIONS) == {field.name for field in dataclasses.fields(Prior)}
    names = (*GEARS, *ENCODERS, "constant_backlash")
    gears = state_prior(Prior(), PAIR, names, 0.0).fields
    assert gears == {"eccentricity_mm", "flat_in", "encoder_arcsec", "backlash_deg"}
    drive = state_prior(Prior(), Drive(Fraction(9, 16)), GEARS, 0.0).fields
    assert drive == {"amplitude_arcsec", "flat_in"}
    assert state_prior(Prior(), PAIR, ENCODERS, 0.0).fields == {"encoder_arcsec"}
    assert gears | drive == set(OPTIONS)


@pytest.mark.parametrize("name", ["eccentricity_mm", "encoder_arcsec", "backlash_deg"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_sizes_are_positive(name, value):
    with pytest.raises(ValueError, match=f"Argument `{name}` must be positive"):
        Prior(**{name: value})


@pytest.mark.usefixtures("unchecked")
def test_flatness_is_one_of_two():
    with pytest.raises(ValueError, match="Argument `flat_in` must be"):
        Prior(flat_in="line")  # pyright: ignore
