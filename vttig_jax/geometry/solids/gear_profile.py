"""One flank and its fillet as a curve, and where the cuts of both flanks meet in a space.

Seen along the axis a flank and its fillet are the same curve in every section, turned by δ(z)/R:

    ψ(u, z) = ψ₀(u) − δ(z)/R,    r = r(u)

ψ is the angle from the centre line of the tooth. The space between two teeth is what both cutters
remove; where their fillets cross, its bottom is the crossing instead of the root circle.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

from ...base.errors import PairError
from ..tooth.form_circle import form_radius, undercut_depth
from ..tooth.rack_cutter import SIDES, RackSide, Side, arc_roll, flank_distance, rack_side, to_gear
from ..tooth.recession import Taper
from ..tooth.roll_limits import flank_roll, flank_span
from ..tooth.tooth import Tooth

Array = Float[np.ndarray, "..."]

_SMALL = 2e-14
"""Of a relative radius or an angle, at which a search ends."""

_FINE = 801
_KEPT = 4
_GAP_MM = 1e-6
"""By how much fillet and flank may miss each other where they meet."""


@dataclass(frozen=True)
class HalfProfile:
    """Fillet (u from 0 to 1) and flank (u from 1 to 2) of one side where δ = 0.

    **Arguments**
    - `rack`: the half of the cutter, not receded.
    - `fillet_end`: by how much the normal falls where the fillet ends, rad; π/2 at the root.
    - `flank_start`, `flank_end`: roll angles at the form circle and at the tip, rad.
    """

    rack: RackSide
    fillet_end: float
    flank_start: float
    flank_end: float

    def __call__(self, u: Array) -> tuple[Array, Array]:
        """Radius in mm and angle from the centre line of the tooth, rad."""
        u = np.asarray(u, float)
        zero, rack = np.zeros_like(u), self.rack
        low, high = np.minimum(u, 1.0), np.maximum(u, 1.0) - 1.0
        steep = math.pi / 2 + low * (self.fillet_end - math.pi / 2)
        fillet = to_gear(rack, rack.arc(steep, zero), arc_roll(rack, steep))
        roll = self.flank_start + high * (self.flank_end - self.flank_start)
        flank = to_gear(rack, rack.flank(flank_distance(rack, roll, zero), zero), roll)
        x, y, _ = np.moveaxis(np.where((u <= 1.0)[..., None], fillet, flank), -1, 0)
        return np.asarray(np.hypot(x, y)), np.asarray(np.arctan2(-rack.mirror * x, y))

    def at_radius(self, radius: Array) -> Array:
        """u at radii between root and tip; it rises with the radius."""
        u, radii = self._table
        after = np.clip(np.searchsorted(radii, radius), 1, len(u) - 1)
        low, high = np.asarray(u[after - 1]), np.asarray(u[after])
        return _rising_through(lambda at: self(at)[0] / radius - 1, low, high, steps=14)

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        u = np.linspace(0.0, 2.0, _FINE)
        return u, self(u)[0]


@dataclass(frozen=True)
class GearProfile:
    """Both flanks of a tooth and the spaces beside it; see `gear_profile`."""

    tooth: Tooth
    left: HalfProfile
    right: HalfProfile

    @property
    def pitch(self) -> float:
        """Angle between neighbouring teeth, rad."""
        return 2 * math.pi / self.tooth.teeth

    def turned(self, z: Array) -> Array:
        """δ(z)/R of the left and the right flank, rad, shape (..., 2)."""
        return np.asarray(self.tooth.recessions(z), float) / float(self.tooth.reference_radius)

    def starts(self, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """u at which the left and the right curve begin at the bottom of the space.

        0 where a root land is left; else where both curves cross: at one radius and
        ψ_left + ψ_right = 2π/teeth.
        """
        key = z.tobytes()
        if key not in self._known:
            while len(self._known) >= _KEPT:
                del self._known[next(iter(self._known))]
            self._known[key] = self._starts(z)
        return self._known[key]

    @cached_property
    def _known(self) -> dict[bytes, Float[np.ndarray, "n 2"]]:
        """What has been found, as rows of points, closed pieces and the bore ask for the same."""
        return {}

    def _starts(self, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        wanted = self.pitch + self.turned(z).sum(axis=-1)
        closed = self.land(z) < 0
        found = np.zeros((len(z), 2))
        if closed.any():
            goal = wanted[closed]

            def opening(u: Array) -> Array:
                radius, angle = self.right(u)
                return goal - angle - self.left(self._left_of(u, radius))[1]

            right = _rising_through(opening, *self._around_crossing(goal))
            found[closed, 1] = right
            found[closed, 0] = self._left_of(right, self.right(right)[0])
        return found

    def _around_crossing(self, goal: Array) -> tuple[Array, Array]:
        """Bounds of the right curve's u at which both angles add up to the goal."""
        u, radius = self.right._table
        both = self.right(u)[1] + np.interp(radius, self.left._table[1], self.left(u)[1])
        at = np.argmax(both[:, None] <= goal, axis=0)  # it falls at first
        return u[np.maximum(at - 2, 0)], u[np.minimum(at + 1, len(u) - 1)]

    def _left_of(self, right: Array, radius: Array) -> Array:
        """u of the left curve at the radius that the right one has at u; the same where alike."""
        alike = np.ptp(np.asarray(self.tooth.pressure_angles)) == 0
        return right if alike else self.left.at_radius(radius)

    def land(self, z: Array) -> Array:
        """Angle of the root land, rad; negative where the fillets overlap."""
        return self.pitch + self.turned(z).sum(axis=-1) - self.feet

    def breaks(self, low: float, high: float) -> list[float]:
        """Heights between two ends at which the bottom of the space changes its kind."""
        heights = np.linspace(low, high, _FINE)
        found = set()
        for level in self._levels():

            def above(z: float, level: float = level) -> float:
                return float(self.turned(np.array([z])).sum()) - level

            values = self.turned(heights).sum(axis=-1) - level
            for at in np.flatnonzero(values[:-1] * values[1:] < 0):
                bracket = (heights[at], heights[at + 1])
                found.add(root_scalar(above, bracket=bracket, xtol=1e-13).root)
        least = 1e-6 * (high - low)
        return sorted(z for z in found if low + least < z < high - least)

    def _levels(self) -> list[float]:
        """Σδ/R at which the fillets just touch, and at which the crossing leaves a fillet."""
        joints = [half(np.ones(()))[0] for half in (self.left, self.right)]
        return [x - self.pitch for x in (self.feet, *(float(self._sum(r)) for r in joints))]

    @cached_property
    def feet(self) -> float:
        """ψ₀ of both sides where the fillets leave the root circle, rad."""
        return sum(float(half(np.zeros(()))[1]) for half in (self.left, self.right))

    def _sum(self, radius: Array) -> Array:
        """ψ₀ of both sides at a radius."""
        left, right = (half(half.at_radius(radius))[1] for half in (self.left, self.right))
        return np.asarray(left + right)

    def check(self, z: Float[np.ndarray, " n"]) -> None:
        """Raise `PairError` where teeth grow together above the root, or are cut through."""
        radii = np.linspace(float(self.tooth.root_radius), float(self.tooth.tip_radius), 201)
        both = self._sum(radii[1:-1])  # the ends only to rounding
        turned = self.turned(z).sum(axis=-1)
        filled = both > self.pitch + turned[:, None]
        for at, z_mm in enumerate(z):
            waist = int(np.argmin(both))
            if both[waist] <= turned[at]:
                raise PairError(
                    f"the tooth is cut through at a radius of {radii[1:-1][waist]:.3f} mm at z ="
                    f" {z_mm:g} mm; take more teeth or a larger profile shift.",
                    where="undercut",
                )
            if filled[at, -1]:
                raise PairError(
                    f"neighbouring teeth touch at the tip circle at z = {z_mm:g} mm, so that no"
                    " space is left; make the face narrower or the helix angles smaller.",
                    where="space",
                )
            if (filled[at, 1:] & ~filled[at, :-1]).any():
                raise PairError(
                    f"the undercut teeth grow together above the root at z = {z_mm:g} mm; take more"
                    " teeth, a larger profile shift or a narrower face.",
                    where="space",
                )


def gear_profile(tooth: Tooth) -> GearProfile:
    """The curves of a gear that `check_tooth` accepts.

    **Raises** `PairError` where an undercut leaves no flank, or fillet and flank do not meet.
    """
    left, right = (_half_profile(tooth, side) for side in SIDES)
    return GearProfile(tooth, left, right)


def _half_profile(tooth: Tooth, side: Side) -> HalfProfile:
    rack = replace(rack_side(tooth, side), recession=Taper(0.0))
    start, end = (float(roll) for roll in flank_span(tooth, side))
    fillet_end = float(rack.pressure_angle)
    if undercut_depth(tooth, side) > 0:
        form = form_radius(tooth, side)
        whole = HalfProfile(rack, fillet_end, start, end)
        if math.isnan(form) or not whole(np.ones(()))[0] > form:
            raise PairError(
                f"the {side} flank is undercut so deep that the fillet leaves nothing of it; take"
                " more teeth, a larger profile shift or a smaller fillet radius.",
                where="undercut",
            )
        share = root_scalar(
            lambda u: float(whole(np.asarray(u))[0]) - form, bracket=(0.0, 1.0), xtol=1e-15
        ).root
        fillet_end = math.pi / 2 + share * (fillet_end - math.pi / 2)
        start = float(flank_roll(tooth, np.asarray(form), side))
    found = HalfProfile(rack, fillet_end, start, end)
    _check_curve(found, side)
    return found


def _check_curve(half: HalfProfile, side: Side) -> None:
    radius, angle = half(np.array([1.0, np.nextafter(1.0, 2.0)]))
    gap = math.hypot(radius[1] - radius[0], radius[0] * (angle[1] - angle[0]))
    rises = np.diff(half(np.linspace(0.0, 2.0, _FINE))[0]) > 0
    if not gap < _GAP_MM or not rises.all():
        raise PairError(
            f"fillet and {side} flank do not join to one curve that rises from root to tip; take"
            " more teeth, a larger profile shift or a smaller fillet radius.",
            where="fillet",
        )


def _rising_through(
    rising: Callable[[Array], Array], low: Array, high: Array, *, steps: int = 30
) -> Array:
    """Where a rising function passes 0 between two bounds: false position, Illinois."""
    at_low, at_high, found = rising(low), rising(high), low
    was_below = np.zeros(np.shape(low), int)  # 1 below, −1 above, 0 at first
    for _ in range(steps):
        slope = at_high - at_low
        share = np.where(slope > 0, -at_low / np.where(slope > 0, slope, 1.0), 0.5)
        found = np.asarray(low + np.clip(share, 0.0, 1.0) * (high - low))
        value = rising(found)
        if (np.abs(value) < _SMALL).all():
            break
        side = np.where(value < 0, 1, -1)
        again = side == was_below  # the other bound has stayed: halve its value
        at_high = np.where(side < 0, value, np.where(again, at_high / 2, at_high))
        at_low = np.where(side > 0, value, np.where(again, at_low / 2, at_low))
        low, high = np.where(side > 0, found, low), np.where(side < 0, found, high)
        was_below = side
    return found
