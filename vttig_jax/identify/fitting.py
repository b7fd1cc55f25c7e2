"""From logs to parameters: the main job, in one function."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..base.errors import NoAnswerError
from ..base.runtime import require_x64
from ..base.threads import one_blas_thread
from ..logs.checks.ratio import SeenRatio, check_ratio
from ..logs.checks.slip import refuse_slip
from ..logs.encoder_log import EncoderLog
from ..logs.motion.flank_assignment import assigned_segments, find_ramps
from ..logs.motion.segments import Segments
from ..logs.readers.backlash_readings import BacklashReadings
from ..pair.gear_pair import Drive, GearPair
from ..pair.load import pair_from_spec
from ..pair.schema import HarmonicOrders
from .build_result import build_fit, estimate_of, solve_model
from .fit_result import Fit, FitRequest
from .found_orders.higher_orders import Higher, higher_orders
from .found_orders.line_orders import joined_lines
from .given_fit import prepared_model, select_given
from .log_requirements import (
    require_distinct,
    require_one_phase,
    require_pair,
    require_rows,
)
from .model.given_model import GivenModel
from .model.harmonics import Harmonic, TermPlan, names_of
from .model.identifiability import (
    FEW_TURNS,
    SINGLE_TURN,
    Identifiability,
    find_identifiability,
)
from .preliminary.linear_fit import Input
from .preliminary.model_selection import SelectedModel, select_model
from .preliminary.order_selection import entering_orders
from .preliminary.ramps import is_among_steady
from .report.check_records import Lines
from .report.estimate import Estimate
from .report.residual_tests import joint_lines
from .settings import FitSettings, from_keywords, takes_settings
from .solve.solved_fit import SolvedFit

_WORSE_THAN_NONE = 1 - 1.05**2
"""Least share of the variance that a fit explains; below it the residual is 5 % larger than that of
offset, drift and flanks alone (chosen)."""

_LEAST_RAMP = 16
"""Fewest samples of a ramp that counts for the delay: the smoothed speed does not follow shorter
ones, and the delay would come out too small (chosen)."""


@takes_settings
@one_blas_thread
def fit(
    log: EncoderLog | Sequence[EncoderLog],
    pair: GearPair | Drive | None = None,
    *,
    settings: FitSettings | None = None,
    orders: HarmonicOrders | None = None,
    readings: BacklashReadings | None = None,
    model: Any = None,
    **changes: Any,
) -> Fit:
    """Identify eccentricities, encoder errors and constant backlash from the logs of one rig.

    The transmission error of each flank is a linear model in the harmonics of both shafts. Its
    first orders follow from the parameters through the exact relation of the pair,

        r_b2 φ₂ = r_b1 φ₁ − (r_b1 + r_b2)(δ ± Δinv) (+ r_b2 j_c on flank B),

    plus + E₂ sin(φ₂ + ε₂) − i E₁ sin(φ₁ + ε₁) on both flanks; the other orders are free on each
    flank. A delay d of the driven channel is corrected by using the driving angle φ₁(t − d); this
    is repeated until d settles. The logs are compressed, their noise is autoregressive, and least
    squares in a trust region work on the compressed logs.

    **Arguments**
    - `log`: an encoder log or transmission-error curve, or several of one rig. They share
      eccentricities, orders, constant backlash and delay; offset and drift are each log's own.
    - `pair`: the gear pair, or a drive without geometry; by default the drive that the first log
      was read with, `read_log(path, ratio="64:23")`.
    - `settings`: delay, loss, drift, noise and all other choices; see `FitSettings`. Every field
      of it is a keyword of its own as well, `fit(log, pair, delay="off")`.
    - `orders`: harmonic orders to model; those of the pair by default.
    - `readings`: backlash read at single angles of the first log, to check the fit against, or to
      join it with `use_readings=True`.
    - `model`: flank model of your own that takes the place of the exact relation: a pytree with
      `transmission_error(angle, flank)`, rad of the driven gear, for driving angles in rad. Its
      leaves that are arrays of floating-point numbers are parameters, with their values as the
      start; they are found under "model" and their path, `fit.parameters["model.tilt"]`. Offset of
      each log, constant backlash, delay, drift and wind-up are fitted beside them, and `orders` are
      none by default; those given are free on each flank.

    **Returns** a `Fit`.

    **Raises** `UsageError` for a `model` that is no flank model, and for settings that contradict
    it; `LogError` for a log that contradicts the pair or another log, `NoAnswerError` for
    logs that are too short to say anything, `ValueError` for wrong arguments and without 64-bit
    floats, `TypeError` for a keyword that is no setting.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> result = vttig_jax.fit(rig.log(), rig.pair)
    >>> round(result.parameters["driving_eccentricity_mm"].value, 3)
    0.023

    ```
    """
    require_x64("fit")
    settings = from_keywords(settings, changes)
    if settings.use_readings and readings is None:
        raise ValueError("Argument `readings` must be given to be used, but is None.")
    logs = (log,) if isinstance(log, EncoderLog) else tuple(log)
    if not logs:
        raise ValueError("Argument `log` must hold at least one log, but is empty.")
    require_distinct(logs)
    pair = _stated_drive(logs[0]) if pair is None else pair
    found, ratios = [], []
    for one in logs:
        require_pair(one, pair)
        ratios.append(check_ratio(one))
        found.append(assigned_segments(one))
    given = None if model is None else prepared_model(model, logs, settings, found)
    wanted = orders or (pair.fit if given is None else HarmonicOrders((), (), 0))
    require_one_phase(logs, wanted, settings)
    task = _Task(logs, found, ratios, pair, settings, readings=readings, given=given)
    scope = task.scope(wanted)
    for one, each in zip(logs, found, strict=True):
        refuse_slip(one, each)
    result = _fitted(task, wanted, scope)
    if _is_worse_than_none(result):
        first = _first_only(wanted)
        result = _fitted(task, first, task.scope(first), told=())
        note = "higher orders are left out: with them the fit leaves more than without any order"
        warnings, notes = ((note, *own) for own in (result.warnings, result.notes))
        result = replace(result, warnings=warnings, notes=notes)
    if _is_worse_than_none(result):
        raise NoAnswerError(
            "the fit leaves more of the transmission error than offset, drift and flanks alone, so"
            " that the orders say nothing; record more turns.",
            where=result.source,
        )
    paths = tuple(log.path for log in logs)
    request = FitRequest(settings, wanted, _reading(logs), paths)
    return replace(result, request=request)


def _stated_drive(log: EncoderLog) -> GearPair | Drive:
    """Return the gears or the drive that the options of the log state, such as its ratio.

    **Raises** `ValueError` for a log that was read with a pair, because the log does not keep it.
    """
    if log.spec is None:
        raise ValueError(
            "Argument `pair` must be given for a log that was read with a pair, but is None."
        )
    return pair_from_spec(log.spec)


def _is_worse_than_none(result: Fit) -> bool:
    explained = result.checks.explained
    return explained is not None and explained < _WORSE_THAN_NONE


def _first_only(orders: HarmonicOrders) -> HarmonicOrders:
    """Return `orders` without all orders above the first of each shaft."""
    return HarmonicOrders(
        driving_orders=tuple(k for k in orders.driving_orders if k == 1),
        driven_orders=tuple(k for k in orders.driven_orders if k == 1),
        mesh_orders=0,
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """What is fitted: logs with segments and ratios, pair, settings, readings, flank model."""

    logs: Sequence[EncoderLog]
    found: Sequence[Segments]
    ratios: Sequence[SeenRatio]
    pair: GearPair | Drive
    settings: FitSettings
    readings: BacklashReadings | None
    given: GivenModel | None = None

    def scope(self, orders: HarmonicOrders, *, remembers: bool = False) -> Identifiability:
        """Return the flanks, segments and harmonics that the logs can determine of `orders`."""
        segments = [each.segments for each in self.found]
        return find_identifiability(
            self.logs,
            segments,
            self.pair,
            orders,
            self.settings.flank,
            remembers=remembers,
            given=self.given is not None,
            arcs=self.given is None,
            unclear="; ".join(each.unclear for each in self.found if each.unclear),
        )

    def selected(self, scope: Identifiability) -> tuple[Identifiability, SelectedModel]:
        """Return the scope, reduced to flanks that have block rows, and its selected model."""
        inputs = self._inputs(scope)
        if self.given is None:
            selected = select_model(inputs, self.pair, scope, self.settings)
        else:
            selected = select_given(inputs, self.pair, scope, self.settings, self.given)
        require_rows(selected.summary, ", ".join(log.source for log in self.logs))
        flanks = tuple(flank.flank for flank in selected.summary.flanks)
        return replace(scope, flanks=flanks), selected

    def _inputs(self, scope: Identifiability) -> tuple[Input, ...]:
        """Return the logs with the segments and ramps of the flanks that are fitted.

        If a shaft makes only a part of a turn, ramps beyond the steady motion are left out.
        """
        parts = zip(self.logs, self.found, scope.segments, self.ratios, strict=True)
        found = []
        for one, each, own, ratio in parts:
            ramps = tuple(
                ramp
                for ramp in find_ramps(one, each)
                if ramp.segment.flank in scope.flanks
                and ramp.segment.stop - ramp.segment.start >= _LEAST_RAMP
                and (not scope.short or is_among_steady(one, ramp, own))
            )
            found.append(Input(one, each, own, ramps, ratio))
        return tuple(found)

    def solved(self, scope: Identifiability, selected: SelectedModel) -> SolvedFit:
        """Return the parameters with the standard errors of the noise model."""
        return solve_model(selected, self.pair, scope, self.settings)

    def estimate(
        self, solved: SolvedFit, scope: Identifiability, selected: SelectedModel
    ) -> Estimate:
        """Return the parameters with standard errors that the log itself supports."""
        return estimate_of(
            solved, selected, self.pair, scope, settings=self.settings, readings=self.readings
        )


def _fitted(
    task: _Task, wanted: HarmonicOrders, scope: Identifiability, told: tuple[str, ...] | None = None
) -> Fit:
    """Select the model of the identifiable orders, `scope`, and fit it.

    On few turns only the orders that the log clearly shows stay in the model. Orders above the
    wanted ones that the log certainly shows are added first; `told` are the sentences on them, and
    None before they are searched. Certain spectral lines of the residual are then added as
    fractional orders.
    """
    scope, selected = task.selected(scope)
    fewer = _entering(task, wanted, scope, selected)
    if fewer is not None:
        scope, selected = task.selected(fewer)
    solved, lines = task.solved(scope, selected), Lines()
    if told is None:
        higher = _higher(task, solved, few_turns=scope.few_turns)
        joins = task.settings.lines == "join"
        told = () if higher is None else (higher.sentence(joined=joins),)
        if higher is not None and joins:
            more = higher.added(wanted)
            return _fitted(task, more, task.scope(more), told)
    scope = replace(scope, terms=_telling(scope.terms, told))
    if _may_join(solved, task.settings):
        # There is no second round: it would find what remains of lines that are no exact sines.
        joint = joint_lines(selected.linear.rows, solved.weights)
        joined = joined_lines(solved, joint, few_turns=scope.few_turns)
        lines = Lines(joint=joint)
        if joined is not None:
            wider = replace(scope, terms=_telling(joined.terms, (*told, *joined.notes)))
            scope, selected = task.selected(wider)
            solved, lines = task.solved(scope, selected), Lines(joined.lines)
    estimate = task.estimate(solved, scope, selected)
    return build_fit(
        selected, estimate, task.pair, identifiable=scope, settings=task.settings, lines=lines
    )


def _higher(task: _Task, solved: SolvedFit, *, few_turns: bool) -> Higher | None:
    """Return the orders above the wanted ones that the logs show, or None.

    They are not searched beside a flank model of the user, nor in logs without noise.
    """
    if task.given is not None or solved.noise.is_rounding:
        return None
    return higher_orders(solved, few_turns=few_turns)


def _entering(
    task: _Task, wanted: HarmonicOrders, scope: Identifiability, selected: SelectedModel
) -> Identifiability | None:
    """Return the scope with only those orders that the log clearly shows, for few turns.

    The result is None if the scope does not change.
    """
    if not SINGLE_TURN <= scope.turns["driving"] < FEW_TURNS:
        return None
    apart, sure = task.scope(wanted, remembers=True), scope.few_turns
    orders = entering_orders(selected.summary, apart.terms.free, wanted, any_noise=sure)
    if orders is None:
        return None
    entered = task.scope(orders, remembers=True)
    left_out = [h for h in apart.terms.free if h not in entered.terms.free]
    if not left_out and sure:
        return None
    plan = replace(entered.terms, dropped=apart.terms.dropped)
    return replace(entered, terms=_telling(plan, _not_entered(left_out)))


def _telling(terms: TermPlan, notes: tuple[str, ...]) -> TermPlan:
    """Return the harmonics with the sentences `notes` on orders left out added to `dropped`."""
    return replace(terms, dropped=(*terms.dropped, *notes))


def _not_entered(harmonics: Sequence[Harmonic]) -> tuple[str, ...]:
    """Return a sentence on orders that are not in the model, because few turns do not show them."""
    if not harmonics:
        return ()
    are, they, them = ("is", "it is", "it") if len(harmonics) == 1 else ("are", "they are", "them")
    return (
        f"{names_of(harmonics)} {are} not in the model: on so few turns {they} not larger than"
        f" noise. Maps and curves do not contain {them}; record more turns",
    )


def _may_join(solved: SolvedFit, settings: FitSettings) -> bool:
    """Return whether lines of the residual may join the model.

    A line has one phase only in logs with a common zero.
    """
    one_zero = solved.linear.model.same_zero or len(solved.linear.rows) == 1
    return settings.lines == "join" and one_zero and not solved.noise.is_rounding


def _reading(logs: Sequence[EncoderLog]) -> Mapping[str, Any]:
    """Return the keywords of `read_log` that all logs have in common."""
    first, *others = (log.keywords for log in logs)
    return {
        name: value for name, value in first.items() if all(o.get(name) == value for o in others)
    }
