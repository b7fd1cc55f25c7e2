"""What a fit was made of, and the computation of its checks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import PurePath

import msgspec
import numpy as np
from jaxtyping import Float

from ..base.units import ARCSEC, DEG, REV
from ..kinematics.flank_model import FlankModel, flank_index
from ..kinematics.harmonic import OrderModel
from ..kinematics.te_curve import TECurve
from ..logs.channel.speed import robust_deviation
from ..logs.checks.ratio import SeenRatio
from ..logs.encoder_log import EncoderLog
from ..logs.lines.search import Line
from ..logs.motion.segments import Segment, Segments
from ..model.columns import DELAY, GAP
from ..model.density import LAGS, whitening
from ..model.mixed_fit import NEEDED, MixedFit, likelihood_ratio, residuals
from ..model.parameter import OPEN, Parameter
from ..model.parameters import gap_row
from ..pair.gear_pair import Drive, Eccentricities, GearPair
from ..pair.schema import Flank
from .given import GivenModel
from .orders import mounted_exact
from .records import (
    Checks,
    Closure,
    CoveredGap,
    DelayOfPart,
    FoundLine,
    GapAtSpeed,
    JumpComparison,
    Noise,
    RatioCheck,
    ReadingsComparison,
    Reversal,
)

_SPEEDS, _APART = 8, 0.15

_NEAR_DEG, _WINDOW_DEG = 1.0, 5.0
"""The passes before and after a reversal are compared in a window of driving angles. These are its
smallest distance from the turning point and its width, deg of the driving shaft; chosen values."""

_GAPS = 1.5
"""Smallest distance from the turning point to the window, in gaps; above 1 because the gap varies
with the angle. Chosen value."""


@dataclass(frozen=True, eq=False)
class Identified:
    """The mixed model fitted to logs, and what was seen of them at the door.

    `short`: flanks without a stroke that is long enough. `given`: flank model of the user.
    """

    logs: Sequence[EncoderLog]
    core: MixedFit
    lines: list[Line]
    segments: list[Segments]
    ratios: list[SeenRatio]
    short: tuple[Flank, ...]
    given: GivenModel | None = None

    def name(self, log: int) -> str:
        """Return the name of a log and a colon, or nothing for a single log."""
        return f"{PurePath(self.logs[log].source).name}: " if len(self.logs) > 1 else ""


def checks_of(
    found: Identified,
    pair: GearPair | Drive,
    parameters: dict[str, Parameter],
    curves: tuple[TECurve, ...],
    model: FlankModel,
    readings: ReadingsComparison | None,
) -> Checks:
    """Return the checks of a fit."""
    core = found.core
    needed = {
        group: likelihood_ratio(core, group) for group in ("drift", "delay_parts", "gap_by_speed")
    }
    gap = covered_gap(core, parameters.get("gap_over_angles_covered"))
    drawing = None if isinstance(pair, Drive) else float(pair.drawing_backlash) / DEG
    joined = {wave.order for wave in core.waves if wave.shaft == "line"}
    lines = (FoundLine(**vars(one), joined=one.cycles_per_rev in joined) for one in found.lines)
    constant = parameters["constant_backlash_deg"].value
    if len(core.scope.flanks) < 2 and isinstance(pair, GearPair) and isinstance(model, OrderModel):
        model, constant = _first_orders(core, pair, parameters, model), 0.0
    reversals = _reversals(core, found.segments, gap, model, constant)
    return Checks(
        gap_over_angles_covered=gap,
        gap_by_speed=gap_by_speed(core, needed["gap_by_speed"] > NEEDED),
        delay_by_parts=delay_by_parts(core) if needed["delay_parts"] > NEEDED else (),
        explained=explained(core),
        likelihood_ratio=needed,
        drift_arcsec=drift_arcsec(core),
        outliers=1 - float(core.good.mean()),
        passes=core.passes,
        solver_steps=core.steps,
        lines=tuple(lines),
        ratio=tuple(
            RatioCheck(str(one.given), one.seen, one.std, one.verdict, one.cause)
            for one in found.ratios
        ),
        closure=closure(curves, pair),
        reversals=reversals,
        jumps=_jumps(reversals, gap, constant),
        readings=readings,
        drawing_backlash_deg=drawing,
    )


def covered_gap(core: MixedFit, told: Parameter | None) -> CoveredGap:
    """Return the gap over the angles that both flanks covered."""
    if told is None:
        one = len(core.scope.flanks) < 2
        reason = "one direction: one flank alone shows no gap"
        return CoveredGap(reason=reason if one else "no driving angle was covered on both flanks")
    covered = float(len(core.scope.covered))
    if told.low95 is None or told.high95 is None or told.high95 - told.low95 > 360:
        return CoveredGap(reason=OPEN, covered_deg=covered)
    interval = told.value, told.std, told.low95, told.high95
    return CoveredGap(*interval, determined=True, covered_deg=covered)


def gap_by_speed(core: MixedFit, needed: bool) -> tuple[GapAtSpeed, ...]:
    """Return the gap over the angles covered at speeds of the log, less the effect of the delay.

    If the log does not show (`needed`) that the gap depends on the speed, a speed counts only where
    rows are at least half as dense as if all speeds were equally frequent: not in a ramp between
    two speeds. At the speed v the flanks are gap + Σ bend_k max(v − κ_k, 0) + 2 i v d apart; of
    this the part 2 i v d̂ of the mean delay is taken off.
    """
    posterior, scope = core.posterior, core.scope
    index, natural = posterior.problem.index, posterior.problem.natural
    seen = np.concatenate([rows.speed for rows in core.rows])
    speeds: list[float] = []
    for speed in np.quantile(seen, (np.arange(_SPEEDS) + 0.5) / _SPEEDS, method="nearest"):
        near = np.mean(np.abs(seen - speed) < _APART * speed / 2)
        held = needed or near * np.ptp(seen) > _APART * speed / 2
        if held and (not speeds or speed > (1 + _APART) * speeds[-1]):
            speeds.append(float(speed))
    if len(scope.flanks) < 2 or not len(scope.covered) or len(speeds) < 2:
        return ()
    # What the bends add to the gap acts on coefficients that are not orthogonal to gap and delay.
    bends = group_columns(core, "gap_by_speed")
    rows = []
    for speed in speeds:
        along = np.maximum(speed - core.bends, 0.0) @ natural[bends]
        for name, gain in ((GAP, 1.0), (DELAY, 2 * abs(scope.ratio) * speed)):
            if name in index:
                along[bends] += gain * natural[index[name], bends]
        rows.append(gap_row(core, scope.covered) + along / np.diag(natural))
    mean, covariance, _ = posterior.told(np.stack(rows), moved=True)
    stds = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(
        GapAtSpeed(speed * 60 / REV, float(value) / DEG, float(std) / DEG)
        for speed, value, std in zip(speeds, mean, stds, strict=True)
    )


def delay_by_parts(core: MixedFit) -> tuple[DelayOfPart, ...]:
    """Return the delay at equal distances in time of every log."""
    found = []
    for log, shafts in enumerate(core.shafts):
        parts = group_columns(core, "delay_parts", log)
        rows = core.posterior.row(DELAY) + np.eye(len(core.posterior.problem.columns))[parts]
        mean, covariance, _ = core.posterior.told(rows)
        times = np.linspace(shafts.time[0], shafts.time[-1], len(parts))
        stds = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        found += [
            DelayOfPart(log + 1, float(t), core.delay_s + float(d), float(s))
            for t, d, s in zip(times, mean, stds, strict=True)
        ]
    return tuple(found)


def explained(core: MixedFit) -> float | None:
    """Return the share of the variance that the harmonics explain beside the other columns."""
    left, good = core.residual, core.good
    columns = core.posterior.problem.columns
    others = core.posterior.coefficients * [column.row.part is None for column in columns]
    before = np.concatenate(residuals(columns, core.rows, others))
    variance = float(np.var(before[good]))
    return 1 - float(np.var(left[good])) / variance if variance > 0 else None


def drift_arcsec(core: MixedFit) -> float:
    """Return the largest less the smallest level of a log."""
    moved = core.posterior.moved
    ramps = [moved[group_columns(core, "drift", log)] for log in range(len(core.rows))]
    return max(float(np.ptp(np.cumsum([0.0, *own]))) for own in ramps) / ARCSEC


def group_columns(core: MixedFit, group: str, log: int | None = None) -> list[int]:
    """Return the places of the columns of a group, of one log or (None) of all logs together."""
    logs = None if log is None else (log,)
    columns = enumerate(core.posterior.problem.columns)
    return [place for place, column in columns if (column.prior, column.logs) == (group, logs)]


def noise_of(core: MixedFit) -> Noise:
    """Return the noise of the rows."""
    partial, innovation = np.asarray(core.posterior.partial), core.posterior.innovation_std
    taps = np.asarray(whitening(core.posterior.partial))
    variance = innovation**2 / float(np.prod(1 - partial**2))
    row_s = core.rows[0].samples.shape[1] * core.shafts[0].interval_s
    return Noise(
        model=f"AR({LAGS})",
        coefficients=tuple(float(-tap) for tap in taps[1:]),
        block_s=row_s,
        std_deg=math.sqrt(variance) / DEG,
        innovation_std_deg=innovation / DEG,
        correlation_s=0.5 * row_s * innovation**2 / float(taps.sum()) ** 2 / variance,
        slow_share=1 - innovation**2 / variance,
    )


def curves_of(core: MixedFit) -> tuple[tuple[TECurve, ...], tuple[Float[np.ndarray, " n"], ...]]:
    """Return the rows of every run, less the delay, as curves, and their residuals, rad."""
    curves, found, place = [], [], 0
    left, good = core.residual, core.good
    for shafts, rows in zip(core.shafts, core.rows, strict=True):
        error = shafts.on_time(core.delay_s)[1][rows.samples].mean(1)
        for first, last, flank in zip(rows.first, rows.last, rows.flanks, strict=True):
            own = np.arange(first, last + 1)
            own = own[good[place + own]]
            if len(own):
                curves.append(TECurve(flank, rows.angle[own], error[own], rows.time[own]))
                found.append(left[place + own])
        place += len(rows.table)
    return tuple(curves), tuple(found)


def _first_orders(
    core: MixedFit, pair: GearPair, parameters: dict[str, Parameter], model: OrderModel
) -> FlankModel:
    """Return the fitted eccentricities without backlash, the paper's way from one flank to j_v."""
    polar = [
        parameters[f"{shaft}_{name}"].value or 0.0
        for shaft in ("driving", "driven")
        for name in ("eccentricity_mm", "phase_deg")
    ]
    mounting = float(model.offset[flank_index(core.scope.flanks[0])])
    return mounted_exact(pair, Eccentricities(*polar, constant_backlash_deg=0.0), mounting)


def _reversals(
    core: MixedFit,
    segments: Sequence[Segments],
    gap: CoveredGap,
    model: FlankModel,
    constant: float | None,
) -> tuple[Reversal, ...]:
    """Return the jumps at the reversals, from samples without delay."""
    if gap.value is None and constant is None:
        return ()
    beyond = max(gap.value or 0.0, 0.0) / abs(core.scope.ratio)
    found: list[Reversal] = []
    for number, (shafts, own) in enumerate(zip(core.shafts, segments, strict=True), 1):
        if own.still:
            continue
        found += reversal_jumps(*shafts.on_time(core.delay_s), own.segments, number, beyond)
    if constant is None or not found:
        return tuple(found)
    angles = np.array([one.driving_deg for one in found]) * DEG
    variable = np.asarray(model.backlash(angles)) / DEG - constant
    for place, (one, extra) in enumerate(zip(found, variable.tolist(), strict=True)):
        # The fitted backlash has a place in the logs that have the zero of the first one.
        if not any(core.shafts[one.log - 1].start.spread):
            told = {"variable_backlash_deg": extra, "constant_backlash_deg": one.jump_deg - extra}
            found[place] = msgspec.structs.replace(one, **told)
    return tuple(found)


def _jumps(
    reversals: Sequence[Reversal], gap: CoveredGap, constant: float | None
) -> JumpComparison | None:
    """Compare the jumps behind the crossing of the gap with the gap over the covered angles.

    A machine often reverses at the same few places, where the gap is not the mean one. Each jump
    therefore counts less the amount by which the fitted gap of its place exceeds the mean.
    """
    kept = [one for one in reversals if not one.crossing]
    if len(kept) < 2 or gap.value is None or gap.std is None:
        return None
    places = [one.variable_backlash_deg for one in kept]
    mean = gap.value - (constant or 0.0)
    off = np.array([0.0 if one is None else one - mean for one in places])
    jumps = np.array([one.jump_deg for one in kept]) - off
    median = float(np.median(jumps))
    scatter = 1.4826 * float(np.median(np.abs(jumps - median)))
    # A few jumps may be alike by chance, or be copies: none is told better than its samples do.
    scatter = max(scatter, math.sqrt(np.mean([one.std_deg**2 for one in kept])))
    std = 1.25 * scatter / math.sqrt(len(jumps))
    return JumpComparison(len(jumps), median, std, gap.value, gap.std)


def closure(curves: tuple[TECurve, ...], pair: GearPair | Drive) -> Closure | None:
    """Compare the transmission error of every run with its values one hunting period later.

    Fig. 12 of the paper shows this comparison.

    **Returns** rms and mean of the difference, and the angle over which it was compared, in
    degrees; None if no run is longer than the period.
    """
    period = pair.hunting_turns * REV
    differences = []
    for curve in curves:
        order = np.argsort(curve.driving_angle)
        angle, error = curve.driving_angle[order], curve.transmission_error[order]
        early = angle[angle + period <= angle[-1]]
        if len(early) > 1:
            late = np.interp(early + period, angle, error)
            differences.append(late - error[: len(early)])
    overlap = sum(max(0.0, float(np.ptp(c.driving_angle)) - period) for c in curves)
    if not differences or overlap == 0:
        return None
    difference = np.concatenate(differences)
    return Closure(
        period_deg=period / DEG,
        overlap_deg=overlap / DEG,
        rms_deg=float(np.sqrt(np.mean(difference**2))) / DEG,
        mean_deg=float(np.mean(difference)) / DEG,
    )


def reversal_jumps(
    driving: Float[np.ndarray, " n"],
    error: Float[np.ndarray, " n"],
    segments: tuple[Segment, ...],
    log: int = 1,
    gap_deg: float = 0.0,
) -> list[Reversal]:
    """Return the jump at every reversal: TE_B − TE_A at the same driving angles, in degrees.

    `driving` and `error` are in rad. Delay and wind-up must be removed from them, because they
    change their sign with the direction and would look like a jump. Both passes are compared in a
    window of driving angles from 1° to 6° before the turning point, where the teeth are in contact.
    `driving_deg` of the result is the middle of the window. `log` is the number of the log.

    On a reducer the teeth cross the gap during more than 1° of driving angle after the turn.
    Therefore the window begins at least 1.5 times `gap_deg` before the turn, if the passes are long
    enough. `gap_deg` is the gap as an angle of the driving shaft. The largest of n noisy readings,
    which is taken for the turn, is expected √(2 ln n) of their deviations beyond it.
    """
    jumps = []
    for before, after in pairwise(segments):
        if before.flank == after.flank:
            continue
        window = slice(before.start, after.stop)
        sense = 1.0 if before.flank == "A" else -1.0
        along = sense * driving[window]
        noise_deg = robust_deviation(np.diff(along, 2)) / (np.sqrt(6) * DEG)
        beyond = _GAPS * gap_deg + noise_deg * np.sqrt(2 * np.log(len(along)))
        within = (max(_NEAR_DEG, beyond) + 2 * _WINDOW_DEG) * DEG
        near = np.flatnonzero(along >= along.max() - within)
        turn = int(np.searchsorted(near, np.argmax(along)))
        angle, te = driving[window][near], error[window][near]
        left = sense * (angle[turn] - angle) / DEG
        for start in sorted({max(_NEAR_DEG, beyond), _NEAR_DEG}, reverse=True):
            middle = start + _WINDOW_DEG / 2
            inside = np.flatnonzero(np.abs(left - middle) <= _WINDOW_DEG / 2)
            passes = inside[inside < turn], inside[inside > turn]
            if min(map(len, passes)) < 3:
                continue
            levels, variances = zip(*(_level(left[k] - middle, te[k]) for k in passes), strict=True)
            jump, std = sense * (levels[1] - levels[0]) / DEG, math.sqrt(sum(variances)) / DEG
            turn_deg = float(angle[turn] / DEG)
            place = float(angle[turn] / DEG - sense * middle)
            jumps.append(Reversal(log, place, turn_deg, jump, crossing=start < beyond, std_deg=std))
            break
    return jumps


def _level(off_deg: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the transmission error at `off_deg` = 0 from a straight line, and its variance."""
    design = np.stack([off_deg, np.ones(len(off_deg))], axis=1)
    inverse = np.linalg.pinv(design)
    line = inverse @ error
    scatter = np.sum((error - design @ line) ** 2) / (len(error) - 2)
    return float(line[1]), float(scatter * inverse[1] @ inverse[1])
