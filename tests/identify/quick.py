"""Short, coarsely sampled runs of the paper's rig, and how far a fit of one is from the truth."""

from dataclasses import replace

import numpy as np

from vttig_jax.base.angles import difference_deg
from vttig_jax.identify.result import Fit
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

MOTION = PassMotion(reversal_deg=1800.0, dwell_s=0.5)
RATE_HZ = 700.0
"""As coarse as the tooth mesh allows: a fit takes a tenth of a second."""

TRUTH = {
    "driving_eccentricity_mm": 0.0226,
    "driving_phase_deg": 49.5,
    "driven_eccentricity_mm": 0.0273,
    "driven_phase_deg": 79.3,
    "constant_backlash_deg": 0.038,
}


def quick_rig(seed: int, delay_s: float = 0.0, **motion) -> SyntheticRig:
    """The paper's rig on a short run; `motion` changes `MOTION`."""
    rig = paper_rig(seed, replace(MOTION, **motion))
    return replace(rig, rate_hz=RATE_HZ, delay_s=delay_s)


def errors(result: Fit) -> dict[str, float]:
    """Value less truth; infinite without a value."""
    found = {}
    for name, truth in TRUTH.items():
        value = result.parameters[name].value
        if value is None:
            found[name] = np.inf
        elif name.endswith("phase_deg"):
            found[name] = float(difference_deg(value, truth))
        else:
            found[name] = value - truth
    return found


def scores(result: Fit) -> dict[str, float]:
    """Errors in standard errors."""
    return {
        name: error / (result.parameters[name].std or np.nan)
        for name, error in errors(result).items()
    }
