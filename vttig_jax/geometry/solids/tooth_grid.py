"""Points of one tooth in rows (sections) and columns (around the profile), all rows alike."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from jaxtyping import Bool, Float, Int

from ..tooth.rack_cutter import SIDES, Side
from ..tooth.surface import PARTS, Part
from .gear_profile import GearProfile

ORDER: tuple[tuple[Side, Part], ...] = (
    *(("right", part) for part in PARTS),
    *(("left", part) for part in reversed(PARTS)),
)
"""The pieces of one tooth, counter-clockwise from the middle of a space to that of the next."""

_CLOSED = 1e-9
"""Share of a curve, or rad of a land, that counts as nothing."""


@dataclass(frozen=True)
class Counts:
    """Into how many intervals each piece and each stretch of the face is divided."""

    root: int
    fillet: int
    flank: int
    tip: int
    sections: tuple[int, ...]

    @property
    def around(self) -> int:
        """Intervals around one tooth, from space to space."""
        return 2 * (self.root + self.fillet + self.flank + self.tip)

    @property
    def rows(self) -> int:
        """Intervals along the face."""
        return sum(self.sections)

    def of(self, part: Part) -> int:
        """Intervals of one piece."""
        return getattr(self, part)

    def pieces(self) -> list[int]:
        """Intervals of each of the eight pieces."""
        return [self.of(part) for _, part in ORDER]


@dataclass(frozen=True)
class ToothGrid:
    """Sections of one tooth with its spaces' bottoms clipped where both cuts meet.

    **Arguments**
    - `profile`: the curves of the gear.
    - `counts`: the division.
    - `stretches`: heights between which `counts.sections` holds, mm.
    """

    profile: GearProfile
    counts: Counts
    stretches: tuple[float, ...]

    @cached_property
    def z(self) -> Float[np.ndarray, " rows"]:
        """Heights of the sections, mm."""
        return self.heights(1)

    def heights(self, finer: int) -> Float[np.ndarray, " rows"]:
        """Heights of the sections with each interval divided once more."""
        pieces = [
            np.linspace(low, high, count * finer + 1)
            for low, high, count in zip(
                self.stretches[:-1], self.stretches[1:], self.counts.sections, strict=True
            )
        ]
        return np.concatenate([*(piece[:-1] for piece in pieces), pieces[-1][-1:]])

    def points(self, finer: int = 1) -> Float[np.ndarray, "rows columns 3"]:
        """x, y, z in mm, counter-clockwise seen from +z, from space to space.

        With `finer` each interval of both directions is divided into as many.
        """
        return self.rows_at(self.heights(finer), finer)

    def rows_at(
        self, z: Float[np.ndarray, " rows"], finer: int
    ) -> Float[np.ndarray, "rows columns 3"]:
        """The same at other heights; `finer` divides the columns."""
        radius, clockwise = section_curve(self.profile, self.counts, z, finer)
        x, y = radius * np.sin(clockwise), radius * np.cos(clockwise)
        return np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)

    @cached_property
    def joints(self) -> Int[np.ndarray, "9"]:
        """Columns at which the eight pieces begin and end."""
        return np.cumsum([0, *self.counts.pieces()])

    def columns(self) -> Int[np.ndarray, "rows columns"]:
        """Column whose point stands for each: pieces that have closed are one point.

        Closed on the right are those that fall on the first column, on the left on the last.
        """
        counts, last = self.counts, self.counts.around
        own = np.broadcast_to(np.arange(last + 1), (len(self.z), last + 1)).copy()
        starts, land = self.profile.starts(self.z), self.profile.land(self.z) < _CLOSED
        for side in SIDES:
            gone = starts[:, SIDES.index(side)] > 1 - _CLOSED
            for closed, width in ((land, counts.root), (gone, counts.root + counts.fillet)):
                where: Bool[np.ndarray, " rows"] = closed
                if side == "right":
                    own[where, : width + 1] = 0
                else:
                    own[where, last - width :] = last
        return own


def space_middle(profile: GearProfile, z: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
    """Clockwise angle by which the middles of the spaces are off half a pitch, rad.

    Winding teeth take it round and round; it is not cut at a turn.
    """
    starts, turned = profile.starts(z), profile.turned(z)
    halves = enumerate((profile.left, profile.right))
    left, right = (half(starts[:, index])[1] - turned[:, index] for index, half in halves)
    return (right - left) / 2


def section_curve(
    profile: GearProfile, counts: Counts, z: Float[np.ndarray, " rows"], finer: int = 1
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
    """Radius in mm and clockwise angle in rad of the points around one tooth at heights z."""
    starts, turned = profile.starts(z), profile.turned(z)
    feet, tips = [], []
    for index, half in enumerate((profile.left, profile.right)):
        radius, angle = half(starts[:, index])
        feet.append((radius, angle - turned[:, index]))
        tips.append(half(np.full(len(z), 2.0))[1] - turned[:, index])
    radii, angles = [], []
    for side, part in ORDER:
        index = SIDES.index(cast(Side, side))
        n = counts.of(part) * finer
        share = np.linspace(0.0, 1.0, n + 1)
        foot, tip = feet[index][1], tips[index]
        if part == "root":
            middle = (foot - feet[1 - index][1]) / 2 + math.pi / profile.tooth.teeth
            angle = middle[:, None] + share * (foot - middle)[:, None]
            radius = np.broadcast_to(feet[1][0][:, None], angle.shape)
        elif part == "tip":
            middle = (tip - tips[1 - index]) / 2
            angle = tip[:, None] + share * (middle - tip)[:, None]
            radius = np.full(angle.shape, float(profile.tooth.tip_radius))
        else:
            half = profile.left if side == "left" else profile.right
            end = 1.0 if part == "fillet" else 2.0
            begin = np.clip(starts[:, index], end - 1.0, end)[:, None]
            u = begin + share * (end - begin)
            radius, angle = half(u)
            angle = angle - turned[:, index, None]
        if side == "left":
            radius, angle = radius[:, ::-1], -angle[:, ::-1]
        radii.append(radius)
        angles.append(angle)

    def joined(pieces: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([*(piece[:, :-1] for piece in pieces[:-1]), pieces[-1]], axis=1)

    return joined(radii), joined(angles)
