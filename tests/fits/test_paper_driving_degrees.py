"""Table 3 of the paper in degrees of the driving gear: what this reading explains."""

import math
from types import ModuleType

import numpy as np
import pytest

from tests.oracles.flank_formulas import Pair, exact
from tests.test_fits import FITS, script

TURNS = (1080, 3600, 7560, 7524)


@pytest.fixture(scope="module")
def driving() -> ModuleType:
    return script("paper/driving_degrees")


@pytest.fixture(scope="module")
def prose() -> str:
    text = (FITS / "paper" / "README.md").read_text(encoding="utf-8")
    section = text.split("## Table 3 in degrees of the driving gear")[1].split("\n## ")[0]
    return " ".join(section.split("<!-- driving degrees: end -->")[1].split())


def by_hand(turn_deg: int) -> np.ndarray:
    """φ₁ − φ₂ z₂/z₁ of flank A in degrees by (19) with the working pressure angle.

    The base radius of the driving gear, 45 cos 20°, stands in place of that of the driven gear.
    """
    working = math.acos(125 * math.cos(math.radians(20.0)) / 125.12)
    angle = np.radians(np.arange(0.0, turn_deg, 0.5))
    first = 0.0226 * np.sin(angle + np.radians(49.5) + working)
    second = 0.0273 * np.sin(angle * 45 / 80 + np.radians(79.3) - working)
    error = -np.degrees(first + second) / (45 * math.cos(math.radians(20.0)))
    return error - error[0]


def test_flank_a_by_hand(driving):
    for turn in TURNS:
        error, found = by_hand(turn), driving.flank_a(turn)
        own = {"mean": error.mean(), "max": error.max(), "min": error.min(), "range": np.ptp(error)}
        assert {name: found[name] for name in own} == pytest.approx(own, abs=4e-5)
        assert found["place"] == pytest.approx((own["mean"] - own["min"]) / own["range"], abs=1e-3)
    assert by_hand(7560).max() == pytest.approx(0.0719 * 80 / 45, abs=1e-4)
    assert driving.range_bound() / driving.RATIO == pytest.approx(0.1352, abs=5e-5)


def test_four_maxima_follow_and_nothing_else(driving: ModuleType):
    found = {str(row): driving.explained(row) for row in driving.rows()}
    assert len(found) == 16
    assert {name: columns for name, columns in found.items() if columns} == {
        f"{speed} rpm, simulation, {control} control": ["max"]
        for speed in (60, 100)
        for control in ("with", "without")
    }


def test_a_row_that_follows_is_seen(driving: ModuleType):
    row, own = driving.rows()[0], driving.flank_a(1080)
    margin = driving.rounding(1080)
    for off, columns in ((0.0, ["mean", "max", "min"]), (1.1, [])):
        values = {
            name: own[name] + off * (margin[name] + driving.HALF_A_DIGIT_DEG)
            for name in driving.COLUMNS
        }
        other = driving.Row(row.speed_rpm, 1080, row.source, row.control, values)
        assert driving.explained(other) == columns


def test_rounding_is_that_of_table_2(driving: ModuleType):
    """At most what ± half a digit allows: 2(δe₁ + δe₂)/r_b1 and 2(e₁ + e₂) δθ/r_b1."""
    radius = 45 * math.cos(math.radians(20.0))
    most = 2 * math.degrees(1e-4 + 0.0499 * math.radians(0.05)) / radius
    for turn in TURNS:
        assert all(0 < value < most for value in driving.rounding(turn).values())
    assert driving.rounding(7560)["max"] == pytest.approx(0.00028, abs=5e-6)


def test_ranges(driving: ModuleType):
    bound = driving.range_bound() / driving.RATIO
    beyond = [row for row in driving.rows() if row.values["range"] > bound]
    assert len(beyond) == 12 and all(row.speed_rpm > 10 for row in beyond)
    there_and_back = [
        driving.read(driving.run_statistics(turn, rig)["A and B"])
        for turn in TURNS
        for rig in (driving.RIG, driving.driving_rig())
    ]
    spans = sorted(values["range"] for values in there_and_back)
    assert (spans[0], spans[-1]) == pytest.approx((0.1495, 0.2025), abs=5e-5)
    lowest = min(row.values["min"] for row in driving.rows())
    assert max(values["min"] for values in there_and_back) < lowest == -0.0213


def test_place_of_the_mean_depends_on_neither_unit_nor_zero(driving: ModuleType):
    values = driving.rows()[5].values
    other = {name: 3.0 * values[name] + 0.1 for name in ("mean", "max", "min")}
    other["range"] = other["max"] - other["min"]
    assert driving.place(other) == pytest.approx(values["place"], abs=1e-12)
    mirrored = driving.read(values)
    assert mirrored["place"] == pytest.approx(1 - values["place"], abs=1e-12)
    fast = [row.values["place"] for row in driving.rows() if row.speed_rpm > 10]
    assert min(fast) > 0.34 and max(fast) < 0.405
    for turn in TURNS[1:]:
        for part in driving.run_statistics(turn).values():
            assert driving.read(part)["place"] == pytest.approx(0.5, abs=0.004)
    assert driving.flank_a(1080)["place"] == pytest.approx(0.54, abs=0.005)


def test_backlash_column(driving: ModuleType):
    """With the eccentricities of Table 2 by the common tangent, in plain Python."""
    lower, upper = exact(Pair(constant_backlash=0.0))
    angle = np.radians(np.arange(0.0, 5760.0, 4.0))
    variable = np.array([math.degrees(upper(a)[0] - lower(a)[0]) for a in angle])
    closed = []
    for run in driving.PRINTED["table_3"]:
        for source, turn in run["reversal_deg"].items():
            found = driving.gap(turn, run["backlash_deg"][source])
            assert found.driven == pytest.approx(run["backlash_deg"][source] * 45 / 80)
            at = math.radians(turn)
            own = found.driven - math.degrees(upper(at)[0] - lower(at)[0])
            assert found.constant == pytest.approx(own, abs=1e-6)
            assert found.smallest == pytest.approx(own + variable.min(), abs=2e-6)
            assert found.closed == pytest.approx(np.mean(own + variable < 0), abs=0.005)
            closed.append(found.closed)
    assert sum(share > 0 for share in closed) == 7
    shares = sorted(closed)
    assert (shares[1], shares[-1]) == pytest.approx((0.02, 0.23), abs=0.005)
    assert float(driving.driving_rig().constant_backlash_deg) == pytest.approx(0.0186, abs=5e-5)


def test_prose_has_the_numbers(driving: ModuleType, prose: str):
    rows = driving.rows()
    wide = {name: [row.values[name] * driving.RATIO for row in rows] for name in ("max", "min")}
    assert f"−{max(wide['max']):.4f}° … +{-min(wide['min']):.4f}° at most" in prose
    jumps = {
        source: [run["backlash_deg"][source] for run in driving.PRINTED["table_3"][:2]]
        for source in ("experiment", "simulation")
    }
    spans = [f"{(last - first) * driving.RATIO:.4f}°" for first, last in jumps.values()]
    assert " and ".join(spans) in prose
    assert f"the 0.0443° of Table 3 would be a jump of {0.0443 / driving.RATIO:.4f}°" in prose
    back = [driving.run_statistics(turn)["A and B"]["max"] for turn in TURNS]
    assert f"reaches +{min(back):.4f}° to +{max(back):.4f}°" in prose
    forth = driving.run_statistics(7560)["A"]
    assert f"−{-forth['min']:.4f}° … +{forth['max']:.4f}°" in prose
    off = [
        abs(row.values["max"] - driving.flank_a(row.reversal_deg)["max"])
        for row in rows
        if row.source == "experiment"
    ]
    assert f"off by {min(off):.4f}° to {max(off):.4f}°" in prose
