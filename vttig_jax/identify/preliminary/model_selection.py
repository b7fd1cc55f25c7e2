"""Selection of delay, drift and regressors by passes over the logs.

A pass fits the linear model to the block rows. It shows which drift, delay and regressors are
significant, how the delay must change, and which weight each sample gets. A further pass is made
only if the delay or the weights change.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from ...logs.encoder_log import EncoderLog
from ...logs.motion.crossing import crossed_gap
from ...logs.motion.segments import legs_of
from ...pair.gear_pair import Drive, GearPair
from ..compress.harmonic_summary import HarmonicSummary
from ..compress.regressors import Drift
from ..model.column_layout import column_of, is_given
from ..model.given_model import GivenModel
from ..model.identifiability import SINGLE_TURN, Identifiability
from ..settings import FitSettings
from .delay import Delay, judge_delay, one_speed
from .delay_check import delay_bound_s, explaining, is_told_on_one_flank
from .linear_fit import Input, LinearFit, Model, linear_fit
from .nuisance import NuisanceRegression
from .ramps import finest_row_s, with_ramps
from .robust import Reweighted, reweighted
from .robust_start import with_second_start

AUTOMATIC_DRIFT = 2
"""Highest power of time of the drift if the user requests no drift; chosen value."""


def drift_names(names: Sequence[str], order: int) -> list[str]:
    """Return the entries of `names` that are drift coefficients of powers of time 1 … `order`."""
    powers = {f"drift_{power}" for power in range(1, order + 1)}
    return [name for name in names if name.split("_of_")[0] in powers]


def choose_drift(own: NuisanceRegression, beside: Sequence[str] = ()) -> int:
    """Return the highest power of time of the drift, 0 to 2, by the lowest BIC.

    `beside` names further coefficients of the models. All models have the noise model of power 2;
    with a separate noise model for each, a missing drift would look like correlated noise.
    """
    if own.is_exact:
        return 0
    scores = [
        own.bic([*drift_names(own.names, order), *beside]) for order in range(AUTOMATIC_DRIFT + 1)
    ]
    return scores.index(min(scores))


_MOST_STEPS = 10  # largest number of passes that find the delay; chosen value
_TURNS_FOR_DRIFT = 2.0
"""With fewer turns, the first order of a shaft resembles the curvature of a drift."""

_WRONG_RATIO = 12.0
"""Standard errors of the ratio above which a log contradicts the given ratio of a drive; chosen
value. Robot axes of known ratio reach nine, because their slow errors resemble a slope."""
_FARTHEST_RATIO = 0.05  # relative deviation above which a ratio is taken for a drift; chosen value

_TOLD_APART = 1e-10
"""Columns of a given model are kept if more than this share of their squares is unexplained."""

_SIGNIFICANT = 4.0  # a torque coefficient that is not requested is kept above these std (chosen)


@dataclass(frozen=True, eq=False)
class SelectedModel:
    """Selected model and compressed logs, the input of the solver.

    **Arguments**
    - `linear`: fit of the last pass. - `summary`: rows of all logs with the selected columns only.
    - `least`: the part of the drift that does not resemble the gap; None if that is all of it.
    - `crossed`: gap of each log in rad by its crossings beside a drift; empty unless a drift that
      resembles the gap was left out because of them.
    - `delay`, `drift`: selected delay and drift. - `weights`: result of the robust loss.
    - `notes`: sentences for the report.
    """

    linear: LinearFit
    summary: HarmonicSummary
    delay: Delay
    drift: Drift
    weights: Reweighted
    notes: tuple[str, ...]
    least: Drift | None = None
    crossed: tuple[float, ...] = ()


def select_model(
    inputs: tuple[Input, ...],
    pair: GearPair | Drive,
    identifiable: Identifiability,
    settings: FitSettings,
    given: GivenModel | None = None,
) -> SelectedModel:
    """Select the nuisance parameters, delay, drift and weights of the fit, and compress the logs.

    The harmonics are those of `identifiable`. `given` is a flank model of the user. One pass over
    the logs is always made; a delay, a doubtful ratio and a robust loss need more passes.
    """
    if _has_slope(pair, identifiable, settings):
        settings = msgspec.structs.replace(settings, drift_order=1)
    plain, delay, notes = plain_fit(inputs, pair, identifiable, settings, given)
    model, names = plain.model, plain.model.regressors
    delay_tried = "delay" in names
    finest_s = finest_row_s(inputs) if delay_tried else np.inf
    # A missing delay also looks like a slope, so the ratio is tested with the delay in the model.
    if delay_tried and "ratio" not in names and _may_hide_a_ratio(pair, identifiable):
        freed = replace(model, regressors=(*names, "ratio"))
        other = linear_fit(inputs, freed, delay.seconds, finest_s=finest_s)
        if _demands_a_ratio(other, settings, float(pair.ratio)):
            model, plain = freed, other
    weights = with_second_start(reweighted(plain, settings.loss), plain)
    linear = weights.linear
    if delay_tried:
        short = len(identifiable.short) == 2
        linear, delay, told = _with_delay(weights, settings, short=short)
        if weights.loss != "square" and delay.state == "fitted":
            # The first weights come from a model without the delay and, in ramps, from spikes only.
            weights = reweighted(
                linear, weights.loss, weights.values if weights.loss == "bisquare" else None
            )
            plain = weights.look(inputs, model, delay.seconds, linear.block_s)
            looked = replace(weights, linear=plain)
            linear, delay, told = _with_delay(looked, settings, delay.share, short=short)
        notes += told
    own, told = _chosen(linear, settings, delay)
    notes += told
    drift, told_apart = _drift_of(own, model.drift), _drift_beside_gap(inputs, identifiable)
    kept = [
        tuple(n for n in each if n in own or n == "offset") for each in linear.summary.columns.own
    ]
    selected = SelectedModel(
        linear=linear,
        summary=linear.summary.keeping(kept),
        delay=delay,
        drift=drift,
        weights=weights,
        notes=tuple(notes),
        least=Drift(told_apart) if drift.order > told_apart and not settings.states_drift else None,
    )
    return _with_crossings(selected, inputs)


def _with_crossings(selected: SelectedModel, inputs: Sequence[Input]) -> SelectedModel:
    """Leave out a drift that resembles the gap if crossings after reversals show the gap beside it.

    A drift in time takes seconds, and a crossing takes a travel of the driving shaft.
    """
    least = with_least_drift(selected)
    if least is None or any(one.log.torque is not None for one in inputs):
        return selected
    order = selected.drift.order
    crossed = [
        crossed_gap(one.log, one.found, order) for one in inputs if legs_of(one.segments) > 1
    ]
    return replace(least, crossed=tuple(crossed)) if crossed and min(crossed) > 0 else selected


def with_least_drift(selected: SelectedModel) -> SelectedModel | None:
    """Return the selected model with the drift `least`, or None if there is none."""
    if selected.least is None:
        return None
    kept = {f"drift_{power}" for power in range(1, selected.least.order + 1)}
    own = [
        tuple(name for name in each if not name.startswith("drift_") or name in kept)
        for each in selected.summary.columns.own
    ]
    summary = selected.summary.keeping(own)
    return replace(selected, summary=summary, drift=selected.least, least=None)


def _drift_beside_gap(inputs: Sequence[Input], identifiable: Identifiability) -> int:
    """Return the highest power of time of a drift that does not resemble the gap.

    If a shaft makes only a part of a turn, its unknown first order is a slow function of the
    angle, and a drift follows it in each direction. A drift of power p then resembles the gap in a
    log of fewer than p + 2 legs, which are parts in one direction.
    """
    if len(identifiable.flanks) < 2 or not identifiable.short:
        return AUTOMATIC_DRIFT
    legs = max((legs_of(one.segments) for one in inputs), default=0)
    return min(max(legs - 2, 0), AUTOMATIC_DRIFT)


def plain_fit(
    inputs: tuple[Input, ...],
    pair: GearPair | Drive,
    identifiable: Identifiability,
    settings: FitSettings,
    given: GivenModel | None,
) -> tuple[LinearFit, Delay, list[str]]:
    """Return the fit of the first pass with all candidate columns, its delay, and notes."""
    names, delay, notes = _candidates(inputs, settings, _has_open_ratio(pair, identifiable))
    model = Model(
        pair=pair,
        terms=identifiable.terms,
        regressors=names,
        drift=_widest_drift(settings, pair, identifiable),
        same_zero=have_one_zero([one.log for one in inputs], settings),
        noise=settings.noise_model,
        given=given,
    )
    finest_s = finest_row_s(inputs) if "delay" in names else np.inf
    return linear_fit(inputs, model, delay.seconds, finest_s=finest_s), delay, notes


def have_one_zero(logs: Sequence[EncoderLog], settings: FitSettings) -> bool:
    """Return whether the shaft angles of all logs have the same zero."""
    if settings.same_zero is not None:
        return settings.same_zero
    return all(log.zero == "reading" for log in logs)


def _candidates(
    inputs: Sequence[Input], settings: FitSettings, open_ratio: bool
) -> tuple[tuple[str, ...], Delay, list[str]]:
    """Return the candidate columns except offset and drift, the initial delay, and notes.

    If `open_ratio` is True, the error of the given ratio is a candidate.
    """
    names: list[str] = list(settings.regressors)
    notes: list[str] = []
    if all(one.log.torque is not None for one in inputs) and "torque" not in names:
        names.append("torque")
    if settings.free_ratio or open_ratio:
        names.append("ratio")
    if "speed" in names:
        reason = "a delay and a regressor proportional to speed are the same"
        return tuple(names), Delay("open", reason=reason), notes
    if not isinstance(settings.delay, str):
        reason = f"given as {settings.delay:g} s, not fitted"
        return tuple(names), Delay("given", settings.delay, reason=reason), notes
    if settings.delay == "off":
        reason = "not fitted: both channels are taken to be sampled at the same instant"
        return tuple(names), Delay("off", reason=reason), notes
    return (*names, "delay"), Delay("open"), notes


def _has_open_ratio(pair: GearPair | Drive, identifiable: Identifiability) -> bool:
    """Return whether the error of the ratio must be fitted, because it would bias other terms.

    This is so for a drive with few turns in both directions. Tooth counts make the ratio of a gear
    pair exact, and many turns show a wrong ratio. A single turn cannot separate a slope from the
    first order, and in one direction the slope is fitted as a drift.
    """
    both_ways = len(identifiable.flanks) == 2
    return both_ways and "driven" not in identifiable.short and _may_be_off(pair, identifiable)


def _may_be_off(pair: GearPair | Drive, identifiable: Identifiability) -> bool:
    more_than_one = identifiable.turns["driving"] >= SINGLE_TURN
    return isinstance(pair, Drive) and identifiable.few_turns and more_than_one


def _has_slope(
    pair: GearPair | Drive, identifiable: Identifiability, settings: FitSettings
) -> bool:
    """Return whether a drift absorbs a wrong ratio: on few turns of a drive in one direction."""
    one_way = len(identifiable.flanks) == 1 and not settings.free_ratio
    return one_way and not settings.states_drift and _may_be_off(pair, identifiable)


def _may_hide_a_ratio(pair: GearPair | Drive, identifiable: Identifiability) -> bool:
    """Return whether a wrong ratio of a drive may remain unseen in the slope of the log.

    If the driven shaft makes only a part of a turn, its unknown first order adds to the slope.
    """
    both_ways = len(identifiable.flanks) == 2
    return isinstance(pair, Drive) and both_ways and "driven" in identifiable.short


def _demands_a_ratio(linear: LinearFit, settings: FitSettings, ratio: float) -> bool:
    """Return whether a fit with a free ratio contradicts the given `ratio` by a possible value."""
    own = linear.own
    names = [*_beside(own, settings), *(["delay"] if "delay" in own.names else [])]
    value, std = own.estimate("ratio", names)
    return _WRONG_RATIO * std < abs(value) < _FARTHEST_RATIO * abs(ratio)


def _widest_drift(
    settings: FitSettings, pair: GearPair | Drive, identifiable: Identifiability
) -> Drift:
    """Return the drift that the user requests, or else the highest drift that may be selected.

    Without a request it is `AUTOMATIC_DRIFT`, or no drift in two cases: on both flanks with
    `few_turns`, where a drift resembles the gap, and if a shaft whose first order is reported makes
    fewer than `_TURNS_FOR_DRIFT` turns, where a drift resembles this order.
    """
    if settings.drift_knots_s is not None:
        return Drift(knots_s=settings.drift_knots_s)
    if settings.drift_order is not None:
        return Drift(settings.drift_order)
    if len(identifiable.flanks) == 2 and identifiable.few_turns:
        return Drift(0)
    tied = [
        identifiable.turns[shaft]
        for shaft in identifiable.turns
        if shaft not in identifiable.reasons
    ]
    return Drift(AUTOMATIC_DRIFT if min(tied, default=0.0) >= _TURNS_FOR_DRIFT else 0)


def _with_delay(
    weights: Reweighted, settings: FitSettings, share: float = 1.0, *, short: bool
) -> tuple[LinearFit, Delay, list[str]]:
    """Iterate the delay until it is settled; at one speed, the fit includes the ramps.

    `share` is that of the delay (see `Delay`) if the first pass already settles it. `short` is as
    in `judge_delay`.
    """
    plain = weights.linear
    inputs, model, block_s = plain.inputs, plain.model, plain.block_s
    steady = one_speed([s for one in inputs for s in one.segments])
    bound_s, steps, step_s = delay_bound_s(inputs, settings), 0, 0.0
    while True:
        steps += 1
        linear, notes = with_ramps(plain) if steady else (plain, [])
        delay = judge_delay(
            linear.own,
            _beside(linear.own, settings),
            plain.channels[0].delay_s,
            forced=settings.delay == "free" or is_told_on_one_flank(plain),
            two_flanks=len(linear.summary.flanks) == 2,
            steady=steady,
            within_s=bound_s,
            short=short,
        )
        delay = delay.after(step_s) if step_s else replace(delay, share=share)
        if delay.is_settled or steps == _MOST_STEPS:
            break
        step_s, delay = delay.step_s, delay.stepped()
        plain = weights.look(inputs, model, delay.seconds, block_s)
    delay = explaining(delay, weights, plain, bound_s=bound_s)
    if delay.state != "fitted":
        moved = plain.channels[0].delay_s != 0
        return weights.look(inputs, model, 0.0, block_s) if moved else plain, delay, []
    return linear, delay, notes


def _beside(own: NuisanceRegression, settings: FitSettings) -> list[str]:
    """Return the selected coefficients other than the delay: drift, regressors, best torque."""
    slow = ("drift_", "spline_", "torque_")
    others = [n for n in own.names if n != "delay" and not n.startswith(slow)]
    splines = [n for n in own.names if n.startswith("spline_")]
    if settings.drift_order is not None or splines:
        drift = [n for n in own.names if n.startswith(("drift_", "spline_"))]
    else:
        windows = [n for n in own.names if n.startswith("torque_")][:1]
        asked = [*others, *windows, *(["delay"] if "delay" in own.names else [])]
        drift = drift_names(own.names, choose_drift(own, asked))
    known = [*drift, *others]
    return [*known, *_best_torque(own, known)]


def _best_torque(own: NuisanceRegression, known: list[str]) -> list[str]:
    """Return the torque average, if any, that has the least misfit with `known` and the delay."""
    windows = [n for n in own.names if n.startswith("torque_")]
    beside = [*known, *(["delay"] if "delay" in own.names else [])]
    return [min(windows, key=lambda name: own.misfit([*beside, name]))] if windows else []


def _chosen(linear: LinearFit, settings: FitSettings, delay: Delay) -> tuple[set[str], list[str]]:
    """Return the names of the selected columns of drift, delay and regressors, and notes."""
    own = linear.own
    fitted = ["delay"] if delay.state == "fitted" else []
    names = [*_beside(own, settings), *fitted]
    notes = []
    for torque in [n for n in names if n.startswith("torque_")]:
        value, std = own.estimate(torque, names)
        if abs(value) <= _SIGNIFICANT * std and "torque" not in settings.regressors:
            names.remove(torque)
            notes.append(
                "the torque column shows no wind-up that counts"
                f" ({abs(value) / std:.1f} standard errors, {_SIGNIFICANT:g} are asked for);"
                " wind-up under a steady torque is part of the apparent backlash"
            )
    names = [n for n in names if not is_given(n) or own.left(n) > _TOLD_APART]
    return {column_of(name) for name in names}, notes


def _drift_of(names: set[str], widest: Drift) -> Drift:
    if widest.knots_s:
        return widest
    return Drift(sum(name.startswith("drift_") for name in names))
