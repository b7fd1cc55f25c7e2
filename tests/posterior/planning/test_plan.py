"""Plans against bounds by another route, closed forms and simulated fits."""

import json
from typing import Any

import jsonschema
import numpy as np
import pytest
from scipy.linalg import solve, toeplitz

from benchmarks.cramer_rao import cramer_rao
from tests.schemas import load_schema
from vttig_jax.base.files.json_io import dumps
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.pair.gear_pair import Gear, GearPair
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.posterior.planning.noise import PlannedNoise
from vttig_jax.posterior.planning.plan import plan
from vttig_jax.posterior.planning.run import PlannedRun
from vttig_jax.rig.imperfections import Noise
from vttig_jax.rig.paper import paper_eccentricities, paper_pair, paper_rig

PAPER_NOISE = PlannedNoise(0.002, 0.00475)
PAPER_RUN: dict[str, Any] = {"turns": 21.0, "rate_hz": 1987.0, "noise": PAPER_NOISE}
FEW = HarmonicOrders(driving_orders=(1, 2), driven_orders=(1, 2), mesh_orders=0)
WHITE = PlannedNoise(0.003)
WHITE_RUN: dict[str, Any] = {"turns": 32.0, "rate_hz": 500.0, "noise": WHITE, "orders": FEW}
WHITE_RUN["delay"] = "off"


@pytest.fixture(scope="module")
def paper():
    """The run of the paper without a delay, with the encoder phases of its first synthetic rig."""
    rig = paper_rig()
    encoders = {
        f"{shaft}_encoder_phase_deg": getattr(rig, f"{shaft}_encoder").phase_deg
        for shaft in ("driving", "driven")
    }
    return plan(
        paper_pair(),
        **PAPER_RUN,
        eccentricities=paper_eccentricities(),
        assumed=encoders,
        delay="off",
    )


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
    for name, least in bound.items():
        if name == "constant_backlash_deg":  # it also pays for drift and bends over the speed
            assert least < paper.std(name) < 3 * least
        else:
            assert paper.std(name) == pytest.approx(least, rel=0.02), name
    other = plan(
        paper_pair(),
        **dict(PAPER_RUN, noise=PlannedNoise(0.002, 0.01)),
        eccentricities=paper_eccentricities(),
    )
    ratio = other.std("driving_eccentricity_mm") / bound["driving_eccentricity_mm"]
    assert abs(ratio - 1) > 0.1  # twice the memory is another bound


def test_the_plan_speaks_like_a_fit(paper):
    assert paper.outcome == "ok"
    assert paper.conditional_on == ("no_delay",)
    assert paper.flanks == ("A", "B")
    assert paper.samples == 93_390  # those of the rig's own log
    assert paper.used == pytest.approx(85_162, abs=50)
    assert paper.parameters["driving_eccentricity_mm"].assumed == 0.0226
    assert not paper.parameters["delay_s"].determined
    found = plan(paper_pair(), **PAPER_RUN)
    assert found.std("delay_s") == pytest.approx(1.5e-6, rel=0.05)  # as the fit of the log says


def test_std_of_the_eccentricity_is_the_closed_form(white_pair, white_plan):
    # std(e) = σ/(√2 K sin α) with σ of the first order of one flank.
    each = white_plan.used / 2
    sigma = WHITE.std_deg * DEG * np.sqrt(2 / each)
    reference = float(white_pair.base_radii[1, 0])
    alpha = float(white_pair.working_pressure_angles[0])
    expected = sigma * reference / (np.sqrt(2) * np.sin(alpha))
    # What a white rig does not have, drift and differences of the flanks, costs less than a tenth.
    assert 1.0 < white_plan.std("driving_eccentricity_mm") / expected < 1.09
    assert 1.0 < white_plan.std("driven_eccentricity_mm") / expected < 1.09
    gap = WHITE.std_deg * np.sqrt(2 / each)
    assert gap < white_plan.std("constant_backlash_deg") < 2 * gap  # drift costs something
    phase_deg = expected / 0.02 / DEG
    assert 1.0 < white_plan.std("driven_phase_deg") / phase_deg < 1.09


def test_the_price_of_not_trusting_the_encoders(white_pair, white_plan):
    trusted = plan(white_pair, **WHITE_RUN, perfect_encoders=True)
    assert trusted.conditional_on == ("perfect_encoders", "no_delay")
    assert not trusted.parameters["driving_encoder_arcsec"].determined
    for name in ("driving_eccentricity_mm", "driven_eccentricity_mm"):
        price = white_plan.std(name) / trusted.std(name)
        assert price == pytest.approx(1 / np.sin(white_pair.working_pressure_angles[0]), rel=0.02)
        assert round(price, 1) == 2.9
    gap = "constant_backlash_deg"
    assert trusted.std(gap) == pytest.approx(white_plan.std(gap), rel=0.01)  # the map pays nothing


def test_std_falls_with_the_square_root_of_the_turns(white_pair, white_plan):
    longer = plan(white_pair, **dict(WHITE_RUN, turns=128.0))
    steady = np.sqrt(longer.used / white_plan.used)
    assert steady == pytest.approx(2.0, rel=0.01)
    for name, one in white_plan.parameters.items():
        if one.determined and name != "delay_s":  # that is told by the ramps
            assert 1.0 < one.std / longer.std(name) / steady < 1.06, name  # less is drift


def test_one_direction_knows_no_gap_and_trusts_the_encoders(white_pair):
    one = plan(white_pair, **WHITE_RUN, directions="forward")
    assert one.flanks == ("A",)
    assert one.outcome == "partly_determined"
    assert one.conditional_on == ("perfect_encoders", "no_delay")
    gap, encoder = (one.parameters[n] for n in ("constant_backlash_deg", "driven_encoder_arcsec"))
    assert (gap.determined, gap.std) == (False, None)
    assert "one direction" in str(gap.reason)
    assert "one direction" in str(encoder.reason)
    assert one.std("constant_backlash_deg") == np.inf
    # σ = std(F) alone, seen through K only.
    sigma = WHITE.std_deg * DEG * np.sqrt(2 / one.used) * float(white_pair.base_radii[1, 0])
    assert 1.0 < one.std("driving_eccentricity_mm") / sigma < 1.09


def test_eccentricities_are_those_assumed_and_cost_the_phase(paper, white_plan):
    given = paper_eccentricities()
    for shaft in ("driving", "driven"):
        eccentricity, phase = (
            paper.parameters[f"{shaft}_{n}"] for n in ("eccentricity_mm", "phase_deg")
        )
        size = float(getattr(given, f"{shaft}_mm"))
        assert eccentricity.assumed == size
        assert phase.std == pytest.approx(eccentricity.std / size / DEG, rel=0.02)
    assert white_plan.parameters["driving_eccentricity_mm"].assumed == 0.02
    assert white_plan.parameters["driving_encoder_arcsec"].assumed == 10.0
    assert paper.parameters["driving_encoder_arcsec"].assumed == 18.0  # as the pair file says


def simulated_std(pair: GearPair, run: PlannedRun, simulated: Noise, known: PlannedNoise) -> dict:
    """Spread of 400 linear fits with the known covariance, from single samples of noise.

    First orders to parameters by the complex forms e = (F − B)/(2jK sin α), c = (F + B)/2 − e/R.
    """
    size, generator = 10, np.random.default_rng(5)
    turns = run.turns - 2 * run.least_turns / 2
    angle = REV * np.arange(int(turns * run.rate_hz)) / run.rate_hz
    blocks = len(angle) // size
    columns = [np.ones_like(angle)]
    for order in (1.0, 2.0, 9 / 16, 18 / 16):
        columns += [np.sin(order * angle), np.cos(order * angle)]
    mean = lambda rows: rows[..., : blocks * size].reshape(*rows.shape[:-1], blocks, size).mean(-1)  # noqa: E731
    design = mean(np.stack(columns)).T
    covariance = toeplitz(known.autocovariance(size, run.rate_hz, blocks - 1))
    weighted = solve(covariance, design, assume_a="pos")
    estimator = np.linalg.solve(weighted.T @ design, weighted.T)
    fits = []
    for _ in range(400):
        flanks = np.stack([simulated.draw(len(angle), run.rate_hz, generator) for _ in "AB"])
        fits.append(estimator @ mean(flanks).T)
    offset, sine1, cosine1, _, _, sine2, cosine2 = np.array(fits).transpose(1, 2, 0)[:7]
    radius, alpha = float(pair.base_radii[1, 0]), float(pair.working_pressure_angles[0])
    found = {"constant_backlash_deg": (offset[1] - offset[0]).std() / DEG}
    for shaft, first, sign, gain in (
        ("driving", sine1 + 1j * cosine1, 1.0, -9 / 16),
        ("driven", sine2 + 1j * cosine2, -1.0, 1.0),
    ):
        forward, backward = first
        gear = sign * (forward - backward) * radius / (2j * np.sin(alpha))
        encoder = ((forward + backward) / 2 - gear * np.cos(alpha) / radius) / gain / ARCSEC
        # The amplitude moves along the phase, zero by default.
        found[f"{shaft}_eccentricity_mm"] = gear.real.std()
        found[f"{shaft}_phase_deg"] = gear.imag.std() / 0.02 / DEG
        found[f"{shaft}_encoder_arcsec"] = encoder.real.std()
        found[f"{shaft}_encoder_phase_deg"] = encoder.imag.std() / 10.0 / DEG
    return found


def test_the_expected_spread_is_that_of_simulated_fits(white_pair):
    run = PlannedRun(8.0, (60.0,), 500.0)
    known = PlannedNoise(0.002, 0.02)
    found = plan(white_pair, **dict(WHITE_RUN, turns=8.0, noise=known))

    def ratios(simulated: Noise) -> np.ndarray:
        spread = simulated_std(white_pair, run, simulated, known)
        return np.array([value / found.std(name) for name, value in spread.items()])

    good = ratios(Noise(0.002, 0.02))
    assert len(good) == 9
    # The gap also pays for a drift, and all of it for noise that is not known beforehand.
    assert 0.3 < good[0] < 1.0
    np.testing.assert_allclose(good[1:], 0.85, atol=0.15)
    with pytest.raises(AssertionError):  # two and a half times the memory spreads more
        np.testing.assert_allclose(ratios(Noise(0.002, 0.05))[1:], 0.85, atol=0.15)


def test_json_and_text_say_the_same(paper):
    record = json.loads(dumps(paper.to_json()))
    jsonschema.validate(record, load_schema("vttig.plan/1"))
    assert record["duration_s"] == paper.duration_s
    assert record["parameters"]["driving_eccentricity_mm"]["std"] == pytest.approx(
        paper.std("driving_eccentricity_mm")
    )
    text = str(paper)
    for part in ("21 turns a pass", "0.002°, correlated over 4.75 ms", "of counting", "0.00017"):
        assert part in text
