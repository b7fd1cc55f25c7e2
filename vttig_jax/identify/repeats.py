"""Checks that do not use the fitted model: closure, and the jump at a reversal."""

import math
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ..base.units import DEG, REV
from ..kinematics.te_curve import TECurve
from ..logs.motion.segments import Segment
from ..pair.gear_pair import Drive, GearPair
from .records import Closure, Reversal

_NEAR_DEG, WINDOW_DEG = 1.0, 5.0
"""The passes before and after a reversal are compared in a window of driving angles. These are its
smallest distance from the turning point and its width, deg of the driving shaft; chosen values."""

_GAPS = 1.5
"""Smallest distance from the turning point to the window, in gaps; above 1 because the gap varies
with the angle. Chosen value."""


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
    if not differences:
        return None
    difference = np.concatenate(differences)
    overlap = sum(max(0.0, float(np.ptp(c.driving_angle)) - period) for c in curves)
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
    enough. `gap_deg` is the gap as an angle of the driving shaft.
    """
    jumps = []
    beyond = _GAPS * gap_deg
    for before, after in pairwise(segments):
        if before.flank == after.flank:
            continue
        window = slice(before.start, after.stop)
        sense = 1.0 if before.flank == "A" else -1.0
        along = sense * driving[window]
        within = (max(_NEAR_DEG, beyond) + 2 * WINDOW_DEG) * DEG
        near = np.flatnonzero(along >= along.max() - within)
        turn = int(np.searchsorted(near, np.argmax(along)))
        angle, te = driving[window][near], error[window][near]
        left = sense * (angle[turn] - angle) / DEG
        for start in sorted({max(_NEAR_DEG, beyond), _NEAR_DEG}, reverse=True):
            middle = start + WINDOW_DEG / 2
            inside = np.flatnonzero(np.abs(left - middle) <= WINDOW_DEG / 2)
            first, second = inside[inside < turn], inside[inside > turn]
            if len(first) < 3 or len(second) < 3:
                continue
            levels, variances = zip(
                *(_level(left[part] - middle, te[part]) for part in (first, second)), strict=True
            )
            jumps.append(
                Reversal(
                    log=log,
                    driving_deg=float(angle[turn] / DEG - sense * middle),
                    turn_deg=float(angle[turn] / DEG),
                    jump_deg=sense * (levels[1] - levels[0]) / DEG,
                    crossing=start < beyond,
                    std_deg=math.sqrt(sum(variances)) / DEG,
                )
            )
            break
    return jumps


def _level(off_deg: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the transmission error at `off_deg` = 0 from a straight-line fit, and its variance.

    `off_deg` is the angle of the samples from the middle of the window.
    """
    line = np.polyfit(off_deg, error, 1)
    scatter = np.sum((error - np.polyval(line, off_deg)) ** 2) / (len(error) - 2)
    at = np.linalg.pinv(np.stack([off_deg, np.ones(len(off_deg))], axis=1))[1]
    return float(line[1]), float(scatter * at @ at)
