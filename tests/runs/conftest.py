"""A short run of the paper's rig, fitted once."""

from dataclasses import replace

import pytest

from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig


@pytest.fixture(scope="session")
def quick_fit() -> Fit:
    """Five turns forth and back, sampled as coarsely as the tooth mesh allows."""
    rig = replace(paper_rig(0, PassMotion(reversal_deg=1800.0, dwell_s=0.5)), rate_hz=700.0)
    return fit(rig.log(0), rig.pair)
