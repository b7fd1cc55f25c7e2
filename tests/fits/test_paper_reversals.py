"""The paper's reversals: what its controller misses, computed apart from any simulation."""

import importlib
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import vttig_jax
from tests.oracles.flank_formulas import exact
from vttig_jax.control.scenario.spec import parse_scenario_spec
from vttig_jax.rig.paper import paper_eccentricities
from vttig_jax.rig.paper import paper_pair as paper_gears

PAPER = Path(__file__).resolve().parents[2] / "fits" / "paper"
SCRIPTS = ("reversals", "experiments", "compare", "reversal_pictures", "judged_picture")

PER_MM = math.degrees(2 * math.tan(math.radians(3.0)) / 80.0)
"""Backlash in degrees that a mm closes, (16): both flanks 3°, R₂ = 80 mm."""
MARGIN = 0.01 * PER_MM

RUNS = [(10, 1080), (30, 3600), (60, 7560), (100, 7560), (100, 7524)]
EACH = pytest.mark.parametrize("place", range(len(RUNS)), ids=[f"{s}-{a}" for s, a in RUNS])


@pytest.fixture(scope="module")
def reversals() -> Iterator[ModuleType]:
    """The script `fits/paper/reversals.py`; its runs of 10 s in all are shared by the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(PAPER))
        yield importlib.import_module("reversals")
    for name in SCRIPTS:
        sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def readme() -> str:
    return (PAPER / "README.md").read_text(encoding="utf-8")


def gap(driving_deg: float) -> float:
    """Backlash in degrees, from the common tangent of both base circles in plain Python."""
    lower, upper = (wall(math.radians(driving_deg))[0] for wall in exact())
    return math.degrees(upper - lower)


def braked(speed_rpm: float, after_s: float, ramp_s: float = 0.5) -> float:
    """Driving angle from a time after braking to the standstill, degrees: 6 n (T − t)²/2T."""
    return 6.0 * speed_rpm * (ramp_s - after_s) ** 2 / (2 * ramp_s)


def test_runs_are_those_of_the_paper(reversals: ModuleType):
    runs = reversals.experiments()
    assert [(run.speed_rpm, run.reversal_deg) for run in runs] == RUNS
    assert [run.figure for run in runs] == [17, 18, 19, 20, 16]
    both = ("experiment", "simulation")
    assert [run.printed for run in runs] == [both, both, both, both[:1], both[1:]]


def test_scenario_is_tables_1_and_2_and_else_the_defaults(reversals: ModuleType):
    assert vttig_jax.load_pair(PAPER / "pair.toml") == paper_gears()
    rig = reversals.SCENARIO.eccentricities
    table_2 = paper_eccentricities()
    named = {name: float(getattr(table_2, name)) for name in rig.__struct_fields__}
    assert {name: getattr(rig, name) for name in named} == named
    bare = parse_scenario_spec({"pair": "pair.toml", "eccentricities": named})
    assert bare == reversals.SCENARIO


@EACH
def test_closes_where_the_motion_says(reversals: ModuleType, place: int):
    """The detected angle from the delay alone: constant deceleration, at rest at the turn."""
    speed, turn = RUNS[place]
    run = reversals.experiments()[place]
    for controller in ("acceleration", "predictive"):
        delay = reversals.number(run, controller, "detection_delay_s")
        assert 0 < delay < (0.03 if controller == "acceleration" else 0.25)
        expected = turn - braked(speed, delay)
        assert reversals.number(run, controller, "detection_deg") == pytest.approx(
            expected, abs=1e-6
        )


@EACH
def test_what_the_paper_controller_misses(reversals: ModuleType, place: int):
    """left = max(0, j(turn) − j(detected) + m), over = max(0, j(detected) − m − j)."""
    speed, turn = RUNS[place]
    run = reversals.experiments()[place]
    ahead = braked(speed, reversals.number(run, "acceleration", "detection_delay_s"))
    closed = gap(turn - ahead) - MARGIN
    way = min(gap(turn - share * ahead) for share in np.linspace(1.0, 0.0, 400))
    left, over = max(gap(turn) - closed, 0.0), max(closed - way, 0.0) / PER_MM
    # The controller reads whole counts of 0.004° of the driving angle.
    assert reversals.number(run, "acceleration", "residual_gap_deg") == pytest.approx(
        left, abs=3e-6
    )
    assert reversals.number(run, "acceleration", "interference_mm") == pytest.approx(over, abs=5e-5)
    missed = reversals.missed(np.array([float(turn)]), ahead)
    assert missed.left_deg[0] == pytest.approx(left, abs=1e-9)
    assert missed.over_mm[0] == pytest.approx(max(closed - gap(turn), 0.0) / PER_MM, abs=1e-9)
    assert missed.over_on_the_way_mm[0] == pytest.approx(over, abs=2e-5)


@EACH
def test_what_the_predictive_controller_leaves(reversals: ModuleType, place: int):
    run = reversals.experiments()[place]
    left = reversals.number(run, "predictive", "residual_gap_deg")
    assert left == pytest.approx(MARGIN, abs=3e-6)
    assert left < 0.05 * reversals.number(run, "none", "residual_gap_deg")
    assert reversals.number(run, "predictive", "interference_mm") < 1e-4


def test_without_control_the_gap_is_crossed_where_the_shafts_part(reversals: ModuleType):
    """At 100 rpm the ramp asks for more torque than friction has: the gap is crossed in braking."""
    for run in reversals.experiments():
        asked = 0.01 * 0.5625 * run.speed_rpm * math.tau / 60 / 0.5
        assert (asked > 0.1) == (run.speed_rpm == 100) and asked < reversals.HIGH_DRAG_NM
        met = reversals.simulated(run, "none").to_json()["crossing_deg"]
        jump = reversals.number(run, "none", "jump_deg")
        assert jump == pytest.approx(gap(met), abs=1e-6)
        assert (run.reversal_deg - met > 100.0) == (asked > 0.1)
        if asked > 0.1:
            slower = reversals.simulated(run, "none", reversals.HIGH_DRAG_NM).to_json()
            assert 0 <= run.reversal_deg - slower["crossing_deg"] < 0.2


def test_turns_all_over_the_hunting_period(reversals: ModuleType):
    turns = np.arange(0.0, 5760.0, 12.0)
    ahead = braked(60, 0.008)
    closed = np.array([gap(turn - ahead) for turn in turns]) - MARGIN
    beyond = closed - np.array([gap(turn) for turn in turns])
    found = reversals.missed(turns, ahead, 5)
    np.testing.assert_allclose(found.left_deg, np.maximum(-beyond, 0.0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.over_mm, np.maximum(beyond, 0.0) / PER_MM, rtol=0, atol=1e-9)
    assert 0.45 < np.mean(beyond > 0) < 0.52  # half of them, less for the margin
    assert (-beyond).max() == pytest.approx(0.029, abs=5e-4)


def test_table_3_is_out_of_reach(reversals: ModuleType):
    """The largest range Table 2 allows, the largest gap and two counts: less than all but one."""
    most = 2 * math.degrees((0.0226 + 0.0273) / (80 * math.cos(math.radians(20.0))))
    for run in reversals.experiments():
        for controller in reversals.CONTROLLERS:
            mean, high, low = (
                reversals.number(run, controller, f"te_{name}_deg")
                for name in ("mean", "max", "min")
            )
            assert high - low < 0.1253 and high - low < most + 0.0642 and mean < -0.009


# README.md

COUNT = 0.0063
"""A count of both encoders in TE, degrees: what rounding decides at a standstill on a count."""

ALLOWED = {
    "mean": 6e-4,
    "max": COUNT,
    "min": COUNT,
    "range": 2 * COUNT,
    "as read": 2 * COUNT,
    "backlash": 1e-4,
    "met at [°]": 0.1,
    "closes at [°]": 0.5,
    "before the turn [°]": 0.5,
    "delay [ms]": 8.0,
}
"""Heading of a column → what its numbers may differ by; those of counts differ by counts."""


def cells(tables: str) -> Iterator[tuple[str, str, str]]:
    """(row, heading, cell) of all text tables; what is no table has no heading."""
    headings = [""]
    for line in tables.splitlines():
        row = re.split(r"\s{2,}", line)
        if line.startswith("  "):
            headings = row
        for heading, cell in zip(headings, row, strict=False):
            yield row[0], heading, cell


def changes(shown: str, fresh: str) -> list[str]:
    """Cells of the tables that differ by more than rounding decides."""
    found = []
    for (row, heading, one), (_, _, other) in zip(cells(shown), cells(fresh), strict=True):
        try:
            off = abs(float(one.rstrip("%")) - float(other.rstrip("%")))
        except ValueError:
            off = 0.0 if one == other else math.inf
        least = 1.01 * 10.0 ** -len(one.rstrip("%").partition(".")[2])
        if off > ALLOWED.get(heading, least):
            found.append(f"{row}, {heading}: {one} is not {other}")
    return found


def test_readme_shows_what_the_script_prints(
    reversals: ModuleType, readme: str, capsys: pytest.CaptureFixture[str]
):
    shown = readme.split(reversals.BEGIN)[1].split(reversals.END)[0].strip()
    reversals.main([])
    fresh = capsys.readouterr().out.strip()
    assert changes(shown, fresh) == []


def test_changes_are_seen(reversals: ModuleType, readme: str):
    shown = readme.split(reversals.BEGIN)[1].split(reversals.END)[0].strip()
    for old, new in (("0.00385", "0.00389"), ("48%", "50%"), ("none", "nobody"), ("–", "0")):
        assert old in shown and changes(shown, shown.replace(old, new)) != []
    assert changes(shown, shown.replace("0.0450", "0.0451")) == []


def test_prose_has_the_numbers_of_the_runs(reversals: ModuleType, readme: str):
    prose = " ".join(readme.split(reversals.END)[1].split())
    runs = reversals.experiments()
    left = [reversals.number(run, "acceleration", "residual_gap_deg") for run in runs]
    assert ", ".join(f"{value:.5f}°" for value in left[:4]) in prose and left[4] < 1e-6
    for run in runs[:3]:
        assert f"{reversals.number(run, 'none', 'jump_deg'):.4f}° here" in prose
    for run, turn in zip(runs[3:], (7560, 7524), strict=True):
        assert f"{gap(turn):.4f}°" in prose
        assert f"{reversals.number(run, 'none', 'jump_deg'):.4f}°" in prose
    met = reversals.simulated(runs[3], "none").to_json()["crossing_deg"]
    assert f"{7560 - met:.0f}° before it turns" in prose
    ahead = [reversals.judged_ahead(run, "acceleration") for run in runs]
    assert f"{ahead[0]:.0f}° (10 rpm) to {ahead[3]:.0f}° (100 rpm)" in prose
    assert f"{reversals.missed(np.array([7524.0]), ahead[4]).over_mm[0]:.3f} mm too far" in prose
    turns = np.arange(5760.0)
    slow, fast = (reversals.missed(turns, ahead[place], 25) for place in (0, 3))
    shares = [f"{100 * np.mean(found.over_mm > 0):.0f} %" for found in (slow, fast)]
    assert " to ".join(shares) in prose
    assert f"by up to {fast.over_on_the_way_mm.max():.2f} mm" in prose
    assert f"up to {fast.left_deg.max():.3f}°" in prose
    assert gap(3600) / gap(3600 - ahead[1]) == pytest.approx(4 / 3, abs=0.02)
    for name in ("experiment", "simulation"):
        for run in reversals.PRINTED["table_3"]:
            assert f"{run['backlash_deg'][name]:.4f}°" in prose


def test_readme_shows_the_pictures_that_are_kept(readme: str):
    named = set(re.findall(r"!\[[^]]+\]\(([^)]+\.png)\)", readme))
    kept = {path.name for path in PAPER.glob("*.png")}
    assert named == kept and len(named) == 8
    for path in PAPER.glob("fig_*.png"):
        assert path.stat().st_size < 150_000


def test_pictures(reversals: ModuleType):
    figure = reversals.run_picture(reversals.experiments()[4])
    labels = [label for ax in figure.axes for label in (ax.get_ylabel(), ax.get_xlabel()) if label]
    assert len(labels) == 7 and all(re.search(r"\[(°|mm|s)\]$", label) for label in labels)
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "commanded too far" in words and "without control" in words
    judged = reversals.judged_picture()
    assert len(judged.axes) == 1 + len(RUNS)


def test_write_renews_readme_and_pictures(
    reversals: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(reversals, "HERE", tmp_path)
    monkeypatch.setattr(reversals, "pictures", lambda: {"fig.png": b"picture"})
    others = sys.modules["compare"]
    kept = f"before\n{others.BEGIN}other tables\n{others.END}between\n"
    text = f"{kept}{reversals.BEGIN}old\n{reversals.END}after\n"
    (tmp_path / "README.md").write_text(text, encoding="utf-8")
    reversals.main(["--write"])
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert text.startswith(kept) and text.endswith("after\n")
    assert "old" not in text and "100 rpm to 7524°" in text
    assert (tmp_path / "fig.png").read_bytes() == b"picture"
