"""The summary of a sweep, group by group."""

from dataclasses import replace

import numpy as np
import pytest

from tests.control.sweep_files import sweep_spec, table_of
from vttig_jax.control.simulation.case import METRICS

ADVANCING = ("over_compensation_deg", "thrown_back_deg")


def summary(names: np.ndarray, **changed: np.ndarray):
    table = replace(table_of(controller=names), closing=1e-3)
    unknown = np.full(len(names), np.nan)  # numbers of controllers that move the motor: no remark
    table.columns.update(over_compensation_deg=unknown, thrown_back_deg=unknown)
    table.columns.update({k: v for k, v in changed.items() if k not in ADVANCING})
    groups = {group["name"]: group for group in table.to_json()["groups"]}
    lines = {line.split()[0]: line for line in str(table).splitlines() if line}
    return groups, lines


def test_the_motion_lost_tells_a_feedforward_controller_from_none():
    names = np.repeat(["none", "feedforward"], 4)
    groups, lines = summary(
        names,
        residual_gap_deg=np.full(8, 0.05),
        interference_mm=np.zeros(8),
        lost_motion_deg=np.repeat([0.03, 0.002], 4),
    )
    assert groups["feedforward"]["lost_motion_deg"]["mean"] == pytest.approx(0.002)
    assert "0.03000" in lines["none"].split() and "0.00200" in lines["feedforward"].split()


def test_the_share_of_cases_whose_flanks_change_before_the_turn_is_told():
    early, wrong = np.array([0.0, 5e-4, 0.05, 0.06]), np.array([0.0, 0.0, 100.0, 120.0])
    # The margin of 0.01 mm leaves 5.8e-4° open.
    groups, _ = summary(np.repeat(["none"], 4), early_jump_deg=early, wrong_flank_deg=wrong)
    assert groups["none"]["early_share"] == 0.5
    assert groups["none"]["wrong_flank_deg"]["max"] == 120.0


def test_a_listed_axis_has_a_row_for_each_number():
    spec = sweep_spec({"judgement.margin_mm": [0.0, 0.02], "seed": {"from": 0, "to": 3, "num": 4}})
    margins = np.repeat([0.0, 0.02], 4)
    table = table_of(**{"judgement.margin_mm": margins, "seed": np.tile(np.arange(4), 2)})
    table = replace(table, spec=spec)
    groups = table.to_json()["groups"]
    assert [group["name"] for group in groups] == ["margin_mm 0", "margin_mm 0.02"]
    assert [group["cases"] for group in groups] == [4, 4]
    assert [name for name, _ in table.groups()] == ["all"]


def test_refused_cases_take_no_part():
    names = np.repeat(["none", "predictive"], 4)
    refused = np.array([1, 0, 0, 0, 1, 1, 1, 1], bool)
    gone = np.where(refused, np.nan, 1.0)
    groups, lines = summary(
        names,
        **dict.fromkeys(METRICS, 0.01 * gone)
        | {"interference_mm": np.array([0, 1, 0, 0, 0, 0, 0, 0]) * gone},
        outcome=np.where(refused, "refused", "ok"),
    )
    assert groups["none"]["interfering_share"] == pytest.approx(1 / 3)
    assert groups["none"]["cases"] == 3 and groups["none"]["outcomes"] == {"ok": 3, "refused": 1}
    assert groups["predictive"]["interfering_share"] is None
    assert lines["predictive"].split() == ["predictive", "0", *"–––––––––"]


@pytest.mark.parametrize(("of_the_second", "open_"), [((0.0, 0.03), True), ((0.0, 0.0), False)])
def test_a_share_that_differs_from_draw_to_draw_is_said_for_one_machine(of_the_second, open_):
    """Of two draws one never closes too far; the margin that frees both is the larger excess.

    The ends of the interval are shares of draws, not numbers between them.
    """
    table = table_of(draw=np.repeat([0, 1], 2))
    table.columns["interference_mm"] = np.array([0.0, 0.0, *of_the_second])
    remarks = [line for line in str(table).splitlines() if "judgement.margin_mm" in line]
    assert len(remarks) == open_
    share = table.to_json()["groups"][0]["interfering_share_95"]
    assert share == pytest.approx([0.0, 0.5] if open_ else [0.0, 0.0])
    if open_:
        assert "0.0 to 50.0 %" in remarks[0] and "0.030 mm" in remarks[0]
        assert "all 2 draws" in remarks[0]
