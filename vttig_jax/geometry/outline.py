"""Outline of a gear in any section: flank, fillet and lands of each side, and its grid of points.

In every section a flank and its fillet are the same curve, rotated by δ(z)/R:

    ψ(u, z) = ψ₀(u) − δ(z)/R,    r = r(u)

ψ is the angle from the centre line of the tooth. Both cutters remove the space between two teeth;
where the fillets cross, the bottom of the space is the crossing instead of the root circle.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import root_scalar
from scipy.optimize.elementwise import find_root

from ..base.errors import PairError, UsageError
from .checks import check_measurable, section_heights, section_report
from .form import form_radius, undercut_depth
from .surface import PARTS, Part, RackSide, flank_roll, flank_span, rack_side
from .tooth import SIDES, Side, Taper, Tooth

Array = Float[np.ndarray, "..."]

# Chosen values:
_TOLERANCES = {"fatol": 2e-14}  # of a relative radius or of an angle in rad, in a root search
_TABLE_POINTS = 801  # points of a curve or of the face in a search
_GAP_MM = 1e-6  # largest distance between the ends of fillet and flank
_CLOSED = 1e-9  # share of a curve, or angle of a land in rad, that is treated as zero
_BORE_SHARE = 0.3  # default bore radius as a share of the root radius
_LEAST_BORE_MM = 0.1  # smallest bore
_FINEST_MM = 1e-8  # smallest tolerance: ten times the 1e-9 mm resolution of text files

ORDER: tuple[tuple[Side, Part], ...] = (
    *(("right", part) for part in PARTS),
    *(("left", part) for part in reversed(PARTS)),
)
"""Pieces of one tooth, counter-clockwise from the middle of a space to the middle of the next."""


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
        fillet = rack.to_gear(rack.arc(normal_angle, zero), rack.arc_roll(normal_angle))
        roll = self.flank_start + high * (self.flank_end - self.flank_start)
        flank = rack.to_gear(rack.flank(roll, zero), roll)
        x, y, _ = np.moveaxis(np.where((u <= 1.0)[..., None], fillet, flank), -1, 0)
        return np.asarray(np.hypot(x, y)), np.asarray(np.arctan2(-rack.mirror * x, y))

    def at_radius(self, radius: Array) -> Array:
        """Return u at radii, mm, between root and tip; u increases with the radius."""
        u, radii = self.table
        index = np.clip(np.searchsorted(radii, radius), 1, len(u) - 1)
        low, high = np.asarray(u[index - 1]), np.asarray(u[index])

        def excess(u: Array, radius: Array) -> Array:
            return np.asarray(self(u)[0] / radius - 1)

        found = find_root(excess, (low, high), args=(radius,), tolerances=_TOLERANCES)
        return np.asarray(found.x)

    @cached_property
    def table(self) -> tuple[Array, Array]:
        """Values of u and radii, mm, of points along the curve."""
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
        if (key := z.tobytes()) not in self._known_starts:
            self._known_starts[key] = self._starts(z)
        return self._known_starts[key]

    @cached_property
    def _known_starts(self) -> dict[bytes, Float[np.ndarray, "n 2"]]:
        """Results of `starts` by heights; points, closed pieces and bore use the same heights."""
        return {}

    def _starts(self, z: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        closed, starts = self.land(z) < 0, np.zeros((len(z), 2))
        if not closed.any():
            return starts
        target = (self.pitch + self.rotation(z).sum(axis=-1))[closed]
        equal = np.ptp(np.asarray(self.tooth.pressure_angles)) == 0

        def on_left(right: Array) -> Array:
            return right if equal else self.left.at_radius(self.right(right)[0])

        def opening(u: Array, target: Array) -> Array:
            return target - self.right(u)[1] - self.left(on_left(u))[1]

        u, radius = self.right.table
        both = self.right(u)[1] + np.interp(radius, self.left.table[1], self.left(u)[1])
        first = np.argmax(both[:, None] <= target, axis=0)  # the sum decreases from the root
        ends = u[np.maximum(first - 2, 0)], u[np.minimum(first + 1, len(u) - 1)]
        right = find_root(opening, ends, args=(target,), tolerances=_TOLERANCES).x
        starts[closed] = np.stack([on_left(right), right], axis=-1)
        return starts

    def land(self, z: Array) -> Array:
        """Return the angle of the root land, rad; it is negative where the fillets overlap."""
        return self.pitch + self.rotation(z).sum(axis=-1) - self.feet_angle

    def breaks(self, low: float, high: float) -> list[float]:
        """Return heights, mm, at which the bottom of the space changes between land and crossing.

        They include the heights at which the crossing passes from a fillet to a flank.
        """
        heights, breaks = np.linspace(low, high, _TABLE_POINTS), set()
        joints = [float(self._sum(half(np.ones(()))[0])) for half in (self.left, self.right)]
        for level in (self.feet_angle, *joints):

            def excess(z: float | Array, level: float = level) -> Array:
                return self.rotation(np.atleast_1d(z)).sum(axis=-1) - (level - self.pitch)

            values = excess(heights)
            for k in np.flatnonzero(values[:-1] * values[1:] < 0):
                ends = (heights[k], heights[k + 1])
                breaks.add(root_scalar(lambda z: excess(z).item(), bracket=ends, xtol=1e-13).root)
        margin = 1e-6 * (high - low)
        return sorted(z for z in breaks if low + margin < z < high - margin)

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
        radii = np.linspace(float(self.tooth.root_radius), float(self.tooth.tip_radius), 201)[1:-1]
        both = self._sum(radii)  # without the ends of the curves, only exact to rounding
        rotation, waist = self.rotation(z).sum(axis=-1), radii[np.argmin(both)]
        filled = both > self.pitch + rotation[:, None]
        for bad, seen, cure, where in (
            (
                both.min() <= rotation,
                f"the tooth is cut through at a radius of {waist:.3f} mm",
                "take more teeth or a larger profile shift",
                "undercut",
            ),
            (
                (filled[:, 1:] & ~filled[:, :-1]).any(axis=1),
                "the undercut teeth overlap above the root",
                "take more teeth, a larger profile shift or a narrower face",
                "space",
            ),
        ):
            if bad.any():
                height = z[np.argmax(bad)]
                raise PairError(f"{seen} at z = {height:g} mm; {cure}.", where=where)


def gear_profile(tooth: Tooth) -> GearProfile:
    """Return the profile curves of a gear that `check_tooth` accepts.

    **Raises** `PairError` if fillet and flank do not join.
    """
    left, right = (_half_profile(tooth, side) for side in SIDES)
    return GearProfile(tooth, left, right)


def _half_profile(tooth: Tooth, side: Side) -> HalfProfile:
    rack = replace(rack_side(tooth, side), recession=Taper(0.0))
    half = HalfProfile(rack, float(rack.pressure_angle), *map(float, flank_span(tooth, side)))
    form = form_radius(tooth, side)
    if undercut_depth(tooth, side) > 0 and half(np.ones(()))[0] > form:
        share = root_scalar(
            lambda u: float(half(np.asarray(u))[0]) - form, bracket=(0.0, 1.0), xtol=1e-15
        ).root
        half = replace(
            half,
            fillet_end=math.pi / 2 + share * (half.fillet_end - math.pi / 2),
            flank_start=float(flank_roll(tooth, np.asarray(form), side)),
        )
    radius, angle = half(np.array([1.0, np.nextafter(1.0, 2.0)]))
    gap = math.hypot(radius[1] - radius[0], radius[0] * (angle[1] - angle[0]))
    if not gap < _GAP_MM or not (np.diff(half.table[1]) > 0).all():
        raise PairError(
            f"fillet and {side} flank do not form one curve of increasing radius; take more teeth,"
            " a larger profile shift or a smaller fillet radius.",
            where="fillet",
        )
    return half


@dataclass(frozen=True)
class Counts:
    """Numbers of intervals of the grid of one tooth.

    **Arguments**
    - `root`, `fillet`, `flank`, `tip`: intervals along the profile in these parts on each side of
      the tooth.
    - `sections`: intervals along the face in each of its stretches.
    """

    root: int
    fillet: int
    flank: int
    tip: int
    sections: tuple[int, ...] = (1,)

    @property
    def pieces(self) -> list[int]:
        """Intervals along the profile of each of the eight pieces, in the sequence of `ORDER`."""
        return [getattr(self, part) for _, part in ORDER]

    @property
    def around(self) -> int:
        """Number of intervals around one tooth, from space to space."""
        return sum(self.pieces)

    @property
    def rows(self) -> int:
        """Number of intervals along the face."""
        return sum(self.sections)

    @property
    def joints(self) -> Int[np.ndarray, "9"]:
        """Columns at which the eight pieces begin and end."""
        return np.cumsum([0, *self.pieces])


@dataclass(frozen=True)
class ToothGrid:
    """Grid of points of one tooth with rows (sections) and columns (around the profile).

    Its curves are clipped where they cross at the bottom of a space.

    **Arguments**
    - `profile`: curves of the gear.
    - `counts`: number of intervals.
    - `stretches`: limits of the stretches of `counts.sections`, mm.
    """

    profile: GearProfile
    counts: Counts
    stretches: tuple[float, ...]

    @cached_property
    def z(self) -> Float[np.ndarray, " rows"]:
        """Heights of the sections, mm."""
        return self.heights(1)

    def heights(self, finer: int) -> Float[np.ndarray, " rows"]:
        """Return the heights of sections, mm, with every interval divided into `finer` parts."""
        ends = zip(self.stretches[:-1], self.stretches[1:], self.counts.sections, strict=True)
        rows = [np.linspace(low, high, count * finer + 1)[:-1] for low, high, count in ends]
        return np.concatenate([*rows, self.stretches[-1:]])

    def points(self, finer: int = 1) -> Float[np.ndarray, "rows columns 3"]:
        """Return x, y, z in mm, counter-clockwise seen from +z, from space to space.

        Each interval of both directions is divided into `finer` parts.
        """
        return self.rows_at(self.heights(finer), finer)

    def rows_at(
        self, z: Float[np.ndarray, " rows"], finer: int
    ) -> Float[np.ndarray, "rows columns 3"]:
        """Return the points, mm, at given heights, mm; `finer` divides the columns."""
        x, y = np.moveaxis(section_points(self.profile, self.counts, z, finer), -1, 0)
        return np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)

    def point_columns(self) -> Int[np.ndarray, "rows columns"]:
        """Return, for each column, the number of the column whose point it uses.

        A column uses its own point, except in a closed piece, whose columns all lie at one place:
        on the right they use the point of the first column, on the left that of the last column.
        """
        counts, last = self.counts, self.counts.around
        columns = np.tile(np.arange(last + 1), (len(self.z), 1))
        starts, no_land = self.profile.starts(self.z), self.profile.land(self.z) < _CLOSED
        for index, side in enumerate(SIDES):
            no_fillet = starts[:, index] > 1 - _CLOSED
            for rows, width in (no_land, counts.root), (no_fillet, counts.root + counts.fillet):
                if side == "right":
                    columns[rows, : width + 1] = 0
                else:
                    columns[rows, last - width :] = last
        return columns


def section_points(
    profile: GearProfile, counts: Counts, z: Float[np.ndarray, " rows"], finer: int = 1
) -> Float[np.ndarray, "rows columns 2"]:
    """Return x, y in mm of points around one tooth at heights z; see `section_curve`."""
    radius, clockwise = section_curve(profile, counts, z, finer)
    return np.stack([radius * np.sin(clockwise), radius * np.cos(clockwise)], axis=-1)


def section_curve(
    profile: GearProfile, counts: Counts, z: Float[np.ndarray, " rows"], finer: int = 1
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
    """Return radius in mm and clockwise angle in rad of points around one tooth at heights z."""
    starts, rotation = profile.starts(z), profile.rotation(z)
    halves = profile.left, profile.right
    feet = [half(starts[:, k])[1] - rotation[:, k] for k, half in enumerate(halves)]
    tips = [half(np.full(len(z), 2.0))[1] - rotation[:, k] for k, half in enumerate(halves)]
    foot_radius = profile.right(starts[:, 1])[0]
    radii, angles = [], []
    for side, part in ORDER:
        index = SIDES.index(side)
        share = np.linspace(0.0, 1.0, getattr(counts, part) * finer + 1)
        foot, tip = feet[index], tips[index]
        if part == "root":
            middle = (foot - feet[1 - index]) / 2 + math.pi / profile.tooth.teeth
            angle = middle[:, None] + share * (foot - middle)[:, None]
            radius = np.broadcast_to(foot_radius[:, None], angle.shape)
        elif part == "tip":
            middle = (tip - tips[1 - index]) / 2
            angle = tip[:, None] + share * (middle - tip)[:, None]
            radius = np.full(angle.shape, float(profile.tooth.tip_radius))
        else:
            end = 1.0 if part == "fillet" else 2.0
            begin = np.clip(starts[:, index], end - 1.0, end)[:, None]
            radius, angle = halves[index](begin + share * (end - begin))
            angle = angle - rotation[:, index, None]
        if side == "left":
            radius, angle = radius[:, ::-1], -angle[:, ::-1]
        last = None if (side, part) == ORDER[-1] else -1
        radii.append(radius[:, :last])
        angles.append(angle[:, :last])
    return np.concatenate(radii, axis=1), np.concatenate(angles, axis=1)


@dataclass(frozen=True)
class Blank:
    """Gear or sector of a gear that is built as a solid.

    **Arguments**
    - `profile`: curves of the gear.
    - `teeth`: number of teeth built.
    - `whole`: whether the whole gear is built, not a sector.
    - `bore_mm`: diameter of the bore, 0 for none.
    - `notes`: sentences on the geometry of the teeth.
    """

    profile: GearProfile
    teeth: int
    whole: bool
    bore_mm: float
    notes: tuple[str, ...]


def blank_of(
    tooth: Tooth,
    *,
    teeth: int | None,
    bore_mm: float | None,
    tolerance_mm: float,
    section_mm: float | None = None,
    finest_mm: float = _FINEST_MM,
) -> Blank:
    """Check a gear and the options of a solid, which are those of `gear_mesh`; return its `Blank`.

    The whole face is checked, or only the section at height `section_mm`. `finest_mm` is the
    smallest permitted tolerance.
    """
    if not 0 < tolerance_mm < math.inf:
        raise ValueError(f"Argument `tolerance_mm` must be above 0, but is {tolerance_mm}.")
    if tolerance_mm < finest_mm:
        raise UsageError(
            f"a tolerance of {1e3 * tolerance_mm:g} µm is below the accuracy of the file; give"
            f" --tolerance-um {1e3 * finest_mm:g} or more."
        )
    width, count = float(tooth.face_width_mm), tooth.teeth if teeth is None else teeth
    if section_mm is None and not width > 0:
        raise PairError(
            "a gear without face width has no solid; give its face_width_mm.", where="face_width_mm"
        )
    if section_mm is not None and abs(section_mm) > width / 2:
        raise UsageError(
            f"--section-mm {section_mm:g} is outside the gear; its face ends at ±{width / 2:g} mm."
        )
    heights = section_heights(tooth, section_mm)
    if not 1 <= count <= tooth.teeth:
        raise UsageError(
            f"the gear has {tooth.teeth} teeth, so --teeth {teeth} is not possible; give 1 to"
            f" {tooth.teeth}."
        )
    check_measurable(tooth, float(heights[0]))
    profile = gear_profile(tooth)
    profile.check(heights)
    root, turns = float(tooth.root_radius), profile.rotation(heights).sum(axis=-1)
    bore = 2 * _BORE_SHARE * root if bore_mm is None else bore_mm
    rim = 2 * root * math.cos(min(profile.feet_angle - float(turns.min()), profile.pitch) / 2)
    if 0 < bore < _LEAST_BORE_MM:
        raise UsageError(
            f"a bore of {bore:g} mm is too small; give --bore-mm 0 for a gear without bore, or"
            f" {_LEAST_BORE_MM:g} or more."
        )
    if not 0 <= bore < 0.99 * rim:
        raise UsageError(
            f"a bore of {bore:g} mm leaves no rim below the teeth, whose root diameter is"
            f" {2 * root:g} mm; give --bore-mm {math.floor(9.8 * rim) / 10:g} or less, 0 for none."
        )
    return Blank(profile, count, count == tooth.teeth, bore, _notes(profile, heights))


def _notes(profile: GearProfile, heights: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    notes, tooth = [], profile.tooth
    overlap = profile.land(heights) < 0
    if overlap.any():
        worst = section_report(tooth, heights).largest_fillet_radius_mm.min()
        low, high = float(heights[overlap].min()), float(heights[overlap].max())
        if len(heights) > 1:
            # The overlap ends between two of the heights, where the fillets just touch.
            ends = [z for z in profile.breaks(heights[0], heights[-1]) if z > high]
            high = min([*ends, float(heights[-1])])
        where = f"at z = {low:g} mm" if low == high else f"from z = {low:.4g} to {high:.4g} mm"
        fits = f"; a cutter with a tip radius of {worst:.3f} mm fits" if worst >= 0 else ""
        notes.append(
            f"The fillets of neighbouring teeth overlap {where}; the bottom of the space is there"
            f" where they cross{fits}."
        )
    depth = max(undercut_depth(tooth, side) for side in SIDES)
    if depth > 0:
        notes.append(
            f"The teeth are undercut by {depth:.3f} mm; their flanks begin where the fillets cut"
            " them."
        )
    return tuple(notes)
