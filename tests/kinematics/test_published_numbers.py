"""The numbers of physics.md §3 and §6 on the rig of the paper's Tables 1 and 2."""

from dataclasses import replace

import numpy as np
import pytest

from vttig_jax.kinematics.functions import (
    backlash,
    exact_backlash,
    exact_transmission_error,
    transmission_error,
)

HUNTING = np.radians(np.arange(0.0, 5760.0, 0.5))


@pytest.fixture(scope="module")
def tight(paper_rig):
    return replace(paper_rig, constant_backlash_deg=0.0)


@pytest.mark.parametrize("flank", ["A", "B"])
@pytest.mark.parametrize(("angle", "error_deg"), [("reference", 1.2e-4), ("working", 1.9e-5)])
def test_closed_form_against_exact(paper_pair, tight, flank, angle, error_deg):
    closed = transmission_error(HUNTING, paper_pair, tight, flank, pressure_angle=angle)
    apart = np.degrees(closed - exact_transmission_error(HUNTING, paper_pair, tight, flank))
    assert np.abs(apart - apart.mean()).max() == pytest.approx(error_deg, rel=0.1)


@pytest.mark.parametrize(("angle", "error_deg"), [("reference", 2.2e-4), ("working", 3.6e-5)])
def test_closed_backlash_against_exact(paper_pair, tight, angle, error_deg):
    closed = backlash(HUNTING, paper_pair, tight, pressure_angle=angle)
    apart = np.degrees(closed - exact_backlash(HUNTING, paper_pair, tight))
    assert np.abs(apart - apart.mean()).max() == pytest.approx(error_deg, rel=0.1)
