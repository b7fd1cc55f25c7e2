"""Short simulated logs of the paper's rig and their fits, which many tests share."""

import pytest

from vttig_jax.identify import Fit, fit
from vttig_jax.logs import EncoderLog
from vttig_jax.rig import PassMotion, SyntheticRig
from vttig_jax.rig.paper import paper_rig as make_paper_rig


@pytest.fixture(scope="session")
def noisy_rig() -> SyntheticRig:
    """Rig with five turns forward and back, and with all errors and noise of a real rig."""
    return make_paper_rig(0, PassMotion(reversal_deg=1800.0))


@pytest.fixture(scope="session")
def noisy_log(noisy_rig) -> EncoderLog:
    return noisy_rig.log(0)


@pytest.fixture(scope="session")
def noisy_fit(noisy_rig, noisy_log) -> Fit:
    return fit(noisy_log, noisy_rig.pair)


@pytest.fixture(scope="session")
def clean_rig(paper_pair, paper_rig) -> SyntheticRig:
    """Rig with the eccentricities as its only errors, and without encoder steps.

    Its motion covers a little more than one hunting period.
    """
    motion = PassMotion(speed_rpm=180.0, reversal_deg=6600.0, dwell_s=0.5)
    return SyntheticRig(paper_pair, paper_rig, motion, rate_hz=900.0)


@pytest.fixture(scope="session")
def clean_fit(clean_rig) -> Fit:
    return fit(clean_rig.log(), clean_rig.pair)
