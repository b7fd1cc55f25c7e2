"""Robust weights that end with more residual than those of a model without drift."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.drives import drive
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary import model_selection
from vttig_jax.identify.preliminary.linear_fit import LinearFit
from vttig_jax.identify.preliminary.robust import Reweighted, reweighted
from vttig_jax.identify.preliminary.robust_start import with_second_start
from vttig_jax.logs.encoder_log import EncoderLog

PAIR = drive("1/1")
GAP_DEG = 4.0


def _wild_log() -> EncoderLog:
    """One run in each direction; a third of the driving readings of the second is off by a step."""
    rng = np.random.default_rng(1)
    time = np.arange(2080) * 0.0125
    rpm = np.interp(
        time, [0, 4, 6, 12, 13, 16, 17, 18, 24, 26], [0, 0, 700, 1900, 0, 0, 0, -1900, -1900, 0]
    )
    step = rpm * 0.0125 * 2 * np.pi / 60
    turned = np.cumsum(step)
    noise = 2.5 * rng.standard_normal(len(time)) * np.abs(rpm) / 1900
    driven = turned + np.radians(noise + GAP_DEG * (rpm < 0))
    hit = rng.random(len(time)) < np.where(rpm < 0, 0.32, 0.05)
    driving = turned + np.where(hit, rng.choice([-1, 1], len(time)) * step, 0)
    return EncoderLog.from_arrays(time, driving, driven, pair=PAIR, unit="rad")


@pytest.fixture(scope="module")
def found() -> tuple[Reweighted, LinearFit]:
    """The weights of the log, and the fit with all candidate columns."""
    seen: list[tuple[Reweighted, LinearFit]] = []

    def kept(weights: Reweighted, plain: LinearFit) -> Reweighted:
        seen.append((weights, plain))
        return with_second_start(weights, plain)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_selection, "with_second_start", kept)
        fit(_wild_log(), PAIR)
    return seen[0]


def _scale_deg(weights: Reweighted) -> float:
    return weights.outliers[0].scale_deg


def test_good_weights_stay(found: tuple[Reweighted, LinearFit]):
    weights, plain = found
    assert weights.loss == "bisquare" and plain.model.drift.order > 0
    assert with_second_start(weights, plain) is weights


def test_weights_with_too_much_residual_are_replaced(found: tuple[Reweighted, LinearFit]):
    weights, plain = found
    worse = tuple(replace(one, scale_deg=2 * one.scale_deg) for one in weights.outliers)
    again = with_second_start(replace(weights, outliers=worse), plain)
    assert _scale_deg(again) < 1.05 * _scale_deg(weights)
    assert again.values is not None and again.values[0] is not None
    assert weights.values is not None and weights.values[0] is not None
    assert np.mean(np.abs(again.values[0] - weights.values[0])) < 0.02


def test_other_losses_have_one_optimum(found: tuple[Reweighted, LinearFit]):
    _, plain = found
    weights = reweighted(plain, "huber")
    worse = tuple(replace(one, scale_deg=2 * one.scale_deg) for one in weights.outliers)
    start = replace(weights, outliers=worse)
    assert with_second_start(start, plain) is start
