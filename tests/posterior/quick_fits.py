"""Fits that determine different things: what the sampler and its relatives have to take."""

from dataclasses import replace
from fractions import Fraction
from functools import cache

from tests.identify.quick import quick_rig
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.parameters import undetermined
from vttig_jax.pair.gear_pair import Drive


@cache
def plain() -> Fit:
    """Both flanks, all determined."""
    rig = quick_rig(0)
    return fit(rig.log(0), rig.pair)


@cache
def one_flank() -> Fit:
    """Perfect encoders, no constant backlash."""
    rig = quick_rig(0)
    return fit(rig.log(0), rig.pair, flank="A")


@cache
def short() -> Fit:
    """As if the driven shaft had turned less than once: its eccentricity is not determined."""
    result = one_flank()
    assert result.evidence is not None
    names = tuple(n for n in result.evidence.determined if not n.startswith("driven"))
    parameters = {
        name: undetermined(name, p.unit, "the driven shaft turned too little")
        if name.startswith("driven")
        else p
        for name, p in result.parameters.items()
    }
    evidence = replace(result.evidence, determined=names)
    return replace(result, parameters=parameters, evidence=evidence)


@cache
def drive() -> Fit:
    """No geometry: angles only."""
    rig = quick_rig(0)
    return fit(rig.log(0), Drive(Fraction(9, 16)))


@cache
def perfect_gears() -> Fit:
    """First orders are those of the encoders."""
    rig = quick_rig(0)
    return fit(rig.log(0), rig.pair, perfect_gears=True)


@cache
def two_speeds() -> Fit:
    """A delay told by two speeds, each log with a zero of its own."""
    rigs = [quick_rig(0, 3e-3, speed_rpm=speed) for speed in (60.0, 20.0)]
    logs = [rig.log(seed) for seed, rig in enumerate(rigs)]
    return fit(logs, rigs[0].pair, delay="free", same_zero=False)


@cache
def robust() -> Fit:
    """Outliers weighed down, whether there are any or not."""
    rig = quick_rig(0)
    return fit(rig.log(0), rig.pair, loss="bisquare")
