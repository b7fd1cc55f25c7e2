"""Profile curves of a gear: flank and fillet of each side, and the bottom of the space.

In every section a flank and its fillet are the same curve, rotated by δ(z)/R:

    ψ(u, z) = ψ₀(u) − δ(z)/R,    r = r(u)

ψ is the angle from the centre line of the tooth. Both cutters remove the space between two teeth;
where the fillets cross, the bottom of the space is the crossing instead of the root circle.
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

# Chosen values:
_TOLERANCE = 2e-14  # of a relative radius or of an angle in rad, in a root search
_TABLE_POINTS = 801  # points of a curve or of the face in a search
_CACHE_SIZE = 4  # arrays of heights for which results are kept
_GAP_MM = 1e-6  # largest distance between the ends of fillet and flank


@dataclass(frozen=True)
class HalfProfile:
    """Curve of fillet (u from 0 to 1) and flank (u from 1 to 2) of one side for δ = 0.

    **Arguments**
    - `rack`: half of the cutter without recession.
    - `fillet_end`: normal angle at the end of the fillet, rad; it is π/2 at the root.
    - `flank_start`, `flank_end`: roll angles at the form circle and at the tip, rad.
    """

    rack: RackSide
    fillet_end: float
    flank_start: float
    flank_end: float

    def __call__(self, u: Array) -> tuple[Array, Array]:
        """Return the radius in mm and the angle from the centre line of the tooth in rad."""
        u = np.asarray(u, float)
        zero, rack = np.zeros_like(u), self.rack
        low, high = np.minimum(u, 1.0), np.maximum(u, 1.0) - 1.0
        normal_angle = math.pi / 2 + low * (self.fillet_end - math.pi / 2)
        fillet = to_gear(rack, rack.arc(normal_angle, zero), arc_roll(rack, normal_angle))
        roll = self.flank_start + high * (self.flank_end - self.flank_start)
        flank = to_gear(rack, rack.flank(flank_distance(rack, roll, zero), zero), roll)
        x, y, _ = np.moveaxis(np.where((u <= 1.0)[..., None], fillet, flank), -1, 0)
        return np.asarray(np.hypot(x, y)), np.asarray(np.arctan2(-rack.mirror * x, y))

    def at_radius(self, radius: Array) -> Array:
        """Return u at radii, mm, between root and tip; u increases with the radius."""
        u, radii = self._table
        index = np.clip(np.searchsorted(radii, radius), 1, len(u) - 1)
        low, high = np.asarray(u[index - 1]), np.asarray(u[index])
        return _increasing_root(lambda u: self(u)[0] / radius - 1, low, high, steps=14)

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        u = np.linspace(0.0, 2.0, _TABLE_POINTS)
        return u, self(u)[0]


@dataclass(frozen=True)
class GearProfile:
    """Profile curves of both flanks of a tooth and limits of its spaces; see `gear_profile`."""

    tooth: Tooth
    left: HalfProfile
    right: HalfProfile

    @property
    def pitch(self) -> float:
        """Angle between neighbouring teeth, rad."""
        return 2 * math.pi / self.tooth.teeth

    def rotation(self, z: Array) -> Array:
        """Return δ(z)/R of the left and the right flank, rad, shape (..., 2)."""
        return np.asarray(self.tooth.recessions(z), float) / float(self.tooth.reference_radius)

    def starts(self, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return u of the left and the right curve at the bottom of the space.

        It is 0 if there is a root land. Otherwise both curves cross there: they have one radius and
        ψ_left + ψ_right = 2π/teeth.
        """
        key = z.tobytes()
        if key not in self._cache:
            while len(self._cache) >= _CACHE_SIZE:
                del self._cache[next(iter(self._cache))]
            self._cache[key] = self._starts(z)
        return self._cache[key]

    @cached_property
    def _cache(self) -> dict[bytes, Float[np.ndarray, "n 2"]]:
        """Results of `starts` by heights; points, closed pieces and bore use the same heights."""
        return {}

    def _starts(self, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        angle_sum = self.pitch + self.rotation(z).sum(axis=-1)
        closed = self.land(z) < 0
        starts = np.zeros((len(z), 2))
        if closed.any():
            target = angle_sum[closed]

            def opening(u: Array) -> Array:
                radius, angle = self.right(u)
                return target - angle - self.left(self._left_parameter(u, radius))[1]

            right = _increasing_root(opening, *self._crossing_bounds(target))
            starts[closed, 1] = right
            starts[closed, 0] = self._left_parameter(right, self.right(right)[0])
        return starts

    def _crossing_bounds(self, target: Array) -> tuple[Array, Array]:
        """Return bounds of u of the right curve where the sum of both ψ₀ is `target`, rad."""
        u, radius = self.right._table
        both = self.right(u)[1] + np.interp(radius, self.left._table[1], self.left(u)[1])
        first = np.argmax(both[:, None] <= target, axis=0)  # the sum decreases from the root
        return u[np.maximum(first - 2, 0)], u[np.minimum(first + 1, len(u) - 1)]

    def _left_parameter(self, right: Array, radius: Array) -> Array:
        """Return u of the left curve at a radius, mm; for equal curves it is u of the right one."""
        equal = np.ptp(np.asarray(self.tooth.pressure_angles)) == 0
        return right if equal else self.left.at_radius(radius)

    def land(self, z: Array) -> Array:
        """Return the angle of the root land, rad; it is negative where the fillets overlap."""
        return self.pitch + self.rotation(z).sum(axis=-1) - self.feet_angle

    def breaks(self, low: float, high: float) -> list[float]:
        """Return heights, mm, at which the bottom of the space changes between land and crossing.

        They include the heights at which the crossing passes from a fillet to a flank.
        """
        heights = np.linspace(low, high, _TABLE_POINTS)
        breaks = set()
        for level in self._levels():

            def excess(z: float, level: float = level) -> float:
                return float(self.rotation(np.array([z])).sum()) - level

            values = self.rotation(heights).sum(axis=-1) - level
            for k in np.flatnonzero(values[:-1] * values[1:] < 0):
                bracket = (heights[k], heights[k + 1])
                breaks.add(root_scalar(excess, bracket=bracket, xtol=1e-13).root)
        margin = 1e-6 * (high - low)
        return sorted(z for z in breaks if low + margin < z < high - margin)

    def _levels(self) -> list[float]:
        """Return values of (δ_left + δ_right)/R, rad, at which the bottom of the space changes.

        There the fillets just touch, or their crossing passes from a fillet to a flank.
        """
        joints = [half(np.ones(()))[0] for half in (self.left, self.right)]
        return [x - self.pitch for x in (self.feet_angle, *(float(self._sum(r)) for r in joints))]

    @cached_property
    def feet_angle(self) -> float:
        """Sum of ψ₀ of both sides at the ends of the fillets on the root circle, rad."""
        return sum(float(half(np.zeros(()))[1]) for half in (self.left, self.right))

    def _sum(self, radius: Array) -> Array:
        """Return ψ₀ of the left plus ψ₀ of the right side, rad, at a radius, mm."""
        left, right = (half(half.at_radius(radius))[1] for half in (self.left, self.right))
        return np.asarray(left + right)

    def check(self, z: Float[np.ndarray, " n"]) -> None:
        """Raise `PairError` if teeth overlap above the root circle or are cut through."""
        radii = np.linspace(float(self.tooth.root_radius), float(self.tooth.tip_radius), 201)
        both = self._sum(radii[1:-1])  # the ends of the curves are only exact to rounding
        rotation = self.rotation(z).sum(axis=-1)
        filled = both > self.pitch + rotation[:, None]
        for index, z_mm in enumerate(z):
            waist = int(np.argmin(both))
            if both[waist] <= rotation[index]:
                raise PairError(
                    f"the tooth is cut through at a radius of {radii[1:-1][waist]:.3f} mm at z ="
                    f" {z_mm:g} mm; take more teeth or a larger profile shift.",
                    where="undercut",
                )
            if filled[index, -1]:
                raise PairError(
                    f"neighbouring teeth touch at the tip circle at z = {z_mm:g} mm, so there is no"
                    " space; make the face narrower or the helix angles smaller.",
                    where="space",
                )
            if (filled[index, 1:] & ~filled[index, :-1]).any():
                raise PairError(
                    f"the undercut teeth overlap above the root at z = {z_mm:g} mm; take more"
                    " teeth, a larger profile shift or a narrower face.",
                    where="space",
                )


def gear_profile(tooth: Tooth) -> GearProfile:
    """Return the profile curves of a gear that `check_tooth` accepts.

    **Raises** `PairError` if an undercut removes a flank or if fillet and flank do not join.
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
                f"the undercut removes the whole {side} flank; take more teeth, a larger profile"
                " shift or a smaller fillet radius.",
                where="undercut",
            )
        share = root_scalar(
            lambda u: float(whole(np.asarray(u))[0]) - form, bracket=(0.0, 1.0), xtol=1e-15
        ).root
        fillet_end = math.pi / 2 + share * (fillet_end - math.pi / 2)
        start = float(flank_roll(tooth, np.asarray(form), side))
    half = HalfProfile(rack, fillet_end, start, end)
    _check_curve(half, side)
    return half


def _check_curve(half: HalfProfile, side: Side) -> None:
    radius, angle = half(np.array([1.0, np.nextafter(1.0, 2.0)]))
    gap = math.hypot(radius[1] - radius[0], radius[0] * (angle[1] - angle[0]))
    steps = np.diff(half(np.linspace(0.0, 2.0, _TABLE_POINTS))[0])
    if not gap < _GAP_MM or not (steps > 0).all():
        raise PairError(
            f"fillet and {side} flank do not form one curve of increasing radius; take more teeth,"
            " a larger profile shift or a smaller fillet radius.",
            where="fillet",
        )


def _increasing_root(
    function: Callable[[Array], Array], low: Array, high: Array, *, steps: int = 30
) -> Array:
    """Return the root of an increasing function between two bounds by the Illinois method."""
    at_low, at_high, root = function(low), function(high), low
    last_side = np.zeros(np.shape(low), int)  # 1 below the root, −1 above, 0 at first
    for _ in range(steps):
        slope = at_high - at_low
        share = np.where(slope > 0, -at_low / np.where(slope > 0, slope, 1.0), 0.5)
        root = np.asarray(low + np.clip(share, 0.0, 1.0) * (high - low))
        value = function(root)
        if (np.abs(value) < _TOLERANCE).all():
            break
        side = np.where(value < 0, 1, -1)
        repeated = side == last_side  # the other bound did not move, so its value is halved
        at_high = np.where(side < 0, value, np.where(repeated, at_high / 2, at_high))
        at_low = np.where(side > 0, value, np.where(repeated, at_low / 2, at_low))
        low, high = np.where(side > 0, root, low), np.where(side < 0, root, high)
        last_side = side
    return root
