"""Fits and posteriors of short logs of the paper's rig, as gears and as a drive."""

from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any

from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.posterior.sampler import sample
from vttig_jax.posterior.summary.posterior import Posterior
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

STEPS = 150


def short_rig(seed: int = 0) -> SyntheticRig:
    """The paper's rig on five turns there and back, sampled as coarsely as the mesh allows."""
    rig = paper_rig(seed, PassMotion(reversal_deg=1800.0, dwell_s=0.5))
    return replace(rig, rate_hz=700.0)


@cache
def quick_fit(seed: int = 0, **settings: Any) -> Fit:
    rig = short_rig(seed)
    return fit(rig.log(seed), rig.pair, **settings)


@cache
def drive_fit(seed: int = 0, **settings: Any) -> Fit:
    """No geometry: angles only."""
    return fit(short_rig(seed).log(seed), Drive(Fraction(9, 16)), **settings)


@cache
def quick_posterior(seed: int = 0) -> Posterior:
    return sample(quick_fit(seed), steps=STEPS)
