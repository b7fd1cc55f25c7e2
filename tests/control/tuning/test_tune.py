"""Tuning: problems with a known optimum, and what the arguments do."""

from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import norm

from tests.control.scenarios import CLOSING, PAIR
from tests.control.sweep_files import drawn, sweep_spec
from tests.control.texts import RIG
from vttig_jax.base.errors import ScenarioError
from vttig_jax.base.units import DEG
from vttig_jax.control import Maps, sweep, tune
from vttig_jax.control.scenario.spec import ScenarioSpec
from vttig_jax.control.tuning.tune import SETTINGS, Tuned
from vttig_jax.pair.gear_pair import Eccentricities

MARGIN = "judgement.margin_mm"
BELIEVED = Eccentricities(**RIG)
PER_MM = CLOSING / DEG
"""deg of backlash a mm."""

OFF_DEG = 0.004 * norm.ppf((np.arange(21) + 0.5) / 21)
"""What the constant backlash of 21 rigs is beside that of the map: strata of a normal."""
OFF_MM = OFF_DEG / PER_MM
RIGS = tuple(
    Eccentricities(**{**RIG, "constant_backlash_deg": RIG["constant_backlash_deg"] + off})
    for off in OFF_DEG
)
MAPS = drawn(BELIEVED, *RIGS)
PLAIN = {
    "plant": "play",
    "flanks": "closed",
    "driving_encoder__counts_per_rev": 0,
    "driven_encoder__counts_per_rev": 0,
}


def spec_of(controller: str, turns: Any = (300.0,), **settings: Any) -> ScenarioSpec:
    axes = {"motion.reversal_deg": list(turns)}
    return sweep_spec(axes, controller=controller, **{**PLAIN, **settings})


SCATTERED = spec_of("predictive", rig={"from": "RUN"})


def scattered(**given: Any) -> Tuned:
    """The margin against a map whose constant backlash is uncertain."""
    options: dict[str, Any] = {"maps": MAPS, "free": [MARGIN]}
    return tune(SCATTERED, PAIR, **{**options, **given})


TURNS = (300.0, 360.0, 540.0, 620.0, 700.0)


# Known optima.


@pytest.mark.slow
@pytest.mark.parametrize("weight", [1.0, 9.0])
def test_the_expected_margin_is_a_quantile_of_the_scatter(weight):
    # Cost of margin m: Σ max(0, δ + m) + w max(0, −δ − m). Its slope n − k − w k, k the number of
    # δ < −m, changes sign at the k-th smallest δ with k = ⌈n/(1 + w)⌉: −m is the quantile
    # 1/(1 + w), as in the newsvendor problem.
    tuned = scattered(interference_weight=weight)
    rank = int(np.ceil(len(OFF_MM) / (1 + weight)))
    assert tuned.values[MARGIN] == pytest.approx(-np.sort(OFF_MM)[rank - 1], abs=1.5e-3)
    share = (rank - 1) / len(OFF_MM)
    assert tuned.after.interfering_share == pytest.approx(share, abs=1.01 / len(OFF_MM))
    best = tuned.values[MARGIN] + OFF_MM
    cost = np.mean(np.maximum(best, 0) + weight * np.maximum(-best, 0)) * PER_MM
    assert tuned.after.cost_deg == pytest.approx(cost, abs=2e-5)
    assert tuned.improved and tuned.after.cost_deg < tuned.before.cost_deg


@pytest.mark.slow
@pytest.mark.parametrize("weight", [2.0, 1000.0])
def test_the_worst_margin_balances_both_ends(weight):
    # max{δ_max + m, w (−δ_min − m)} is least where both are equal.
    tuned = scattered(objective="worst", interference_weight=weight)
    margin = (-weight * OFF_MM.min() - OFF_MM.max()) / (1 + weight)
    assert tuned.values[MARGIN] == pytest.approx(margin, abs=1.5e-3)
    assert tuned.before.cost_deg > tuned.after.cost_deg


# What the arguments do.


@pytest.fixture(scope="module")
def base() -> Tuned:
    return scattered()


CHANGES: dict[str, Any] = {
    "draws": drawn(BELIEVED, *RIGS[1:], RIGS[-1]),
    "believed": drawn(Eccentricities(**{**RIG, "constant_backlash_deg": 0.04}), *RIGS),
    "limits": {MARGIN: (0.0, 0.02)},
}
"""Objective and weight have optima of their own above."""


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_every_argument_changes_what_is_found(base, name):
    changed = CHANGES[name]
    other = scattered(**{"maps" if isinstance(changed, Maps) else name: changed})
    moved = abs(other.values[MARGIN] - base.values[MARGIN])
    assert moved > 2e-3
    # A limit that is reached is said.
    reached = name == "limits"
    assert (other.values[MARGIN] == 0.02) is reached
    assert any("ends at its limit" in note for note in other.notes) is reached
    assert other.to_json()["values"][MARGIN]["at_limit"] is reached


@pytest.mark.slow
def test_progress_and_the_scenario_with_the_values(base):
    told: list[tuple[int, int]] = []
    tuned = scattered(progress=lambda done, all_: told.append((done, all_)))
    assert tuned.values == base.values  # nothing changes by itself
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert tuned.spec.judgement.margin_mm == tuned.values[MARGIN] != 0.01
    assert tuned.spec.sweep == SCATTERED.sweep and tuned.spec.rig == SCATTERED.rig
    # What it says of the values is what a sweep says of them.
    columns, after = sweep(tuned.spec, PAIR, maps=MAPS).columns, tuned.after
    gap = columns["residual_gap_deg"]
    spread = [gap.mean(), np.quantile(gap, 0.95), gap.max()]
    found = [after.gap_mean_deg, after.gap_high95_deg, after.gap_max_deg]
    np.testing.assert_allclose(found, spread, rtol=1e-12)
    others = [columns["interference_mm"].max(), columns["actuator_travel_mm"].mean()]
    found = [after.interference_max_mm, after.travel_mean_mm]
    np.testing.assert_allclose(found, others, rtol=1e-9)
    text = str(tuned)
    assert "confirmed by the full simulation" in text and "21 ok" in text
    assert f"{tuned.values[MARGIN]:.4g}" in text and f"{tuned.after.cost_deg:.5f}" in text


# Never worse.


@pytest.mark.slow
def test_what_is_not_better_is_not_taken(base):
    """From the best value the search finds nothing better."""
    again = tune(base.spec, PAIR, maps=MAPS, free=[MARGIN])
    assert again.after.cost_deg <= again.before.cost_deg
    gain = again.before.cost_deg - again.after.cost_deg
    assert gain < 2e-3 * again.before.cost_deg
    if not again.improved:
        assert again.values == base.values and "they stay" in again.notes[0]


@pytest.mark.slow
def test_all_settings_are_free_and_those_that_do_not_matter_are_left_alone():
    tuned = scattered(free=None)
    assert tuple(tuned.values) == SETTINGS["predictive"]
    moved = [key.name for key in tuned.keys if tuned.values[key.name] != key.start]
    assert moved == [MARGIN]


@pytest.mark.slow
def test_a_threshold_above_every_deceleration_is_found_all_the_same():
    # 31 rad/s² is what the motor makes: nothing is seen, and there is no slope.
    spec = spec_of("acceleration", TURNS, judgement__threshold_rad_s2=60.0)
    tuned = tune(spec, PAIR, interference_weight=1.0)
    assert tuned.before.outcomes == {"missed": 5}
    assert tuned.values["judgement.threshold_rad_s2"] < 35 and tuned.improved


# Bad input.


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"free": []}, "must name a key to tune"),
        ({"free": MARGIN}, "is one text"),
        ({"free": ["motion.speed_rpm"]}, "none of predictive"),
        ({"free": [MARGIN, MARGIN]}, "does so twice"),
        ({"limits": {"judgement.horizon_s": (0.1, 0.5)}}, "is not; free are"),
        ({"limits": {MARGIN: (-1e4, 1.0)}}, "within -1000 … 1000"),
        ({"interference_weight": float("nan")}, "at least 0"),
    ],
)
def test_bad_arguments_are_one_sentence(given, words):
    """Those of options of the command stand in `tests/cli/test_tune.py`."""
    with pytest.raises(ValueError, match=words) as caught:
        scattered(**cast(Any, given))
    assert str(caught.value).count("\n") == 0


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.5, 1.7])
def test_the_compensation_of_the_motor_ends_at_the_gap_of_the_plant(start):
    """Whether it begins with too little or too much."""
    true, gap = RIG["constant_backlash_deg"], "map.constant_backlash_deg"
    settings: Any = {"map__constant_backlash_deg": start * true}
    found = tune(spec_of("feedforward", (300.0, 420.0), **settings), PAIR)
    assert set(found.values) == {gap} and found.improved and found.notes == ()
    assert found.values[gap] == pytest.approx(true, rel=0.01)
    assert found.before.lost_mean_deg == pytest.approx(abs(1 - start) * true, rel=0.1)
    assert found.after.lost_mean_deg < 0.02 * found.before.lost_mean_deg
    assert found.spec.map.constant_backlash_deg == found.values[gap]


@pytest.mark.slow
def test_a_shaft_that_is_thrown_back_is_said():
    spec = spec_of("feedforward", plant="rigid", map__constant_backlash_deg=0.06)
    assert any("jump_s" in note for note in tune(spec, PAIR).notes)


@pytest.mark.slow
def test_the_gap_of_a_map_has_to_be_given_to_be_tuned():
    maps, jump = Maps({"RUN": MAPS.named["RUN"]}), "judgement.jump_s"
    spec = spec_of("feedforward", eccentricities=None, plant_map="RUN")
    with pytest.raises(ValueError, match="no start"):
        tune(spec, PAIR, maps=maps)
    assert set(tune(spec, PAIR, maps=maps, free=[jump]).values) == {jump}


def test_axes_that_cannot_be_tuned_over():
    both = sweep_spec({"controller": ["acceleration", "predictive"]})
    with pytest.raises(ScenarioError, match="one controller"):
        tune(both, PAIR)
    margins = sweep_spec({MARGIN: [0.0, 0.1]}, controller="predictive")
    with pytest.raises(ValueError, match="is an axis"):
        tune(margins, PAIR, free=[MARGIN])
