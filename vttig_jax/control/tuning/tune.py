"""Tuning of the settings of a controller by gradient, checked by the full simulation."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ...base.errors import ScenarioError
from ...base.runtime import require_x64
from ...pair.gear_pair import Drive, GearPair
from ..scenario.axes import SCENARIO_FILE
from ..scenario.spec import ScenarioSpec, load_sweep_spec
from ..simulation.build import Maps
from ..simulation.metrics import NEAR_MM
from ..sweeps.sweep import recipe_of
from .free_keys import SETTINGS, Limits, free_keys
from .judge import Judge, with_keys
from .result import Score, Tuned
from .search import OBJECTIVES, WIDTHS, Objective, Search, Stage

_ENDINGS = {
    "missed": "the controller does not close before the turn",
    "slow": "the actuator is still moving when the motion turns",
    "stroke": "the controller commands more than actuator.stroke_mm",
}
"""Outcomes that tuning may cause, and their meaning."""

_TRAVEL_RATIO = 2.0
"""Ratio of the actuator's travel after and before tuning above which a note is written: chosen."""

_LEAST_GAIN = 1e-3
"""Least relative gain of the objective for which a key is changed: a chosen value."""


def tune(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    maps: Maps = Maps(),
    free: Sequence[str] | None = None,
    limits: Limits | None = None,
    objective: Objective = "expected",
    interference_weight: float = 10.0,
    progress: Callable[[int, int], None] | None = None,
) -> Tuned:
    """Tune the settings of a controller for all cases of a sweep.

    The function minimises the mean, or the largest value, over the cases of

        residual gap + weight · interference

    Both terms are backlash in degrees of the driven gear; an interference of s mm counts as the
    backlash that a displacement by s removes. With the weight w, w degrees of residual gap cost as
    much as one degree of interference. With an uncertain map, the fraction 1/(1 + w) of the rigs
    therefore interferes at the best margin. For `feedforward`, which moves no gear, it minimises
    the lost motion, in which too much compensation costs as much as too little; each step of that
    search is a full simulation of all cases.

    The search follows the gradient of smoothed controllers (`controllers/smooth.py`), whose width
    shrinks in stages. It simulates from shortly before the braking to the speed after the turn,
    with a prescribed motion. Only the full simulation includes earlier events, such as closing too
    early because of encoder counts. It runs every case of the sweep as `vttig_jax.sweep` does, at
    the start and after every stage, and it decides: values that are not better than the start are
    rejected, and a setting that gains less than a thousandth stays. If no stage is better, points
    around the last one are tried.

    **Arguments**
    - `spec`, `pair`, `folder`, `maps`: as for `vttig_jax.sweep`; the axes define the
      cases, and `controller` is no axis.
    - `free`: dotted keys, by default all numeric settings of the controller; for `feedforward`
      `map.constant_backlash_deg`, which starts at that of [eccentricities] or has to be given.
    - `limits`: key → (lowest, highest) value; by default the bounds of the key, and factors of 1000
      and 1/1000 of its start.
    - `objective`: "expected" or "worst". - `interference_weight`: at least 0.
    - `progress`: is called with the numbers of finished and of all stages.

    **Raises** `ScenarioError` and `PairError` as `sweep` does, and for a controller without
    settings; `ValueError` for keys that cannot be tuned and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import parse_scenario_spec
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> axes = {"motion.reversal_deg": [360.0, 540.0]}
    >>> motion = {"dwell_s": 0.1, "ramp_s": 0.2}
    >>> scenario = {"pair": "pair.toml", "eccentricities": rig, "motion": motion}
    >>> spec = parse_scenario_spec(scenario | {"controller": "predictive", "sweep": axes})
    >>> tuned = vttig_jax.tune(spec, paper_pair(), free=["judgement.margin_mm"])
    >>> tuned.improved, abs(tuned.values["judgement.margin_mm"]) < 1e-3
    (True, True)

    ```
    """
    require_x64("tune")
    if objective not in OBJECTIVES:
        raise ValueError(
            f'Argument `objective` must be "expected" or "worst", but is {objective!r}.'
        )
    if not (math.isfinite(interference_weight) and interference_weight >= 0):
        raise ValueError(
            f"Argument `interference_weight` must be at least 0, but is {interference_weight!r}."
        )
    source = "" if isinstance(spec, ScenarioSpec) else str(spec)
    scenario = spec if isinstance(spec, ScenarioSpec) else load_sweep_spec(spec)
    recipe = recipe_of(spec, pair, folder, maps=maps)
    with SCENARIO_FILE.error_context(source):
        _check_controller(scenario)
        keys = free_keys(scenario, free, limits)
        judge = Judge(recipe, keys, objective, interference_weight)
        return _tuned(scenario, judge, progress)


def _check_controller(spec: ScenarioSpec) -> None:
    """Refuse a controller without settings, and several controllers at once."""
    if spec.sweep is not None and "controller" in spec.sweep.axes:
        raise ScenarioError(
            "is an axis, but settings are tuned for one controller; write it at the top of the file"
            " instead.",
            where="sweep.controller",
        )
    if spec.controller not in SETTINGS:
        raise ScenarioError(
            f'"{spec.controller}" has nothing to tune; choose one of {", ".join(SETTINGS)}.',
            where="controller",
        )


def _tuned(spec: ScenarioSpec, judge: Judge, progress: Callable[[int, int], None] | None) -> Tuned:
    search, searched = None, len(judge.cases)
    if not judge.moves:
        cases = judge.search_cases()
        search, searched = Search(cases, judge.keys, judge.objective, judge.weight), len(cases)
    before, best = judge.score(judge.start), judge.start
    stages: list[Stage] = []
    for stage in judge.compass() if search is None else search.stages():
        stages.append(stage)
        if judge.score(stage.values).rank < judge.score(best).rank:
            best = stage.values
        if progress is not None:
            progress(len(stages), len(WIDTHS))
    if best == judge.start and stages and search is not None:
        best = _nearby(judge, search, stages[-1])
    best = _without_small_gains(judge, best)
    values = dict(zip((key.name for key in judge.keys), best, strict=True))
    return Tuned(
        spec=with_keys(spec, judge.keys, best),
        pair=judge.recipe.pair.name,
        keys=judge.keys,
        values=values,
        before=before,
        after=judge.score(best),
        objective=judge.objective,
        interference_weight=judge.weight,
        cases=len(judge.cases),
        searched=searched,
        stages=tuple(stages),
        notes=tuple(_notes(spec, judge, values)),
    )


def _nearby(judge: Judge, search: Search, last: Stage) -> tuple[float, ...]:
    """Return the best point around the end of the search, or the start if it is better.

    The smooth objective can end beyond a discontinuity, such as a threshold just above the largest
    deceleration, with which the controller misses every reversal.
    """
    points = [judge.start, *search.neighbours(last.values)]
    return min(points, key=lambda values: judge.score(values).rank)


def _without_small_gains(judge: Judge, best: tuple[float, ...]) -> tuple[float, ...]:
    """Return `best` with every key reset to its start if the key gains less than `_LEAST_GAIN`.

    A key is reset only if the values stay better than the start.
    """
    first, tuned = judge.score(judge.start), judge.score(best)
    while True:
        for index, start in enumerate(judge.start):
            reset = (*best[:index], start, *best[index + 1 :])
            if reset in (best, judge.start):
                continue
            score = judge.score(reset)
            near = score.cost_deg <= tuned.cost_deg * (1 + _LEAST_GAIN)
            if near and score.rank[0] <= tuned.rank[0] and score.rank < first.rank:
                best = reset
                break
        else:
            return best


def _notes(scenario: ScenarioSpec, judge: Judge, values: Mapping[str, float]) -> list[str]:
    before, after = judge.score(judge.start), judge.score(tuple(values.values()))
    notes: list[str] = []
    if not after.rank < before.rank:
        notes.append("The full simulation found no better values, so they stay as they were.")
    notes += [
        f"{key.name} ends at its limit, {values[key.name]:.4g}."
        for key in judge.keys
        if key.at_limit(values[key.name])
    ]
    if after.outcomes.get("bound"):
        notes.append(
            f"In {after.outcomes['bound']} cases the drive still blocks; the objective does not"
            " include them."
        )
    notes += [_note(name, after, before) for name in _ENDINGS if _added(after, name, before) > 0]
    if after.travel_mean_mm > _TRAVEL_RATIO * max(before.travel_mean_mm, NEAR_MM):
        notes.append(
            f"The actuator travels {after.travel_mean_mm:.3g} mm per run, before tuning"
            f" {before.travel_mean_mm:.3g}: the controller closes and opens while the shaft runs,"
            " which the objective does not include; limit the settings that detect braking."
        )
    if after.thrown_max_deg > 0.5 * max(after.lost_max_deg, after.gap_max_deg):
        notes.append(
            f"The motor throws the driven shaft back by up to {after.thrown_max_deg:.5f}°, which"
            " the lost motion hardly contains; choose a longer judgement.jump_s."
        )
    if scenario.servo.motor != "prescribed" and not judge.moves:
        notes.append(
            "The search used a prescribed motion; only the full simulation has the servo motor."
        )
    return notes


def _added(after: Score, name: str, before: Score) -> int:
    """Return the increase of the number of cases with an outcome."""
    return after.outcomes.get(name, 0) - before.outcomes.get(name, 0)


def _note(name: str, after: Score, before: Score) -> str:
    cases, total = after.outcomes[name], sum(after.outcomes.values())
    if name == "missed" and cases == total:
        return (
            "The best controller never closes, because the interference of closing costs more than"
            " the gap; choose another controller or a smaller interference weight."
        )
    earlier = before.outcomes.get(name, 0)
    return f"In {cases} of {total} cases {_ENDINGS[name]} ({name}), before tuning in {earlier}."
