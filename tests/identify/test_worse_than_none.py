"""A fit that leaves more than offset, drift and flanks alone: fewer orders, then a refusal."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from tests.identify.summaries import looked
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.identify import fitting
from vttig_jax.identify.model.identifiability import find_identifiability
from vttig_jax.identify.report.residual_tests import explained
from vttig_jax.identify.solve.residuals import Weights
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.schema import HarmonicOrders

PAIR = drive("1/2", orders=(1, 3))


@pytest.fixture(scope="module")
def log() -> EncoderLog:
    return drive_log(
        PAIR,
        there_and_back([60], 8),
        gap=level(150.0),
        error=lambda angle, _: 20 * np.sin(angle + 0.3) + 30 * np.sin(angle / 2 + 1),
        noise_arcsec=5.0,
    )


@pytest.fixture(scope="module")
def result(log):
    return fitting.fit(log, PAIR, delay="off", drift_order=0)


def test_explained_is_the_share_of_the_harmonics(result):
    """Two sines of 20″ and 30″, and noise of 5″ of which block means contain a part."""
    block = result.samples["used"] / sum(map(len, result.curves))
    sines = (20**2 + 30**2) / 2
    assert result.checks.explained == pytest.approx(sines / (sines + 5**2 / block), abs=3e-3)
    assert not fitting._is_worse_than_none(result)


def test_wrong_coefficients_explain_less_than_nothing(log):
    """With the opposite harmonics the residual is twice the transmission error."""
    _, linear = looked(log, PAIR)
    layout = linear.summary.columns
    shown = linear.residual_rows
    right = explained(linear, layout, shown)
    opposite: list[Weights] = [
        {flank: np.append(-row[:-1], row[-1]) for flank, row in each.items()} for each in shown
    ]
    wrong = explained(linear, layout, opposite)
    assert known(right) > 0.9
    assert known(wrong) < -2


def test_no_variance_has_no_share(log):
    _, linear = looked(log, PAIR)
    none = replace(linear, rows=tuple(replace(rows, runs=()) for rows in linear.rows))
    assert explained(none, linear.summary.columns, linear.residual_rows) is None


def _with_share(result, share):
    return replace(result, checks=msgspec.structs.replace(result.checks, explained=share))


@pytest.mark.parametrize(("share", "worse"), [(None, False), (0.0, False), (-0.2, True)])
def test_only_a_residual_five_percent_larger_is_worse(result, share, worse):
    assert fitting._is_worse_than_none(_with_share(result, share)) == worse


@pytest.fixture
def shares(monkeypatch, result):
    """Let fits with these shares follow each other; the list of orders that they were asked for."""

    def follow(*values: float) -> list[HarmonicOrders]:
        asked: list[HarmonicOrders] = []

        def identifiability(logs, segments, pair, orders, flank, **options):
            asked.append(orders)
            return find_identifiability(logs, segments, pair, orders, flank, **options)

        def fitted(*_, **__):
            return _with_share(result, values[len(asked) - 1])

        monkeypatch.setattr(fitting, "find_identifiability", identifiability)
        monkeypatch.setattr(fitting, "_fitted", fitted)
        return asked

    return follow


def test_fewer_orders_are_tried_and_told(shares, log):
    asked = shares(-1.0, 0.9)
    found = fitting.fit(log, PAIR)
    assert asked == [PAIR.fit, HarmonicOrders((1,), (1,), 0)]
    assert found.notes[0] == found.warnings[0]
    assert found.notes[0].startswith("higher orders are left out")


def test_a_fit_that_still_says_nothing_is_refused(shares, log):
    asked = shares(-1.0, -1.0)
    with pytest.raises(NoAnswerError, match=r"drift and flanks alone.*record more turns"):
        fitting.fit(log, PAIR)
    assert len(asked) == 2


def test_a_good_fit_is_not_repeated(shares, log):
    asked = shares(0.9)
    found = fitting.fit(log, PAIR)
    assert asked == [PAIR.fit]
    assert not any("higher orders" in note for note in found.notes)


def test_orders_that_were_not_wanted_are_not_tried(shares, log):
    asked = shares(-1.0, 0.9)
    fitting.fit(log, PAIR, orders=HarmonicOrders((2, 3), (1, 2), 0))
    assert asked[1] == HarmonicOrders((), (1,), 0)
