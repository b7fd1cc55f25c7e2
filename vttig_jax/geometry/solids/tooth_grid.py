"""Grid of points of one tooth with rows (sections) and columns (around the profile)."""

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
"""Pieces of one tooth, counter-clockwise from the middle of a space to the middle of the next."""

_CLOSED = 1e-9
"""Share of a curve, or angle of a land in rad, that is treated as zero (chosen)."""


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
    sections: tuple[int, ...]

    @property
    def around(self) -> int:
        """Number of intervals around one tooth, from space to space."""
        return 2 * (self.root + self.fillet + self.flank + self.tip)

    @property
    def rows(self) -> int:
        """Number of intervals along the face."""
        return sum(self.sections)

    def of(self, part: Part) -> int:
        """Return the number of intervals along the profile in one part on one side of the tooth.

        `part` is "root", "fillet", "flank" or "tip".
        """
        return getattr(self, part)

    def pieces(self) -> list[int]:
        """Return the number of intervals along the profile of each of the eight pieces.

        The pieces are the four parts on both sides of the tooth, in the sequence of `ORDER`.
        """
        return [self.of(part) for _, part in ORDER]


@dataclass(frozen=True)
class ToothGrid:
    """Grid of one tooth; its curves are clipped where they cross at the bottom of a space.

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
        stretches = [
            np.linspace(low, high, count * finer + 1)
            for low, high, count in zip(
                self.stretches[:-1], self.stretches[1:], self.counts.sections, strict=True
            )
        ]
        return np.concatenate([*(z[:-1] for z in stretches), stretches[-1][-1:]])

    def points(self, finer: int = 1) -> Float[np.ndarray, "rows columns 3"]:
        """Return x, y, z in mm, counter-clockwise seen from +z, from space to space.

        Each interval of both directions is divided into `finer` parts.
        """
        return self.rows_at(self.heights(finer), finer)

    def rows_at(
        self, z: Float[np.ndarray, " rows"], finer: int
    ) -> Float[np.ndarray, "rows columns 3"]:
        """Return the points, mm, at given heights, mm; `finer` divides the columns."""
        radius, clockwise = section_curve(self.profile, self.counts, z, finer)
        x, y = radius * np.sin(clockwise), radius * np.cos(clockwise)
        return np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)

    @cached_property
    def joints(self) -> Int[np.ndarray, "9"]:
        """Columns at which the eight pieces begin and end."""
        return np.cumsum([0, *self.counts.pieces()])

    def point_columns(self) -> Int[np.ndarray, "rows columns"]:
        """Return, for each column, the number of the column whose point it uses.

        A column uses its own point, except in a closed piece, whose columns all lie at one place:
        on the right they use the point of the first column, on the left that of the last column.
        """
        counts, last = self.counts, self.counts.around
        columns = np.broadcast_to(np.arange(last + 1), (len(self.z), last + 1)).copy()
        starts, no_land = self.profile.starts(self.z), self.profile.land(self.z) < _CLOSED
        for side in SIDES:
            no_fillet = starts[:, SIDES.index(side)] > 1 - _CLOSED
            widths = (no_land, counts.root), (no_fillet, counts.root + counts.fillet)
            for closed, width in widths:
                rows: Bool[np.ndarray, " rows"] = closed
                if side == "right":
                    columns[rows, : width + 1] = 0
                else:
                    columns[rows, last - width :] = last
        return columns


def space_middle(profile: GearProfile, z: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
    """Return the clockwise angle of the middle of the space minus half a pitch, rad.

    For helical teeth it can exceed a turn and is not wrapped.
    """
    starts, rotation = profile.starts(z), profile.rotation(z)
    halves = enumerate((profile.left, profile.right))
    left, right = (half(starts[:, index])[1] - rotation[:, index] for index, half in halves)
    return (right - left) / 2


def section_curve(
    profile: GearProfile, counts: Counts, z: Float[np.ndarray, " rows"], finer: int = 1
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
    """Return radius in mm and clockwise angle in rad of points around one tooth at heights z."""
    starts, rotation = profile.starts(z), profile.rotation(z)
    feet, tips = [], []
    for index, half in enumerate((profile.left, profile.right)):
        radius, angle = half(starts[:, index])
        feet.append((radius, angle - rotation[:, index]))
        tips.append(half(np.full(len(z), 2.0))[1] - rotation[:, index])
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
            angle = angle - rotation[:, index, None]
        if side == "left":
            radius, angle = radius[:, ::-1], -angle[:, ::-1]
        radii.append(radius)
        angles.append(angle)

    def joined(pieces: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([*(piece[:, :-1] for piece in pieces[:-1]), pieces[-1]], axis=1)

    return joined(radii), joined(angles)
