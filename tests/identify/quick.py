"""Short, coarsely sampled runs of the paper's rig."""

from dataclasses import replace

from vttig_jax.rig import PassMotion, SyntheticRig, paper_rig

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
