"""Gap that resembles a delay which the fit takes as zero."""

import msgspec
import numpy as np
import pytest

from vttig_jax.base.units import DEG
from vttig_jax.identify.report.gap_of_delay import GapOfDelay, allowing_for
from vttig_jax.identify.report.parameters import interval_of, undetermined

GAP = "constant_backlash_deg"
NORMAL, BOUNDED = GapOfDelay(0.3, bounded=False), GapOfDelay(0.3, bounded=True)


@pytest.mark.parametrize("of_delay", [NORMAL, BOUNDED])
@pytest.mark.parametrize("gap_deg", [1.0, 0.1])
def test_the_interval_contains_both_errors(of_delay, gap_deg):
    gap = of_delay.widened(interval_of(GAP, "deg", gap_deg, 0.1))
    half = np.hypot(0.196, 0.3)
    assert gap.value == gap_deg
    assert gap.std == pytest.approx(
        np.hypot(0.1, 0.3 / (np.sqrt(3) if of_delay.bounded else 1.96)), rel=1e-4
    )
    assert gap.high95 == pytest.approx(gap_deg + half, rel=1e-4)
    low = max(gap_deg - half, 0.0) if of_delay.bounded else gap_deg - half
    assert gap.low95 == pytest.approx(low, rel=1e-4)
    assert gap.significant is (gap_deg == 1.0)
    assert gap.significant or of_delay.bounded or "taken as zero" in (gap.reason or "")


def test_a_gap_without_value_stays_undetermined():
    gap = undetermined(GAP, "deg", "one direction")
    assert NORMAL.widened(gap) is gap
    parameters = {
        GAP: interval_of(GAP, "deg", 1.0, 0.1),
        "delay_s": undetermined("delay_s", "s", ""),
    }
    assert allowing_for(None, parameters) == parameters
    wider = allowing_for(NORMAL, parameters)
    assert (wider[GAP].std or 0.0) > 0.1 and wider["delay_s"] is parameters["delay_s"]


def test_draws_have_the_stated_spread_and_their_seed():
    gap = np.full(40_000, 0.2 * DEG)
    normal, bounded = NORMAL.draws(gap, 1), BOUNDED.draws(gap, 1)
    assert normal.std() / DEG == pytest.approx(NORMAL.std_deg, rel=0.02)
    assert np.quantile(normal, 0.975) / DEG == pytest.approx(0.3, rel=0.03)
    assert bounded.min() / DEG == pytest.approx(-0.2) and 0.299 < bounded.max() / DEG <= 0.3
    assert np.mean(bounded < -0.1999 * DEG) == pytest.approx(1 / 6, rel=0.03)
    assert np.median(bounded) / DEG == pytest.approx(0.0, abs=0.01)
    np.testing.assert_array_equal(normal, NORMAL.draws(gap, 1))
    assert not np.array_equal(normal, NORMAL.draws(gap, 2))


def test_its_json_is_its_fields():
    assert NORMAL.to_json() == {"half_width_deg": 0.3, "bounded": False}
    assert msgspec.convert(BOUNDED.to_json(), GapOfDelay) == BOUNDED
