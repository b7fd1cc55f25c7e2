"""The band of the whole map on rigs whose truth is known, and how it could fail.

A batch of short logs is drawn and fitted once, some twenty seconds: most of it is compilation, and
fewer rigs could not tell a band that holds 92 % from one that holds 70 %.
"""

from dataclasses import replace
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from vttig_jax.posterior.calibration.program import Program
from vttig_jax.posterior.calibration.rigs import Rig, order_terms
from vttig_jax.posterior.calibration.sampled_subset import RigEvidence
from vttig_jax.posterior.calibration.scenarios import SCENARIOS

from benchmarks.band_coverage import Held, drawn_gap, grid, judged, rigs_of, share, true_gap
from vttig_jax.base.units import DEG
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.harmonic import CombinedModel, OrderModel
from vttig_jax.pair.eccentricities import Eccentricities
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.posterior.summary.bands import streamed_band

pytestmark = pytest.mark.slow

RIGS, DRAWS = 64, 300

SCENARIO = replace(
    SCENARIOS["orders"].of_length("short"),
    options=HarmonicOrders(driving_orders=(1, 2, 3), driven_orders=(1, 2, 3), mesh_orders=1),
)


@pytest.fixture(scope="module")
def program() -> Program:
    return Program(SCENARIO)


@pytest.fixture(scope="module")
def rigs(program) -> list:
    [batch] = [found for found in program.batches(RIGS, 5) if not isinstance(found, int)]
    return list(rigs_of(batch))


@pytest.fixture(scope="module")
def angle() -> np.ndarray:
    """Every eleventh degree and a bit: a step that walks through the tooth mesh."""
    return grid(SCENARIO, 11.3)


def judge(
    program: Program, rig: Rig, evidence: RigEvidence, angle: np.ndarray, number: int
) -> Held:
    band = streamed_band(drawn_gap(program, evidence, DRAWS, number).chunks(angle))
    gap = true_gap(program, rig, angle)
    return judged(band, gap, true_gap(program, rig, angle, as_measured=True))


@pytest.fixture(scope="module")
def found(program, rigs, angle) -> list[Held]:
    return [judge(program, rig, own, angle, number) for number, (rig, own) in enumerate(rigs)]


def test_the_band_of_the_whole_map_holds_it(found):
    """53 of 64: with a share of 92 % one seed in a hundred misses it, with 70 % one reaches it.

    Intervals of short logs with these orders hold 93 to 95 %, and so the band about 92 %.
    """
    assert sum(one.simultaneous for one in found) >= 53
    assert sum(one.as_measured for one in found) >= 53


def test_the_pointwise_band_holds_points_and_not_the_map(found):
    assert np.mean([one.share for one in found]) == pytest.approx(0.95, abs=0.04)
    assert sum(one.pointwise for one in found) <= 16


def test_a_band_from_too_small_standard_errors_is_seen_to_fail(program, rigs, angle):
    """Innovations and parameters of half the spread, as if the noise had no memory."""
    held = []
    for number, (rig, evidence) in enumerate(rigs[:16]):
        narrow = replace(
            evidence,
            covariance=evidence.covariance / 4,
            innovation_std=evidence.innovation_std / 2,
        )
        held.append(judge(program, rig, narrow, angle, number).simultaneous)
    assert sum(held) <= 8


def test_a_map_of_another_rig_is_outside(program, rigs, angle):
    held = [
        judge(program, other, evidence, angle, number).simultaneous
        for number, ((_, evidence), (other, _)) in enumerate(pairwise(rigs[:4]))
    ]
    assert not any(held)


def test_the_truth_is_the_gap_of_the_exact_contact(program, rigs, angle):
    rig, _ = rigs[0]
    pair = SCENARIO.pair
    exact = exact_model(
        pair,
        Eccentricities(
            abs(complex(rig.driving)),
            float(np.angle(rig.driving, deg=True)),
            abs(complex(rig.driven)),
            float(np.angle(rig.driven, deg=True)),
            float(rig.constant_backlash) / DEG,
        ),
    )
    ratio = jnp.asarray(float(pair.ratio))
    orders = OrderModel(
        ratio,
        order_terms(SCENARIO),
        jnp.zeros(2),
        jnp.asarray(rig.cosine),
        jnp.asarray(rig.sine),
    )
    contact = CombinedModel(ratio, exact, orders)
    first, second = (
        np.asarray(contact.transmission_error(jnp.asarray(angle), flank)) for flank in ("A", "B")
    )
    np.testing.assert_allclose(true_gap(program, rig, angle), second - first, atol=1e-10)
    seen = true_gap(program, rig, angle, as_measured=True)
    assert 1e-9 < np.abs(seen - (second - first)).max() < 1e-5


def test_shares_have_the_bounds_of_clopper_and_pearson():
    found = share([True] * 17 + [False] * 3)
    assert (found["share"], found["rigs"]) == (0.85, 20)
    assert found["low95"] == pytest.approx(0.6211, abs=1e-4)
    assert found["high95"] == pytest.approx(0.9679, abs=1e-4)
