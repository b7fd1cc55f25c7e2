"""A delay between the channels: the plan expects the standard errors of the fit that follows."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from jaxtyping import Float

from vttig_jax.identify import Fit, fit
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
@pytest.mark.parametrize("choice", ["auto", "off"])
def test_the_promise_is_that_of_the_fit_of_a_simulated_log(motion, choice):
    speeds = SPEEDS[motion]
    rig = rig_of(speeds, 1e-3 if choice == "auto" else 0.0)
    found = fit(rig.log(0), rig.pair, delay=choice, lines="report")
    assert found.parameters["delay_s"].significant == (choice == "auto")
    expected = plan_of(rig, speeds, delay=choice)
    np.testing.assert_allclose(list(ratios(expected, found).values()), 1.0, rtol=0.3)
    other = plan_of(rig, speeds, delay="off" if choice == "auto" else "auto")
    assert not 0.6 < of_gap(other, found) < 1.6  # the other promise is wrong


def test_an_assumed_delay_decides_what_it_will_be_called():
    speeds = SPEEDS["one speed both ways"]
    rig = rig_of(speeds, 0.0)
    std = plan_of(rig, speeds).std("delay_s")
    large, small = (plan_of(rig, speeds, assumed={"delay_s": k * std}) for k in (-4.0, 2.0))
    assert large.parameters["delay_s"].significant and not small.parameters["delay_s"].significant
    assert small.parameters["delay_s"].assumed == pytest.approx(2.0 * std)


def test_a_given_delay_is_a_condition():
    speeds = SPEEDS["one speed both ways"]
    rig = rig_of(speeds, 0.0)
    given, never = plan_of(rig, speeds, delay=2e-3), plan_of(rig, speeds, delay="off")
    assert given.conditional_on == ("given_delay",) and never.conditional_on == ("no_delay",)
    assert given.std(GAP) == never.std(GAP)
    assert "2 ms" in str(given.parameters["delay_s"].reason)


@pytest.mark.parametrize("motion", SPEEDS)
def test_ramps_are_named_only_where_they_alone_tell_the_delay(motion):
    speeds = SPEEDS[motion]
    expected = plan_of(rig_of(speeds, 0.0), speeds)
    assert expected.parameters["delay_s"].determined
    named = [note for note in expected.notes if "only the ramps tell the delay" in note]
    assert len(named) == (1 if len(speeds) == 1 else 0)
    assert ("only the ramps tell the delay" in str(expected)) is (len(speeds) == 1)
