"""A delay between the channels: the plan expects the standard errors of the fit that follows."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from jaxtyping import Float

from vttig_jax.identify import Fit, fit
from vttig_jax.posterior import PlannedNoise, plan
from vttig_jax.posterior.planning.result import Plan
from vttig_jax.rig import PassMotion, SyntheticRig, paper_eccentricities, paper_rig

TURNS, RATE_HZ = 8.0, 700.0
SPEEDS = (ONE := (60.0,)), (60.0, 40.0)
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


def ratios(expected: Plan, found: Fit) -> dict[str, float]:
    """Expected standard errors over those of the fit."""
    told = {name: one.std for name, one in found.parameters.items() if one.determined}
    return {name: expected.std(name) / std for name, std in told.items() if std is not None}


@pytest.mark.parametrize("speeds", SPEEDS)
@pytest.mark.parametrize("choice", ["auto", "off"])
def test_the_promise_is_that_of_the_fit_of_a_simulated_log(speeds, choice):
    rig = rig_of(speeds, 1e-3 if choice == "auto" else 0.0)
    found = fit(rig.log(0), rig.pair, delay=choice, lines="report")
    assert found.parameters["delay_s"].significant == (choice == "auto")
    expected = plan_of(rig, speeds, delay=choice)
    for name, one in found.parameters.items():
        assert expected.parameters[name].determined == one.determined, name
    np.testing.assert_allclose(list(ratios(expected, found).values()), 1.0, rtol=0.3)
    other = plan_of(rig, speeds, delay="off" if choice == "auto" else "auto")
    assert not 0.6 < ratios(other, found)[GAP] < 1.6  # the other promise is wrong


def test_an_assumed_delay_decides_its_words_and_a_given_one_is_a_condition():
    rig = rig_of(ONE, 0.0)
    std = plan_of(rig, ONE).std("delay_s")
    large, small = (
        plan_of(rig, ONE, assumed={"delay_s": k * std}).parameters["delay_s"] for k in (-4.0, 2.0)
    )
    assert large.significant and not small.significant
    assert small.assumed == pytest.approx(2.0 * std)
    given, never = plan_of(rig, ONE, delay=2e-3), plan_of(rig, ONE, delay="off")
    assert given.conditional_on == ("given_delay",) and never.conditional_on == ("no_delay",)
    assert given.std(GAP) == never.std(GAP)
    assert "2 ms" in str(given.parameters["delay_s"].reason)


@pytest.mark.parametrize("speeds", SPEEDS)
def test_ramps_are_named_only_where_they_alone_tell_the_delay(speeds):
    expected = plan_of(rig_of(speeds, 0.0), speeds)
    assert expected.parameters["delay_s"].determined and expected.conditional_on == ()
    said = "only the ramps tell the delay"
    named = [note for note in expected.notes if said in note]
    assert len(named) == (said in str(expected)) == (len(speeds) == 1)
