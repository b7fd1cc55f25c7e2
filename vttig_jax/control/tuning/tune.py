"""`tune`: the settings of a controller by gradient, checked by the hard judgement."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ...base.errors import ScenarioError
from ...base.runtime import require_x64
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import GearPair
from ..scenario.axes import SCENARIO_FILE
from ..scenario.spec import ScenarioSpec, load_sweep_spec
from ..simulation.metrics import NEAR_MM
from ..sweeps.sweep import recipe_of
from .free_keys import SETTINGS, Limits, free_keys
from .judge import Judge, with_keys
from .result import Score, Tuned
from .search import OBJECTIVES, WIDTHS, Objective, Search, Stage

_ENDINGS = {
    "missed": "the controller does not close before the turn",
    "slow": "the actuator is still on its way when the motion turns",
    "stroke": "the controller asks for more than actuator.stroke_mm",
}
"""Outcomes that tuning may bring about, and what each says."""

_RESTLESS = 2.0
"""Times the actuator may travel as far as before without a word."""

_SAME = 1e-3
"""Share of the objective that a key must bring to be changed."""


def tune(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | None = None,
    *,
    folder: str | Path | None = None,
    rigs: Sequence[Eccentricities] = (),
    believed: Eccentricities | None = None,
    free: Sequence[str] | None = None,
    limits: Limits | None = None,
    objective: Objective = "expected",
    interference_weight: float = 10.0,
    progress: Callable[[int, int], None] | None = None,
) -> Tuned:
    """Tune the settings of a controller for all cases of a sweep.

    Minimised is the mean, or the largest, over the cases of

        residual gap + weight · interference

    both as backlash in degrees of the driven gear; an interference of s mm is the backlash that s
    takes up. The weight w says how many degrees of gap one would rather leave than close a degree
    too far: with a map that is uncertain, the best margin lets a share 1/(1 + w) of the rigs
    interfere.

    The search follows the slopes of smoothed judgements (`smooth_controllers`) whose width shrinks
    in stages. It simulates from shortly before the brakes to the speed after the turn, with a
    prescribed motion; what a controller does before, such as closing too early because of the
    counts of an encoder, only the hard judgement sees. That one runs every case of the sweep as
    `vttig_jax.sweep` does, at the start and after every stage, and decides: what it finds no better
    than the start is not taken, and a setting that brings less than a thousandth is left alone. If
    it finds no stage better, it also tries places beside the last one.

    **Arguments**
    - `spec`, `pair`, `folder`, `rigs`, `believed`: as of `vttig_jax.sweep`; the axes are the cases
      that the controller must be good at. `controller` is not among them.
    - `free`: dotted keys of [judgement]; by default all that the controller is set by.
    - `limits`: key → (lowest, highest) that it may take; by default the bounds of the key, and a
      thousand times or a thousandth of its start.
    - `objective`: "expected" or "worst". - `interference_weight`: at least 0.
    - `progress`: is told the stages done and all of them.

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
    >>> given = {"pair": "pair.toml", "eccentricities": rig, "motion": motion}
    >>> spec = parse_scenario_spec(given | {"controller": "predictive", "sweep": axes})
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
    given = spec if isinstance(spec, ScenarioSpec) else load_sweep_spec(spec)
    recipe = recipe_of(spec, pair, folder, rigs, believed)
    with SCENARIO_FILE.placed(source):
        _check_controller(given)
        keys = free_keys(given, free, limits)
        judge = Judge(recipe, keys, objective, interference_weight)
        return _tuned(given, judge, progress)


def _check_controller(spec: ScenarioSpec) -> None:
    """Refuse what has no settings, or several controllers at once."""
    if spec.sweep is not None and "controller" in spec.sweep.axes:
        raise ScenarioError(
            "an axis, but settings are tuned for one controller; write it at the top of the file"
            " instead.",
            where="sweep.controller",
        )
    if spec.controller not in SETTINGS:
        raise ScenarioError(
            f'"{spec.controller}" shifts no gear and has nothing to tune; choose one of'
            f" {', '.join(SETTINGS)}.",
            where="controller",
        )


def _tuned(given: ScenarioSpec, judge: Judge, progress: Callable[[int, int], None] | None) -> Tuned:
    cases = judge.searched()
    search = Search(cases, judge.keys, judge.objective, judge.weight)
    before, best = judge.score(judge.start), judge.start
    stages: list[Stage] = []
    for stage in search.stages():
        stages.append(stage)
        if judge.score(stage.values).rank < judge.score(best).rank:
            best = stage.values
        if progress is not None:
            progress(len(stages), len(WIDTHS))
    if best == judge.start and stages:
        best = _nearby(judge, search, stages[-1])
    best = _frugal(judge, best)
    values = dict(zip((key.name for key in judge.keys), best, strict=True))
    return Tuned(
        spec=with_keys(given, judge.keys, best),
        pair=judge.recipe.pair.name,
        keys=judge.keys,
        values=values,
        before=before,
        after=judge.score(best),
        objective=judge.objective,
        interference_weight=judge.weight,
        cases=len(judge.cases),
        searched=len(cases),
        stages=tuple(stages),
        notes=tuple(_notes(given, judge, values)),
    )


def _nearby(judge: Judge, search: Search, last: Stage) -> tuple[float, ...]:
    """The best place beside the end of the search, or the start if the start is better.

    The smooth objective can end on the far side of an edge, such as a threshold that lies just
    above the largest deceleration; there the controller misses every reversal.
    """
    places = [judge.start, *search.neighbours(last.values)]
    return min(places, key=lambda values: judge.score(values).rank)


def _frugal(judge: Judge, best: tuple[float, ...]) -> tuple[float, ...]:
    """Put back every key that hardly matters, as long as the whole stays better than the start."""
    first, found = judge.score(judge.start), judge.score(best)
    while True:
        for place, start in enumerate(judge.start):
            back = (*best[:place], start, *best[place + 1 :])
            if back in (best, judge.start):
                continue
            score = judge.score(back)
            near = score.cost_deg <= found.cost_deg * (1 + _SAME)
            if near and score.rank[0] <= found.rank[0] and score.rank < first.rank:
                best = back
                break
        else:
            return best


def _notes(given: ScenarioSpec, judge: Judge, values: Mapping[str, float]) -> list[str]:
    before, after = judge.score(judge.start), judge.score(tuple(values.values()))
    notes: list[str] = []
    if not after.rank < before.rank:
        notes.append("The hard judgement found no values better than those before: they stay.")
    notes += [
        f"{key.name} ends at its limit, {values[key.name]:.4g}."
        for key in judge.keys
        if key.at_limit(values[key.name])
    ]
    if after.outcomes.get("bound"):
        notes.append(
            f"In {after.outcomes['bound']} cases the drive still blocks; they are not in the"
            " objective."
        )
    notes += [_more(name, after, before) for name in _ENDINGS if _count(after, name, before) > 0]
    if after.travel_mean_mm > _RESTLESS * max(before.travel_mean_mm, NEAR_MM):
        notes.append(
            f"The actuator travels {after.travel_mean_mm:.3g} mm a run, before"
            f" {before.travel_mean_mm:.3g}: the controller closes and opens while the shaft runs,"
            " which the objective does not count; give limits for what sees the deceleration."
        )
    if given.servo.motor != "prescribed":
        notes.append(
            "The search had a prescribed motion; the servo motor is in the hard judgement alone."
        )
    return notes


def _count(after: Score, name: str, before: Score) -> int:
    """Cases of an outcome that were not there before."""
    return after.outcomes.get(name, 0) - before.outcomes.get(name, 0)


def _more(name: str, after: Score, before: Score) -> str:
    cases, total = after.outcomes[name], sum(after.outcomes.values())
    if name == "missed" and cases == total:
        return (
            "The best that was found is not to close at all: what closing costs in interference is"
            " more than the gap; choose another controller or a smaller interference weight."
        )
    was = before.outcomes.get(name, 0)
    return f"In {cases} of {total} cases {_ENDINGS[name]} ({name}), before in {was}."
