"""Fits and posteriors of short logs of the paper's rig, as gears and as a drive."""

from fractions import Fraction
from functools import cache
from typing import Any

from tests.identify.quick import quick_rig
from vttig_jax.identify import Fit, fit
from vttig_jax.pair import Drive
from vttig_jax.posterior import Posterior, sample


@cache
def quick_fit(seed: int = 0, **settings: Any) -> Fit:
    rig = quick_rig(seed)
    return fit(rig.log(seed), rig.pair, **settings)


@cache
def drive_fit(seed: int = 0, **settings: Any) -> Fit:
    """No geometry: angles only."""
    return fit(quick_rig(seed).log(seed), Drive(Fraction(9, 16)), **settings)


@cache
def quick_posterior(seed: int = 0) -> Posterior:
    return sample(quick_fit(seed), steps=150)
