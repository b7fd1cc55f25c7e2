"""A delay between the channels: the plan expects the standard errors of the fit that follows."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from jaxtyping import Float

from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.posterior.planning.noise import PlannedNoise
from vttig_jax.posterior.planning.plan import plan
from vttig_jax.posterior.planning.result import Plan
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_eccentricities, paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

TURNS, RATE_HZ = 8.0, 700.0
SPEEDS = {"one speed both ways": (60.0,), "two speeds": (60.0, 40.0)}
GAP = "constant_backlash_deg"


@dataclass(frozen=True)
class TwoMotions(PassMotion):
    """A motion, and behind it a second one that starts where the first ends: at zero."""

    second: PassMotion | None = None

    @property
    def duration_s(self) -> float:
        return super().duration_s + (self.second.duration_s if self.second else 0.0)

    def driving_angle(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        first = PassMotion(self.speed_rpm, self.reversal_deg)
        angle = first.driving_angle(time)
        return angle + (self.second.driving_angle(time - first.duration_s) if self.second else 0.0)


def rig_of(speeds_rpm: tuple[float, ...], delay_s: float) -> SyntheticRig:
    """The paper's rig in the planned run."""
    first, *others = (PassMotion(speed, 360.0 * TURNS) for speed in speeds_rpm)
    second = others[0] if others else None
    motion = TwoMotions(first.speed_rpm, first.reversal_deg, second=second)
    return replace(paper_rig(0), motion=motion, rate_hz=RATE_HZ, delay_s=delay_s)


def plan_of(rig: SyntheticRig, speeds_rpm: tuple[float, ...], **changes) -> Plan:
    phases = {
        f"{shaft}_encoder_phase_deg": getattr(rig, f"{shaft}_encoder").phase_deg
        for shaft in ("driving", "driven")
    }
    changes["assumed"] = phases | changes.get("assumed", {})
    return plan(
        rig.pair,
        turns=TURNS,
        rate_hz=RATE_HZ,
        noise=PlannedNoise(rig.noise.std_deg, rig.noise.correlation_s),
        speed_rpm=speeds_rpm,
        eccentricities=paper_eccentricities(),
        **changes,
    )


def ratios(expected: Plan, found: Fit) -> Mapping[str, float]:
    """Expected standard errors over those of the fit."""
    assert {n for n, p in expected.parameters.items() if p.determined} == {
        n for n, p in found.parameters.items() if p.determined
    }
    return {
        name: expected.std(name) / p.std
        for name, p in found.parameters.items()
        if p.std is not None
    }


def of_gap(expected: Plan, found: Fit) -> float:
    return expected.std(GAP) / (found.parameters[GAP].std or np.nan)


@pytest.mark.parametrize("motion", SPEEDS)
@pytest.mark.parametrize("delay_s", [1e-3, 0.0])
def test_the_promise_is_that_of_the_fit_of_a_simulated_log(motion, delay_s):
    """With a delay the plan counts it unasked; without one plan and fit are told so."""
    speeds = SPEEDS[motion]
    rig = rig_of(speeds, delay_s)
    choice, wrong = ("auto", "off") if delay_s else ("off", "free")
    found = fit(rig.log(0), rig.pair, delay=choice)
    assert found.parameters["delay_s"].significant == (delay_s > 0)
    expected = plan_of(rig, speeds, delay=choice)
    np.testing.assert_allclose(list(ratios(expected, found).values()), 1.0, rtol=0.2)
    other = plan_of(rig, speeds, delay=wrong)
    assert not 0.5 < of_gap(other, found) < 2.0  # the other promise is wrong


@pytest.mark.parametrize("motion", SPEEDS)
def test_a_fit_that_takes_a_delay_as_zero_pays_for_it(motion):
    """The standard error varies with the estimate of the delay, so that its rms is promised."""
    speeds = SPEEDS[motion]
    rig = rig_of(speeds, 0.0)
    found = [fit(rig.log(seed), rig.pair).parameters[GAP].std or np.nan for seed in range(6)]
    expected = plan_of(rig, speeds, assumed={"delay_s": 0.0}).std(GAP)
    assert 0.6 < np.sqrt(np.mean(np.square(found))) / expected < 1.5
    assert max(found) > 1.2 * min(found)


def test_an_assumed_delay_is_fitted_if_the_fit_can_find_it():
    speeds = SPEEDS["one speed both ways"]
    rig = rig_of(speeds, 0.0)
    unknown = plan_of(rig, speeds)
    std = unknown.std("delay_s")
    large, small = (plan_of(rig, speeds, assumed={"delay_s": k * std}) for k in (-4.1, 3.9))
    assert large.std(GAP) == unknown.std(GAP)
    assert small.std(GAP) == pytest.approx(np.hypot(3.9, np.sqrt(2)) * unknown.std(GAP), rel=0.1)
    assert large.parameters["delay_s"].significant and not small.parameters["delay_s"].significant
    assert small.parameters["delay_s"].assumed == pytest.approx(3.9 * std)
    assert "below 4 standard errors" in str(small.parameters["delay_s"].reason)
    forced = plan_of(rig, speeds, assumed={"delay_s": 0.0}, delay="free")
    assert forced.std(GAP) == unknown.std(GAP)


def test_a_given_delay_is_a_condition():
    speeds = SPEEDS["one speed both ways"]
    rig = rig_of(speeds, 0.0)
    given, never = plan_of(rig, speeds, delay=2e-3), plan_of(rig, speeds, delay="off")
    assert given.conditional_on == ("given_delay",) and never.conditional_on == ()
    assert given.std(GAP) == never.std(GAP)
    assert "0.002 s" in str(given.parameters["delay_s"].reason)


@pytest.mark.parametrize("motion", SPEEDS)
def test_ramps_are_named_only_where_they_alone_tell_the_delay(motion):
    speeds = SPEEDS[motion]
    expected = plan_of(rig_of(speeds, 0.0), speeds)
    assert expected.parameters["delay_s"].determined
    named = [note for note in expected.notes if "only the ramps tell the delay" in note]
    assert len(named) == (1 if len(speeds) == 1 else 0)
    assert ("only the ramps tell the delay" in str(expected)) is (len(speeds) == 1)
