"""A short simulated log of the paper's rig, and its fit, which the tests share."""

from dataclasses import replace

import pytest

from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig


@pytest.fixture(scope="session")
def quick_rig() -> SyntheticRig:
    """Rig with five turns forward and back, at the lowest sampling rate that its mesh allows."""
    return replace(paper_rig(0, PassMotion(reversal_deg=1800.0, dwell_s=0.5)), rate_hz=700.0)


@pytest.fixture(scope="session")
def quick_fit(quick_rig) -> Fit:
    return fit(quick_rig.log(0), quick_rig.pair)
