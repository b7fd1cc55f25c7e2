"""The paper's reversals as `vttig simulate --paper` has them, beside formulas in plain Python."""

import json
import math
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import vttig_jax
from tests.oracles.flank_formulas import exact
from tests.schemas import load_schema
from vttig_jax.cli.main import main
from vttig_jax.control import parse_scenario_spec
from vttig_jax.control.scenario.scenario import EccentricityTable
from vttig_jax.control.scenario.spec import load_scenario_spec
from vttig_jax.plotting.paper_run import plot_paper_run
from vttig_jax.rig import paper_eccentricities, paper_pair
from vttig_jax.runs import simulate_paper
from vttig_jax.runs.paper_runs import PaperRuns

pytestmark = pytest.mark.slow

PAPER = Path(__file__).resolve().parents[2] / "fits" / "paper"
PER_MM = math.degrees(2 * math.tan(math.radians(3.0)) / 80.0)
"""Backlash in degrees that a mm closes, (16): both flanks 3°, R₂ = 80 mm."""
MARGIN = 0.01 * PER_MM

RUNS = [(10, 1080), (30, 3600), (60, 7560), (100, 7560), (100, 7524)]


@pytest.fixture(scope="module")
def found() -> PaperRuns:
    """The runs, which all tests share; they take 15 s."""
    return simulate_paper(trace_every=4)


@pytest.fixture(scope="module")
def prose() -> str:
    text = (PAPER / "README.md").read_text(encoding="utf-8")
    return " ".join(text.split("## What the paper's controller does")[1].split())


def metric(found: PaperRuns, place: int, controller: str, name: str) -> float:
    value = found.runs[place].simulated[controller].metrics[name]
    assert isinstance(value, float)
    return value


def gap(driving_deg: float) -> float:
    """Backlash in degrees, from the common tangent of both base circles in plain Python."""
    lower, upper = (wall(math.radians(driving_deg))[0] for wall in exact())
    return math.degrees(upper - lower)


def braked(speed_rpm: float, after_s: float, ramp_s: float = 0.5) -> float:
    """Driving angle from a time after braking to the standstill, degrees: 6 n (T − t)²/2T."""
    return 6.0 * speed_rpm * (ramp_s - after_s) ** 2 / (2 * ramp_s)


def test_runs_are_those_of_the_paper(found: PaperRuns):
    assert [(run.speed_rpm, run.reversal_deg) for run in found.runs] == RUNS
    assert [run.figure for run in found.runs] == [17, 18, 19, 20, 16]
    both = ["experiment", "simulation"]
    assert [list(run.printed) for run in found.runs] == [both, both, both, both[:1], both[1:]]


def test_scenario_is_tables_1_and_2_and_else_the_defaults(found: PaperRuns):
    assert vttig_jax.load_pair(PAPER / "pair.toml") == paper_pair() == found.pair
    kept = load_scenario_spec(PAPER / "scenario.toml")
    table_2 = paper_eccentricities()
    rig = {name: float(getattr(table_2, name)) for name in EccentricityTable.__struct_fields__}
    assert kept == parse_scenario_spec({"pair": "pair.toml", "eccentricities": rig})
    assert found.runs[2].simulated["acceleration"].spec == kept


def test_closes_where_the_motion_says(found):
    """The detected angle from the delay alone: constant deceleration, at rest at the turn."""
    for place in range(len(RUNS)):
        speed, turn = RUNS[place]
        for controller, most in (("acceleration", 0.03), ("predictive", 0.25)):
            delay = metric(found, place, controller, "detection_delay_s")
            assert 0 < delay < most
            closes = metric(found, place, controller, "detection_deg")
            assert closes == pytest.approx(turn - braked(speed, delay), abs=1e-6)


def test_what_the_paper_controller_misses(found):
    """left = max(0, j(turn) − j(detected) + m), over = max(0, j(detected) − m − j)."""
    for place in range(len(RUNS)):
        speed, turn = RUNS[place]
        ahead = braked(speed, metric(found, place, "acceleration", "detection_delay_s"))
        closed = gap(turn - ahead) - MARGIN
        least = min(gap(turn - share * ahead) for share in np.linspace(1.0, 0.0, 400))
        # The controller reads whole counts of 0.004° of the driving angle.
        left = metric(found, place, "acceleration", "residual_gap_deg")
        assert left == pytest.approx(max(gap(turn) - closed, 0.0), abs=3e-6)
        over = metric(found, place, "acceleration", "interference_mm")
        assert over == pytest.approx(max(closed - least, 0.0) / PER_MM, abs=5e-5)


def test_what_the_predictive_controller_leaves(found):
    for place in range(len(RUNS)):
        left = metric(found, place, "predictive", "residual_gap_deg")
        assert left == pytest.approx(MARGIN, abs=3e-6)
        assert left < 0.05 * metric(found, place, "none", "residual_gap_deg")
        assert metric(found, place, "predictive", "interference_mm") < 1e-4


def test_without_control_the_gap_is_crossed_where_the_shafts_part(found):
    """At 100 rpm the ramp asks for more torque than friction has: the gap is crossed in braking."""
    for place in range(len(RUNS)):
        speed, turn = RUNS[place]
        asked = 0.01 * 0.5625 * speed * math.tau / 60 / 0.5
        assert (asked > 0.1) == (speed == 100)
        run = found.runs[place].simulated["none"]
        met = run.to_json()["crossing_deg"]
        assert metric(found, place, "none", "jump_deg") == pytest.approx(gap(met), abs=1e-6)
        assert (
            (turn - met > 100.0)
            == (asked > 0.1)
            == (metric(found, place, "none", "early_jump_deg") > 0.01)
        )


def test_remarks_have_the_numbers_of_the_tables(found: PaperRuns):
    """What Table 2 allows, by hand, and what Table 3 has."""
    radius, text = 80 * math.cos(math.radians(20.0)), " ".join(found.remarks)
    most = 2 * math.degrees((0.0226 + 0.0273) / radius)
    working = math.acos(125 * math.cos(math.radians(20)) / 125.12)
    span = 4 * math.degrees(0.0273 * math.sin(working) / radius) * math.sin(math.radians(11.25))
    for value in (most, span, 0.0957, 0.1253, 0.1594, 0.0129, 0.0181):
        assert f"{value:.4f}°" in text
    assert "+0.0331° to +0.0437°" in text
    for place in range(5):
        for controller in found.runs[place].simulated:
            low, high = (metric(found, place, controller, f"te_{n}_deg") for n in ("min", "max"))
            assert high - low < 0.1253 and high - low < most + 0.0642


COUNT = 0.0063
"""A count of both encoders in TE, degrees: what rounding decides at a standstill on a count."""

ALLOWED = {
    "mean": 6e-4,
    "max": COUNT,
    "min": COUNT,
    "range": 2 * COUNT,
    "as read": 2 * COUNT,
    "met at [°]": 0.1,
    "closes at [°]": 0.5,
    "delay [ms]": 8.0,
}
"""Heading of a column → what its numbers may differ by; those of counts differ by counts."""


def cells(tables: str) -> Iterator[tuple[str, str, str]]:
    """(row, heading, cell) of all text tables; what is no table has no heading."""
    headings = [""]
    for line in tables.splitlines():
        row = re.split(r"\s{2,}", line)
        if line.startswith("   "):
            headings = row
        for heading, cell in zip(headings, row, strict=False):
            yield row[0], heading, cell


def changes(shown: str, fresh: str) -> list[str]:
    """Cells of the tables that differ by more than rounding decides."""
    found = []
    for (row, heading, one), (_, _, other) in zip(cells(shown), cells(fresh), strict=True):
        try:
            off = abs(float(one) - float(other))
        except ValueError:
            off = 0.0 if one == other else math.inf
        least = 1.01 * 10.0 ** -len(one.partition(".")[2])
        if off > ALLOWED.get(heading, least):
            found.append(f"{row}, {heading}: {one} is not {other}")
    return found


def kept_table() -> str:
    return (PAPER / "table.md").read_text(encoding="utf-8")


def test_kept_table_is_what_the_verb_prints(found: PaperRuns):
    assert changes(kept_table(), found.files()["table.md"].decode()) == []


def test_changes_are_seen():
    shown = kept_table()
    for old, new in (("0.00385", "0.00389"), ("none", "nobody"), ("–", "0")):
        assert old in shown and changes(shown, shown.replace(old, new)) != []
    assert changes(shown, shown.replace("0.0450", "0.0451")) == []


def test_prose_has_the_numbers_of_the_runs(found: PaperRuns, prose: str):
    left = [metric(found, place, "acceleration", "residual_gap_deg") for place in range(5)]
    assert ", ".join(f"{value:.5f}°" for value in left[:4]) in prose and left[4] < 1e-6
    for place in range(3):
        assert f"{metric(found, place, 'none', 'jump_deg'):.4f}° here" in prose
    for place in (3, 4):
        assert f"{gap(RUNS[place][1]):.4f}°" in prose
        assert f"{metric(found, place, 'none', 'jump_deg'):.4f}°" in prose
    met = found.runs[3].simulated["none"].to_json()["crossing_deg"]
    assert f"{7560 - met:.0f}° before it turns" in prose
    ahead = [RUNS[p][1] - metric(found, p, "acceleration", "detection_deg") for p in range(5)]
    assert f"{ahead[0]:.0f}° (10 rpm) to {ahead[3]:.0f}° (100 rpm)" in prose
    too_far = metric(found, 4, "acceleration", "interference_mm")
    assert f"by {too_far:.3f} mm at most" in prose
    assert gap(3600) / gap(3600 - ahead[1]) == pytest.approx(4 / 3, abs=0.02)
    for run in found.runs:
        for of in run.printed.values():
            assert f"{of['without_control']['jump_deg']:.4f}°" in prose
    turns = np.arange(0.0, 5760.0, 12.0)
    grown = np.array([gap(turn) - gap(turn - ahead[2]) for turn in turns]) + MARGIN
    assert 0.45 < np.mean(grown < 0) < 0.52 and f"leaves up to {grown.max():.3f}°" in prose


def test_picture(found: PaperRuns):
    first, last = (
        plot_paper_run(run.simulated, str(run), run.printed)
        for run in (found.runs[0], found.runs[4])
    )
    labels = [label for ax in last.axes for label in (ax.get_ylabel(), ax.get_xlabel()) if label]
    assert len(labels) == 7 and all(re.search(r"\[(°|mm|s)\]$", label) for label in labels)
    keys = [len(plot.legends[0].get_texts()) for plot in (last, first)]
    assert keys == [6, 5]  # at 1080° nothing is commanded too far
    band = last.axes[0].patches[0].get_window_extent()
    low, high = last.axes[0].transData.inverted().transform(band.get_points())[:, 1]
    assert (low, high) == pytest.approx((-0.0126, 0.1276), abs=1e-6)


def test_verb_writes_tables_and_pictures(
    found: PaperRuns,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """The runs of the fixture take the place of new ones."""
    monkeypatch.setattr("vttig_jax.runs.paper_runs.simulate_paper", lambda **_: found)
    out = tmp_path / "paper"
    assert main(["simulate", "--paper", "--out", str(out), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    jsonschema.validate(record, load_schema("vttig.paper/1"))
    simulate_schema = load_schema("vttig.simulate/1")
    for run, own in zip(record["runs"], found.runs, strict=True):
        assert run["printed"] == own.printed
        for controller, one in run["simulated"].items():
            jsonschema.validate(one, simulate_schema)
            assert one["metrics"]["jump_deg"] == own.simulated[controller].metrics["jump_deg"]
    pictures = {f"fig_{number}.png" for number in range(16, 21)}
    assert {path.name for path in out.iterdir()} == pictures | {"table.md"}
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in pictures)
    assert main(["simulate", "--paper"]) == 0
    assert capsys.readouterr().out.strip() in (out / "table.md").read_text(encoding="utf-8")
    assert main(["simulate", "--paper", "--out", str(out)]) == 2
    shutil.rmtree(out)


@pytest.mark.parametrize(
    "words",
    [
        "--paper scenario.toml",
        "--paper --set controller=none",
        "--paper --figure a.png",
        "--paper --overwrite",
        "scenario.toml --out a",
    ],
)
def test_options_that_do_not_go_with_the_runs_of_the_paper(words: str):
    assert main(["simulate", *words.split()]) == 2
