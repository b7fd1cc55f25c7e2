"""Error table of the axis of a run: the correction, what it leaves over a travel, and its file."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.special import gammaincinv

from ..base.errors import NoAnswerError, UsageError
from ..base.files.text_tables import key_values
from ..base.results import TextResult
from ..base.units import ARCSEC, DEG, REV
from ..control.compensation import correction
from ..control.compensation.correction import AxisError, CorrectionTable, Curve, Left
from ..identify.orders import is_fractional
from ..identify.result import Fit
from ..kinematics.flank_error import POINTS_PER_PERIOD, errors_at
from ..model.parameters import FULL_TURN
from ..model.rows import SHAFTS
from ..pair.gear_pair import Flank
from ..posterior.rig_draws import flanks_of
from ..posterior.summary.gap_draws import GapDraws
from ..posterior.summary.posterior import Posterior
from .error_table import left_out_rows, measured_error, origin

AxisName = Literal["driven", "driving"]

INTERVALS = 255
"""Intervals of a table by default: what LinuxCNC holds."""

_MOST_POINTS, _MOST_DRAWS = 2**15, 200
"""Positions of a travel at which a prediction is made, and draws of its band (chosen)."""

_FOLLOWED = 0.25
"""LinuxCNC follows a table exactly up to this share of acceleration times servo period a second."""


class AxisSetting(NamedTuple):
    """Axis of a control: its shaft, where its zero is and which way it counts.

    **Arguments**
    - `shaft`: shaft that the axis is. - `zero_deg`: position of the axis where this shaft has the
      angle zero in the fit. - `reversed`: whether the axis counts against the fit.
    - `travel_deg`: first and last position of the table; one turn of the axis by default.
    - `over_deg`: travel of the axis, beyond the ends of the table too; that of the table by
      default.
    - `place_known`: whether the control knows the turn within the hunting period.
    """

    shaft: AxisName = "driven"
    zero_deg: float = 0.0
    reversed: bool = False
    travel_deg: tuple[float, float] | None = None
    over_deg: tuple[float, float] | None = None
    place_known: bool = True


@dataclass(frozen=True)
class AxisTable(TextResult):
    """Error table of an axis with its prediction.

    **Arguments**
    - `fit`: fit of the run. - `axis`: the axis. - `table`: corrections, in single precision.
    - `before`, `after`: direction → what the axis shows over the travel without and with the table.
    - `after95`: direction → rms with the table at 2.5 and 97.5 % of the draws, rad.
    - `lost`: rms of the difference between both directions without and with the table, rad; None
      for one direction, or if the log does not determine the gap.
    - `turns`: turns of the axis that the travel is repeated in.
    """

    fit: Fit
    axis: AxisSetting
    travel_deg: tuple[float, float]
    over_deg: tuple[float, float]
    table: CorrectionTable
    before: dict[str, Left]
    after: dict[str, Left]
    after95: dict[str, tuple[float, float]]
    lost: tuple[float, float] | None
    turns: int

    def fastest_deg_s(self, acceleration_deg_s2: float, servo_s: float) -> float:
        """Return the largest speed of the axis, °/s, at which LinuxCNC follows the table."""
        return _FOLLOWED * acceleration_deg_s2 * servo_s / max(self.table.steepest, 1e-300)

    def provenance(self, version: str) -> tuple[str, ...]:
        """Return lines that say what the table is, and which `version` made it from what."""
        fit, axis = self.fit, self.axis
        return (
            f"vttig {version}: corrections in degrees, added to the command",
            f"pair {fit.pair.name}; log {fit.source}; SHA-256 {fit.sha256}",
            f"axis: {axis.shaft} shaft{', reversed' * axis.reversed},"
            f" {axis.zero_deg:.9g} deg where the fit has its zero",
            *(f"conditional on {one}" for one in fit.conditional_on),
            *(f"{name} {text}" for name, text in self._rows() if name in (*self.before, "travel")),
        )

    def to_json(self, out: Path) -> dict[str, Any]:
        """Return the object of schema `vttig.correction/1`; `out` is the path of the file."""
        arcsec = lambda left: {"rms": left.rms / ARCSEC, "peak": left.peak / ARCSEC}  # noqa: E731
        return {
            "schema": "vttig.correction/1",
            **origin(self.fit),
            "quantity": "error",
            "file": out.name,
            "meaning": "corrections, degrees of the axis, to add to its command at these positions;"
            " linear between them, and held beyond the ends",
            "axis": self.axis.shaft,
            "axis_zero_deg": self.axis.zero_deg,
            "reversed": self.axis.reversed,
            "travel_deg": list(self.travel_deg),
            "over_deg": list(self.over_deg),
            "turns": self.turns,
            "place_known": self.axis.place_known,
            "positions_deg": np.degrees(self.table.positions).tolist(),
            "corrections_deg": {
                name: np.degrees(values).tolist() for name, values in self.table.values.items()
            },
            "before_arcsec": {name: arcsec(one) for name, one in self.before.items()},
            "after_arcsec": {
                name: arcsec(one) | {"rms95": [end / ARCSEC for end in self.after95[name]]}
                for name, one in self.after.items()
            },
            "lost_motion_arcsec": None
            if self.lost is None
            else dict(zip(("before", "after"), (one / ARCSEC for one in self.lost), strict=True)),
            "left_out": [one.to_json() for one in self.fit.orders if is_fractional(one)],
        }

    def _rows(self) -> list[tuple[str, str]]:
        (start, stop), positions = self.travel_deg, np.degrees(self.table.positions)
        step = (positions[-1] - positions[0]) / (len(positions) - 1)
        where = f"{self.over_deg[0]:g}° … {self.over_deg[1]:g}°"
        if self.turns > 1:
            where += f", in any of the {self.turns} turns of the hunting period"
        rows = [
            ("axis", f"{self.axis.shaft} shaft"),
            ("table", f"{start:g}° … {stop:g}°, {len(positions)} positions {step:.6g}° apart"),
            ("travel", where),
        ]
        shown = lambda one: f"{one.rms / ARCSEC:.3g}″ rms, {one.peak / ARCSEC:.3g}″ at most"  # noqa: E731
        for name, before in self.before.items():
            low, high = (end / ARCSEC for end in self.after95[name])
            left = f"{low:.3g}″ … {high:.3g}″ rms (95 %), without noise {shown(self.after[name])}"
            rows.append((name, f"{shown(before)}; with the table {left}"))
        if self.lost is not None:
            before, after = (f"{one / ARCSEC:.3g}″ rms" for one in self.lost)
            rows.append(("lost motion", f"{before}; with the table {after}"))
        return rows

    def __str__(self) -> str:
        rows = self._rows()
        if len(self.table.values) < 2:
            only = " ".join(self.table.values)
            rows.append(("one direction", f"{only}; a file with both has its values twice"))
        elif self.lost is None:
            rows.append(("lost motion", "it stays, because the log does not determine the gap"))
        rows += left_out_rows(self.fit)
        rows.append(("contains", "also what the encoder of the driven shaft adds once per turn"))
        return key_values(rows, title="error table of the axis")


class AxisCurves(NamedTuple):
    """Error of the axis of a run.

    **Arguments**
    - `error`: that of the fit. - `drawn`: that of its draws, or of Student's t of the fit.
    - `turns`: turns of the axis after which it repeats. - `has_gap`: whether the log determines the
      gap, so that both directions have one zero.
    """

    error: AxisError
    drawn: AxisError
    turns: int
    has_gap: bool


def axis_curves(fit: Fit, posterior: Posterior | None, axis: AxisSetting) -> AxisCurves:
    """Return the error of the axis, as far as its control can tell where it is."""
    ratio = float(fit.pair.ratio)
    gain = (ratio if axis.shaft == "driven" else 1.0) * (-1 if axis.reversed else 1)
    driven = [place for place, (_, count) in enumerate(fit.model.terms) if count]
    own = np.abs(np.asarray(fit.model.cosine)) + np.abs(np.asarray(fit.model.sine))
    alike = axis.shaft == "driving" and not np.any(own[:, driven])
    turns = 1 if alike else max(1, round(abs(gain) * fit.pair.hunting_turns))
    flanks, zero_mean, model, draws = measured_error(fit, posterior)
    # The log begins in the forward direction, as homing does, which has the mean zero.
    ahead: Flank = "A" if gain > 0 else "B"
    period = np.arange(2**12) * (fit.pair.hunting_turns * REV / 2**12)
    if any(fit.core.scope.turns[shaft] < FULL_TURN for shaft in SHAFTS):
        # A table of a part of a turn holds, and has its zero, where the log covers.
        model, draws = drawn_from(fit, fit.core.posterior.moved[None]).mean_model, None
        period = fit.core.scope.covered
        zero_mean = flanks[: 1 if len(fit.core.scope.flanks) == 2 else 2]
    draws = student_draws(fit) if draws is None else draws
    every = slice(None, None, max(1, len(draws.offset) // _MOST_DRAWS))
    parts = {name: getattr(draws, name)[every] for name in ("offset", "cosine", "sine", "batch")}
    few = replace(draws, **parts)

    known = (0,) if axis.place_known else tuple(range(turns))

    def error_of(curve: Callable[[np.ndarray, Flank], np.ndarray], period: np.ndarray):
        def less(flank: Flank) -> Curve:
            level = curve(period, flank if zero_mean == flanks else ahead).mean(axis=0)
            return lambda angle: curve(angle, flank) - level

        curves: dict[Flank, Curve] = {flank: less(flank) for flank in flanks}
        return AxisError(curves, ratio, gain, axis.zero_deg * DEG, known)

    error = error_of(lambda angle, flank: errors_at(model, flank, angle), period)
    return AxisCurves(
        error,
        error_of(few.errors, period[:: max(1, len(period) // 512)]),
        turns,
        zero_mean != flanks,
    )


def student_draws(fit: Fit) -> GapDraws:
    """Return draws of the orders of both flanks from the fit: each has its Student's t."""
    posterior = fit.core.posterior
    whole = np.eye(len(posterior.problem.columns))
    mean, covariance, freedom = posterior.told(whole, moved=True)
    values, axes = np.linalg.eigh(covariance)
    random = np.random.default_rng(0)
    normals = random.standard_normal((_MOST_DRAWS, len(mean)))
    # The symmetric root does not depend on the signs and the order of the axes.
    drawn = (normals - normals.mean(axis=0)) @ (axes * np.sqrt(np.maximum(values, 0))) @ axes.T
    # One scale a draw: the noise that the log hardly tells is the same for all orders.
    share = random.uniform(size=(_MOST_DRAWS, 1))
    drawn = drawn * np.sqrt(freedom / (2 * gammaincinv(freedom / 2, share)))
    return drawn_from(fit, mean + drawn)


def drawn_from(fit: Fit, coefficients: np.ndarray) -> GapDraws:
    """Return the errors of both flanks for draws of the coefficients, shape (draws, columns)."""
    series = flanks_of(fit, coefficients, bends=True)
    return GapDraws(fit.pair, tuple(fit.model.terms), *series, np.arange(len(coefficients)))


def axis_table(
    fit: Fit,
    posterior: Posterior | None,
    axis: AxisSetting = AxisSetting(),
    step_deg: float | None = None,
) -> AxisTable:
    """Return the error table of the axis of a fit, with what it leaves over its travel.

    **Arguments**
    - `posterior`: draws, which give the band of what is left; by default Student's t of the fit.
    - `step_deg`: distance of the nodes; the 255th part of the travel by default.

    **Raises** `UsageError` for a travel that the control cannot place or the log does not cover, or
    a step that does not divide it; `NoAnswerError` for a table that would leave more than none.
    """
    error, drawn, turns, has_gap = axis_curves(fit, posterior, axis)
    travel = axis.travel_deg
    if travel is None:
        if turns > 1 and axis.place_known:
            raise UsageError(
                f"a turn of the axis does not repeat: the same teeth meet again after {turns} of"
                " its turns. Give --travel FROM TO with the place within them that homing finds, or"
                " --place-unknown for the mean of all turns.",
                where=fit.source,
            )
        travel = (axis.zero_deg, axis.zero_deg + 360.0)
    over = travel if axis.over_deg is None else axis.over_deg
    for low, high in (travel, over):
        if not high > low:
            raise UsageError(f"from {low:g}° to {high:g}° is no travel; give FROM below TO.")
    start, stop = (DEG * end for end in travel)
    if not axis.place_known and max(stop - start, DEG * (over[1] - over[0])) > REV * (1 + 1e-9):
        raise UsageError(
            "where the turn is unknown, a travel is one turn at most; give --travel FROM TO."
        )
    step = (stop - start) / INTERVALS if step_deg is None else step_deg * DEG
    table = correction.correction_table(error, start, stop, step).in_float32()
    order = max(fit.model.highest_order, 1.0) / abs(error.gain)
    first, last = (DEG * end for end in over)
    count = max(POINTS_PER_PERIOD * order / REV, 8 / step) * (last - first)
    position = np.linspace(first, last, min(math.ceil(count) + 1, _MOST_POINTS))
    alike = axis.shaft == "driving" and turns == 1
    _require_covered(fit, error, position, every_turn=alike)
    shown = {name: correction.left_over(error, None, name, position) for name in error.directions}
    left = {name: correction.left_over(error, table, name, position) for name in error.directions}
    before = {name: correction.size(one) for name, one in shown.items()}
    after = {name: correction.size(one) for name, one in left.items()}
    for name, one in after.items():
        if one.rms >= before[name].rms or one.peak > before[name].peak:
            raise NoAnswerError(
                f"over {over[0]:g}° … {over[1]:g}° this table would leave"
                f" {one.rms / ARCSEC:.4g}″ rms, {one.peak / ARCSEC:.4g}″ at most {name}; without"
                f" it {before[name].rms / ARCSEC:.4g}″ and {before[name].peak / ARCSEC:.4g}″ are"
                " there. Give the whole travel with --travel, or a smaller --step-deg.",
                where=fit.source,
            )
    lost = None
    if has_gap:
        lost = (
            correction.size(shown["forward"] - shown["reverse"]).rms,
            correction.size(left["forward"] - left["reverse"]).rms,
        )
    after95, some = {}, position[:: max(1, len(position) // 2048)]
    for name in drawn.directions:
        rms = np.sqrt(np.mean(correction.left_over(drawn, table, name, some) ** 2, axis=(0, 1)))
        after95[name] = tuple(np.quantile(rms, [0.025, 0.975]).tolist())
    return AxisTable(fit, axis, travel, over, table, before, after, after95, lost, len(error.turns))


def _require_covered(fit: Fit, error: AxisError, position: np.ndarray, *, every_turn: bool) -> None:
    """Refuse positions beyond what the log covers, if it did not show whole turns of both shafts.

    `every_turn`: whether any turn of the driving shaft tells all others.
    """
    short = [shaft for shaft in SHAFTS if fit.core.scope.turns[shaft] < FULL_TURN]
    if not short or (every_turn and short == ["driven"]):
        return
    for name, flank in error.directions.items():
        seen = fit.coverage.holds((position - error.zero) / error.gain, flank)
        if not seen.all():
            ends = np.degrees(position[seen][[0, -1]]) if seen.any() else ()
            raise UsageError(
                f"the log covers {math.floor(100 * seen.mean())} % of this travel {name}"
                f" ({' … '.join(f'{end:.6g}°' for end in ends) or 'none'}) and no whole turn of the"
                f" {' and the '.join(short)} shaft, so that nothing tells the rest; give a --travel"
                " that it covers, with --axis-zero-deg if the log does not begin at 0, or log more:"
                " what is run at changing speed does not count.",
                where=fit.source,
            )
