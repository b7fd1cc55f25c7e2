"""The summary of a sweep, group by group."""

import numpy as np
import pytest

from tests.control.sweeps import table_of


def summary(names: np.ndarray, **changed: np.ndarray):
    table = table_of(controller=names)
    table.columns.update(changed)
    groups = {group["name"]: group for group in table.to_json()["groups"]}
    lines = {line.split()[0]: line for line in str(table).splitlines() if line}
    return groups, lines


def test_the_motion_lost_tells_a_feedforward_controller_from_none():
    names = np.repeat(["none", "feedforward"], 4)
    groups, lines = summary(
        names,
        residual_gap_deg=np.full(8, 0.03),
        interference_mm=np.zeros(8),
        lost_motion_deg=np.repeat([0.03, 0.002], 4),
    )
    assert groups["feedforward"]["lost_motion_deg"]["mean"] == pytest.approx(0.002)
    assert lines["none"].endswith("0.03000") and lines["feedforward"].endswith("0.00200")


def test_refused_cases_take_no_part():
    names = np.repeat(["none", "predictive"], 4)
    refused = np.array([1, 0, 0, 0, 1, 1, 1, 1], bool)
    gone = np.where(refused, np.nan, 1.0)
    groups, lines = summary(
        names,
        residual_gap_deg=0.01 * gone,
        interference_mm=np.array([0, 1, 0, 0, 0, 0, 0, 0]) * gone,
        lost_motion_deg=0.02 * gone,
        outcome=np.where(refused, "refused", "ok"),
    )
    assert groups["none"]["interfering_share"] == pytest.approx(1 / 3)
    assert groups["none"]["cases"] == 4 and groups["none"]["outcomes"] == {"ok": 3, "refused": 1}
    assert groups["predictive"]["interfering_share"] is None
    assert lines["predictive"].split() == ["predictive", "4", *"–––––", "–"]
