"""A gap of two speeds whose levels rounding moves: its interval contains that."""

import numpy as np
import pytest

from tests.identify.drives import drive
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.posterior.planning.plan import DelayChoice

COUNTS, TURNS, SECONDS, GAP_DEG = 20_000, 8, 0.002, 0.06
PAIR = drive("9/16")


def fitted(seed: int, advances: tuple[float, ...], delay: DelayChoice = "auto") -> Fit:
    """Runs forth and back with these counts of the driving shaft per sample."""
    generator, place, parts, senses = np.random.default_rng(seed), 0.0, [], []
    for advance in advances:
        for sense in (1, -1):
            samples = int(TURNS * COUNTS / advance)
            run = place + sense * advance * np.arange(1, samples + 1) + generator.uniform(-3, 3)
            parts.append(run)
            senses.append(np.full(samples, sense))
            place = run[-1]
    driving, sense = np.concatenate(parts) * 360 / COUNTS, np.concatenate(senses)
    error = 0.012 * np.sin(np.radians(driving) + 1) + 0.009 * np.sin(np.radians(driving) * 9 / 16)
    driven = driving * 9 / 16 + error + np.where(sense > 0, 0.0, GAP_DEG)
    step = 360 / COUNTS
    log = EncoderLog.from_arrays(
        SECONDS * np.arange(len(driving)),
        step * np.rint(driving / step),
        step * np.rint(driven / step),
        pair=PAIR,
        unit="deg",
    )
    return fit(log, PAIR, delay=delay)


def said(result: Fit) -> bool:
    return any("the rounding of the readings" in one for one in result.warnings)


def test_the_interval_contains_frozen_levels():
    """Alone, the noise model gave less than a tenth of the distances from the truth."""
    off, stds = [], []
    for seed in range(6):
        result = fitted(seed, (60.0, 40.0))
        gap = result.checks.gap_over_angles_covered
        assert said(result) and gap.value is not None and gap.std is not None
        assert result.parameters["constant_backlash_deg"].std == pytest.approx(gap.std, rel=0.1)
        off.append(gap.value - GAP_DEG)
        stds.append(gap.std)
    step = 360 / COUNTS * 9 / 16 / np.sqrt(12)
    assert np.mean(stds) == pytest.approx(step * np.sqrt(2) * np.hypot(3, 2), rel=0.2)
    assert 0.4 < np.sqrt(np.mean(np.square(off))) / np.mean(stds) < 1.6


def test_levels_that_average_out_are_not_widened():
    for seed in range(2):
        result = fitted(seed, (60.83, 40.57), "off")
        gap = result.checks.gap_over_angles_covered
        assert not said(result) and gap.value is not None and gap.std is not None
        assert abs(gap.value - GAP_DEG) < 4 * gap.std < 1e-3
