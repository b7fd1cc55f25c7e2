"""A log of two eccentric shafts with neither backlash nor delay: none may be reported."""

import numpy as np
import pytest

from vttig_jax.base.units import DEG
from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import ERN180, paper_pair

RATE = 500.0
COUNTS = ERN180.counts_per_rev / 360 if ERN180.counts_per_rev else 0.0
KINDS = ["angles", "noise", "noisy counts"]


def _log(kind: str, gap_deg: float = 0.0, seed: int = 0) -> EncoderLog:
    """Nineteen reversals; the same transmission error both ways but for `gap_deg`."""
    motion = PassMotion(reversal_deg=1200.0, dwell_s=0.2, ramp_s=0.2, passes=20)
    time = np.arange(int(motion.duration_s * RATE) + 1) / RATE
    driving = motion.driving_angle(time)
    driven = 45 / 80 * driving
    driven = driven + 3e-4 * np.sin(driving + 0.5) + 2e-4 * np.sin(45 / 80 * driving + 1.0)
    backward = np.gradient(driving) < 0
    driven = driven + np.where(backward, gap_deg * DEG, 0.0)
    if kind.startswith("nois"):
        driven = driven + 2e-5 * np.random.default_rng(seed).standard_normal(len(time))
    angles = [(angle - angle[0]) / DEG for angle in (driving, driven)]
    if "counts" in kind:
        counts = [np.floor(angle * COUNTS).astype(np.int64) for angle in angles]
        return EncoderLog.from_arrays(time, *counts, pair=paper_pair())
    return EncoderLog.from_arrays(time, *angles, pair=paper_pair(), unit="deg")


SURE = "without noise, an error of 1e-6° of the model is told as a gap"
EXACT = pytest.param("angles", 0, marks=pytest.mark.xfail(reason=SURE, strict=True))


@pytest.mark.portable
@pytest.mark.parametrize(
    ("kind", "seed"), [EXACT, ("noise", 0), *(("noisy counts", seed) for seed in range(3))]
)
def test_no_gap_is_reported_where_there_is_none(kind, seed):
    result = fit(_log(kind, seed=seed), paper_pair())
    for name in ("constant_backlash_deg", "delay_s"):
        parameter = result.parameters[name]
        assert parameter.determined and not parameter.significant, name
    gap = result.parameters["constant_backlash_deg"]
    assert abs(gap.value or 0.0) < 2e-4
    assert "drift" not in {one.slug for one in result.findings}
    assert len(result.checks.reversals) == 19


@pytest.mark.parametrize("kind", KINDS)
def test_a_gap_below_a_count_would_be(kind):
    """A count is 0.004°."""
    gap = fit(_log(kind, 3e-3), paper_pair()).parameters["constant_backlash_deg"]
    assert gap.significant
    assert gap.value == pytest.approx(3e-3, abs=max(4 * (gap.std or 0.0), 1e-6))
