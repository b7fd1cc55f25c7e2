"""Part of the hunting period that measured curves cover on each flank and on both."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..base.units import DEG, REV
from ..pair.gear_pair import Drive, Flank, GearPair
from .te_curve import TECurve

Spans = Float[np.ndarray, "_ 2"]
"""Disjoint intervals of the driving angle in ascending order, rad; rows are start and stop."""

_WHOLE = 1.0 - 1e-9
"""Share above which the hunting period counts as covered (chosen)."""


@dataclass(frozen=True)
class HuntingCoverage:
    """Driving angles of the hunting period that the curves of a fit cover.

    The backlash at a driving angle is measured only if curves of both flanks cover this angle. At
    other angles a backlash map extrapolates with the fitted orders.

    **Arguments**
    - `pair`: gear pair or drive; it gives the hunting period.
    - `spans`: flank → intervals that the curves of this flank cover, within [0, period).
    - `unplaced`: number of curves whose place in the hunting period is not known. They are not in
      `spans`.
    """

    pair: GearPair | Drive
    spans: Mapping[Flank, Spans]
    unplaced: int = 0

    @cached_property
    def both(self) -> Spans:
        """Intervals of the driving angle, rad, that are covered on both flanks."""
        return _overlap(np.concatenate([np.empty((0, 2)), *self.spans.values()]), times=2)

    @property
    def share(self) -> float:
        """Fraction of the hunting period that is covered on both flanks."""
        return self._fraction(self.both)

    @property
    def tooth_pairs(self) -> tuple[int, int] | None:
        """Number of tooth pairs that mesh at covered angles, and number of all tooth pairs.

        The result is None for a drive, whose tooth counts are unknown.
        """
        if isinstance(self.pair, Drive):
            return None
        count = self.pair.driving.teeth * self.pair.hunting_turns
        pitch = REV / self.pair.driving.teeth
        return int(np.sum(self.holds((np.arange(count) + 0.5) * pitch))), count

    def holds(
        self, driving_angle: Float[np.ndarray, " n"], flank: Flank | None = None
    ) -> Bool[np.ndarray, " n"]:
        """Return whether driving angles, rad, are covered on a flank, or on both of them."""
        spans = self.both if flank is None else self.spans.get(flank, np.empty((0, 2)))
        turned = np.mod(driving_angle, self._period)
        return np.searchsorted(spans.ravel(), turned, side="right") % 2 == 1

    def to_json(self) -> dict[str, Any]:
        """Return the object `coverage` of schema `vttig.map/1`."""
        pairs = self.tooth_pairs
        return {
            "share": self.share,
            "turns": self.share * self.pair.hunting_turns,
            "flank_shares": {flank: self._fraction(own) for flank, own in self.spans.items()},
            "spans_deg": (self.both / DEG).tolist(),
            "tooth_pairs": None if pairs is None else pairs[0],
            "unplaced_curves": self.unplaced,
            "sentence": str(self),
        }

    def __str__(self) -> str:
        turns = self.pair.hunting_turns
        period = f"{turns} driving turn{'s' if turns > 1 else ''} of the hunting period"
        known = "at least " if self.unplaced else ""
        if self.unplaced and not self.spans:
            return f"an unknown part of the {period}; the zeros of the logs do not tell their turn"
        seen = {flank: own for flank, own in self.spans.items() if len(own)}
        if len(seen) == 1:
            ((flank, own),) = seen.items()
            covered = self._fraction(own) * turns
            return (
                f"{known}{covered:.3g} of the {period} on flank {flank} only; the other flank"
                " follows from the fitted eccentricities"
            )
        if self.share > _WHOLE:
            return f"all {period} on both flanks"
        pairs = self.tooth_pairs
        counted = "" if pairs is None else f", {pairs[0]} of {pairs[1]} tooth pairs"
        return (
            f"{known}{self.share * turns:.3g} of the {period} on both flanks"
            f" ({100 * self.share:.3g} %{counted}); elsewhere the map is extrapolated by the fitted"
            " orders"
        )

    @property
    def _period(self) -> float:
        return self.pair.hunting_turns * REV

    def _fraction(self, spans: Spans) -> float:
        return min(float(np.sum(spans[:, 1] - spans[:, 0])) / self._period, 1.0)


def hunting_coverage(
    curves: Sequence[TECurve],
    pair: GearPair | Drive,
    starts: Sequence[float | None] | None = None,
) -> HuntingCoverage:
    """Return the part of the hunting period that curves cover.

    A curve covers the interval from its smallest to its largest driving angle, extended at both
    ends by half the mean distance of its points.

    **Arguments**
    - `curves`: measured curves of both flanks.
    - `pair`: gear pair or drive.
    - `starts`: for each curve, the angle in the hunting period, rad, at which the driving angle
      of the curve is zero, or None if it is not known; by default 0 for all curves.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.kinematics.hunting_coverage import hunting_coverage
    >>> from vttig_jax.kinematics.te_curve import TECurve
    >>> from vttig_jax.rig import paper_pair
    >>> angle = np.linspace(0.0, 4 * 2 * np.pi, 1000)
    >>> curves = [TECurve(flank, angle, 0 * angle, angle) for flank in ("A", "B")]
    >>> round(hunting_coverage(curves, paper_pair()).share, 2)
    0.25

    ```
    """
    period = pair.hunting_turns * REV
    places = [0.0] * len(curves) if starts is None else starts
    pieces: dict[Flank, list[tuple[float, float]]] = {"A": [], "B": []}
    for curve, start in zip(curves, places, strict=True):
        if start is not None and len(curve):
            pieces[curve.flank] += _pieces(curve, start, period)
    spans: dict[Flank, Spans] = {
        f: _overlap(np.array(own), times=1) for f, own in pieces.items() if own
    }
    return HuntingCoverage(pair, spans, sum(start is None for start in places))


def _pieces(curve: TECurve, start: float, period: float) -> list[tuple[float, float]]:
    """Return the one or two intervals (begin, end) in [0, period], rad, that a curve covers.

    `start` is the angle in the hunting period at which the driving angle of the curve is zero.
    """
    low, high = float(curve.driving_angle.min()), float(curve.driving_angle.max())
    half = 0.5 * (high - low) / (len(curve) - 1) if len(curve) > 1 else 0.0
    length = high - low + 2 * half
    if length >= period:
        return [(0.0, period)]
    begin = math.fmod(math.fmod(start + low - half, period) + period, period)
    if begin + length <= period:
        return [(begin, begin + length)]
    return [(0.0, begin + length - period), (begin, period)]


def _overlap(pieces: Float[np.ndarray, "_ 2"], times: int) -> Spans:
    """Return the angles that at least so many of the intervals cover."""
    edges = np.unique(pieces)
    begun, ended = (
        np.searchsorted(np.sort(ends), edges, side="right") for ends in (pieces[:, 0], pieces[:, 1])
    )
    # The last edge ends all intervals.
    change = np.diff((begun - ended >= times).astype(int), prepend=0)
    return np.stack([edges[change > 0], edges[change < 0]], axis=1)
