"""Short runs of the paper's rig that many tests look at."""

from dataclasses import replace

import pytest

from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig as make_paper_rig
from vttig_jax.rig.synthetic import SyntheticRig


@pytest.fixture(scope="session")
def noisy_rig() -> SyntheticRig:
    """Five turns forth and back, everything a real rig adds."""
    return make_paper_rig(0, PassMotion(reversal_deg=1800.0))


@pytest.fixture(scope="session")
def noisy_log(noisy_rig) -> EncoderLog:
    return noisy_rig.log(0)


@pytest.fixture(scope="session")
def noisy_fit(noisy_rig, noisy_log) -> Fit:
    return fit(noisy_log, noisy_rig.pair)


@pytest.fixture(scope="session")
def clean_rig(paper_pair, paper_rig) -> SyntheticRig:
    """Two eccentric gears and nothing else, no counts; a little over one hunting period."""
    motion = PassMotion(speed_rpm=180.0, reversal_deg=6600.0, dwell_s=0.5)
    return SyntheticRig(paper_pair, paper_rig, motion, rate_hz=900.0)


@pytest.fixture(scope="session")
def clean_log(clean_rig) -> EncoderLog:
    return clean_rig.log()


@pytest.fixture(scope="session")
def clean_fit(clean_rig, clean_log) -> Fit:
    return fit(clean_log, clean_rig.pair)


@pytest.fixture(scope="session")
def quick_rig() -> SyntheticRig:
    """The noisy rig sampled as coarsely as its tooth mesh allows: fits in a tenth of a second."""
    return replace(make_paper_rig(0, PassMotion(reversal_deg=1800.0, dwell_s=0.5)), rate_hz=700.0)


@pytest.fixture(scope="session")
def quick_log(quick_rig) -> EncoderLog:
    return quick_rig.log(0)


@pytest.fixture(scope="session")
def quick_fit(quick_rig, quick_log) -> Fit:
    return fit(quick_log, quick_rig.pair)
