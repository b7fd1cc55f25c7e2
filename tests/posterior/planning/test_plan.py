"""Plans against bounds by another route and closed forms."""

import json
from typing import Any

import jsonschema
import numpy as np
import pytest

from benchmarks.cramer_rao import cramer_rao
from tests.schemas import load_schema
from vttig_jax.base import DEG
from vttig_jax.base.files.json_io import dumps
from vttig_jax.pair import Gear, GearPair, HarmonicOrders
from vttig_jax.posterior import PlannedNoise, plan
from vttig_jax.rig import paper_eccentricities, paper_pair, paper_rig

PAPER_RUN: dict[str, Any] = {"turns": 21.0, "rate_hz": 1987.0}
PAPER_NOISE = PlannedNoise(0.002, 0.00475)
WHITE = PlannedNoise(0.003)
WHITE_RUN: dict[str, Any] = {
    "turns": 32.0,
    "rate_hz": 500.0,
    "noise": WHITE,
    "orders": HarmonicOrders((1, 2), (1, 2), 0),
    "delay": "off",
}
ECCENTRICITIES = ("driving_eccentricity_mm", "driven_eccentricity_mm")
GAP = "constant_backlash_deg"


@pytest.fixture(scope="module")
def paper():
    """The run of the paper without a delay, with the encoder phases of its first synthetic rig."""
    rig = paper_rig()
    encoders = {
        f"{shaft}_encoder_phase_deg": getattr(rig, f"{shaft}_encoder").phase_deg
        for shaft in ("driving", "driven")
    }
    known: dict[str, Any] = {"eccentricities": paper_eccentricities(), "assumed": encoders}
    return plan(paper_pair(), **PAPER_RUN, noise=PAPER_NOISE, **known, delay="off")


@pytest.fixture(scope="module")
def white_pair():
    """The paper's gears without encoders, so that all noise is what the test says."""
    return GearPair(
        Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    )


@pytest.fixture(scope="module")
def white_plan(white_pair):
    """Few orders, white noise, both directions, both channels sampled at the same instant."""
    return plan(white_pair, **WHITE_RUN)


def test_the_plan_of_the_paper_is_the_cramer_rao_bound(paper):
    bound = cramer_rao(paper_rig(), np.zeros(1))
    bound.pop("map_rms_deg")
    assert len(bound) == 9
    # The gap also pays for drift and bends over the speed.
    assert bound[GAP] < paper.std(GAP) < 3 * bound.pop(GAP)
    for name, least in bound.items():
        assert paper.std(name) == pytest.approx(least, rel=0.02), name
    twice, known = PlannedNoise(0.002, 0.01), paper_eccentricities()
    other = plan(paper_pair(), **PAPER_RUN, noise=twice, eccentricities=known)
    ratio = other.std(ECCENTRICITIES[0]) / bound[ECCENTRICITIES[0]]
    assert abs(ratio - 1) > 0.1  # twice the memory is another bound


def test_the_plan_speaks_like_a_fit(paper, white_plan):
    assert paper.outcome == "ok"
    assert paper.conditional_on == ("no_delay",) and paper.flanks == ("A", "B")
    assert paper.samples == 93_390  # those of the rig's own log
    assert paper.used == pytest.approx(85_162, abs=50)
    assert not paper.parameters["delay_s"].determined
    found = plan(paper_pair(), **PAPER_RUN, noise=PAPER_NOISE)
    assert found.std("delay_s") == pytest.approx(1.5e-6, rel=0.05)  # as the fit of the log says
    for shaft in ("driving", "driven"):
        eccentricity, phase = (
            paper.parameters[f"{shaft}_{n}"] for n in ("eccentricity_mm", "phase_deg")
        )
        size = float(getattr(paper_eccentricities(), f"{shaft}_mm"))
        assert eccentricity.assumed == size
        assert phase.std == pytest.approx(eccentricity.std / size / DEG, rel=0.02)
    assert white_plan.parameters[ECCENTRICITIES[0]].assumed == 0.02
    assert white_plan.parameters["driving_encoder_arcsec"].assumed == 10.0
    assert paper.parameters["driving_encoder_arcsec"].assumed == 18.0  # as the pair file says
    record = json.loads(dumps(paper.to_json()))
    jsonschema.validate(record, load_schema("vttig.plan/1"))
    assert record["duration_s"] == paper.duration_s
    std = record["parameters"][ECCENTRICITIES[0]]["std"]
    assert std == pytest.approx(paper.std(ECCENTRICITIES[0]))
    text = str(paper)
    for part in ("21 turns a pass", "0.002°, correlated over 4.75 ms", "of counting", "0.00017"):
        assert part in text


def test_std_is_the_closed_form_and_falls_with_the_square_root_of_the_turns(white_pair, white_plan):
    """std(e) = σ/(√2 K sin α) with σ of the first order of one flank."""
    sigma = WHITE.std_deg * np.sqrt(2 / (white_plan.used / 2))
    alpha = float(white_pair.working_pressure_angles[0])
    expected = sigma * DEG * float(white_pair.base_radii[1, 0]) / (np.sqrt(2) * np.sin(alpha))
    # What a white rig does not have, drift and differences of the flanks, costs less than a tenth.
    for name in ECCENTRICITIES:
        assert 1.0 < white_plan.std(name) / expected < 1.09
    assert sigma < white_plan.std(GAP) < 2 * sigma  # drift costs something
    assert 1.0 < white_plan.std("driven_phase_deg") / (expected / 0.02 / DEG) < 1.09
    longer = plan(white_pair, **dict(WHITE_RUN, turns=128.0))
    steady = np.sqrt(longer.used / white_plan.used)
    assert steady == pytest.approx(2.0, rel=0.01)
    for name, one in white_plan.parameters.items():
        if one.determined and name != "delay_s":  # that is told by the ramps
            assert 1.0 < one.std / longer.std(name) / steady < 1.06, name  # less is drift


def test_the_price_of_not_trusting_the_encoders_which_one_direction_must(white_pair, white_plan):
    trusted = plan(white_pair, **WHITE_RUN, perfect_encoders=True)
    assert trusted.conditional_on == ("perfect_encoders", "no_delay")
    assert not trusted.parameters["driving_encoder_arcsec"].determined
    for name in ECCENTRICITIES:
        price = white_plan.std(name) / trusted.std(name)
        assert price == pytest.approx(1 / np.sin(white_pair.working_pressure_angles[0]), rel=0.02)
    assert trusted.std(GAP) == pytest.approx(white_plan.std(GAP), rel=0.01)  # the map pays nothing
    one = plan(white_pair, **WHITE_RUN, directions="forward")
    assert one.flanks == ("A",) and one.outcome == "partly_determined"
    assert one.conditional_on == ("perfect_encoders", "no_delay")
    gap, encoder = (one.parameters[n] for n in (GAP, "driven_encoder_arcsec"))
    assert (gap.determined, gap.std, one.std(GAP)) == (False, None, np.inf)
    assert "one direction" in str(gap.reason) and "one direction" in str(encoder.reason)
    # σ = std(F) alone, seen through K only.
    sigma = WHITE.std_deg * DEG * np.sqrt(2 / one.used) * float(white_pair.base_radii[1, 0])
    assert 1.0 < one.std(ECCENTRICITIES[0]) / sigma < 1.09
