"""Reader of measured flank and pitch deviations, with one point or tooth on each line."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from ...base.errors import InputError, LogError
from ...geometry.deviations import Deviations, FlankMap
from ...geometry.tooth import SHAFTS
from ...pair.gear_pair import GearPair
from .delimited import find_table
from .text import read_text

MAP_COLUMNS = "roll_mm", "z_mm", "deviation_um"
PITCH_COLUMNS = "tooth", "deviation_um"

_MOST_MODULES = 0.25
"""Largest accepted deviation, in modules (chosen)."""

Place = tuple[int, int]
"""Indices of gear (driving, driven) and flank (A, B)."""

Rows = list[tuple[str, tuple[float, ...]]]
"""Place in the file and values of the lines of one flank."""

Made = TypeVar("Made")


def read_deviations(
    maps: str | Path | None = None, pitches: str | Path | None = None, *, pair: GearPair
) -> Deviations:
    """Read measured deviations of the gears of a pair from text files such as those of logs.

    The files have a header; the order of columns is free and other columns are ignored. `gear` is
    driving or driven, `flank` is A or B.

    **Arguments**
    - `maps`: file with columns gear, flank, roll_mm, z_mm, deviation_um. Each flank in the file has
      a complete grid: every roll length √(r² − r_b²) at every height, two or more of each. Heights
      are in the gear's own frame, from the middle of its face and positive towards its thin end.
    - `pitches`: file with columns gear, flank, tooth, deviation_um, with every tooth of each flank
      in the file: cumulative pitch deviation on the base circle; see `Deviations`. Tooth 1 is the
      one between the axes at φ = 0; the numbers follow the order in which teeth come into mesh.
    - `pair`: gear pair on whose flanks the points must lie.

    **Raises** `InputError` naming file and line for an invalid file: missing or invalid fields, a
    repeated or missing point, a point off the flank, or a deviation larger than a quarter module.

    **Example**
    ```python
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.logs import read_deviations
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> points = [(8, -9, 0.4), (8, 9, 0.1), (20, -9, -2.6), (20, 9, -3.0)]
    >>> lines = [f"driving,A,{roll},{z},{um}" for roll, z, um in points]
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "measured.csv"
    ...     _ = path.write_text("\\n".join(["gear,flank,roll_mm,z_mm,deviation_um", *lines]))
    ...     print(read_deviations(path, pair=pair))
    deviations of the flanks
      driving flank A  2 × 2 points, -3.00 … 0.40 µm

    ```
    """
    flanks = {} if maps is None else _by_flank(maps, MAP_COLUMNS, pair, _map)
    teeth = {} if pitches is None else _by_flank(pitches, PITCH_COLUMNS, pair, _pitch)
    both: dict[int, np.ndarray] = {}
    for (gear, side), column in teeth.items():
        both.setdefault(gear, np.zeros((2, len(column))))[side] = column
    driving, driven = ((flanks.get((gear, 0)), flanks.get((gear, 1))) for gear in (0, 1))
    return Deviations(driving, driven, both.get(0), both.get(1))


def _by_flank(
    path: str | Path,
    columns: tuple[str, ...],
    pair: GearPair,
    made: Callable[[Place, Rows, GearPair], Made],
) -> dict[Place, Made]:
    source, header = str(path), ("gear", "flank", *columns)
    text, _, _ = read_text(path, None)
    try:
        table = find_table(text, source)
    except LogError as error:
        raise InputError(
            f"there is no table; write the header {','.join(header)} and lines below it.",
            where=error.where,
        ) from None
    for name in header:
        if table.names.count(name) != 1:
            raise InputError(
                f"the file has {table.names.count(name)} columns `{name}` (the header has"
                f" {', '.join(table.names)}); write the header {','.join(header)}.",
                where=source,
            )
    places = [table.names.index(name) for name in header]
    words = [table.texts(place) for place in places[:2]]
    numbers = np.stack(
        [np.asarray(c, float) for c in table.columns(places[2:], keep_last=True)], axis=-1
    )
    most = _MOST_MODULES * 1e3 * float(pair.module_mm)
    rows: dict[Place, Rows] = {}
    for (line, _), gear, flank, values in zip(table.rows(), *words, numbers, strict=True):
        where = f"{source}: line {line}"
        if gear not in SHAFTS or flank not in ("A", "B"):
            raise InputError(
                f"{gear!r}, {flank!r} is no flank; write driving or driven, and A or B.",
                where=where,
            )
        if not np.isfinite(values).all():
            raise InputError(f"{values} are not all finite numbers; repair the line.", where=where)
        if abs(values[-1]) > most:
            raise InputError(
                f"a deviation of {values[-1]:g} µm is more than a quarter of the module"
                f" ({most:g} µm); give µm.",
                where=where,
            )
        place = SHAFTS.index(gear), "AB".index(flank)
        rows.setdefault(place, []).append((where, tuple(values.tolist())))
    return {place: made(place, found, pair) for place, found in rows.items()}


def _map(place: Place, rows: Rows, pair: GearPair) -> FlankMap:
    gear, side = place
    name = f"{SHAFTS[gear]} flank {'AB'[side]}"
    base, tip = float(pair.base_radii[gear, side]), float(pair.tip_radii[gear])
    longest = math.sqrt(max(tip**2 - base**2, 0.0))
    half = float(getattr(pair, SHAFTS[gear]).face_width_mm) / 2
    for where, (roll, z, _) in rows:
        # The flank may end half a module above the tip circle of the drawing.
        if not 0 <= roll <= longest + 0.5 * float(pair.module_mm):
            raise InputError(
                f"roll length {roll:g} mm is not on the {name}, which ends at {longest:.2f} mm;"
                " give √(r² − r_b²) in mm, not radii, diameters or angles.",
                where=where,
            )
        if abs(z) > half * (1 + 1e-9):
            raise InputError(
                f"z = {z:g} mm is off the {SHAFTS[gear]} face ({-half:g} to {half:g} mm); count"
                " heights from the middle of the face.",
                where=where,
            )
    points = _unique(name, rows, 2)
    rolls, heights = (sorted({point[k] for point in points}) for k in (0, 1))
    where = rows[0][0]
    if len(rolls) < 2 or len(heights) < 2:
        raise InputError(
            f"{name} has {len(rolls)} roll lengths at {len(heights)} heights; give two or more of"
            " each.",
            where=where,
        )
    for roll in rolls:
        for z in heights:
            if (roll, z) not in points:
                raise InputError(
                    f"{name} has no point at roll length {roll:g} mm and z = {z:g} mm; give all"
                    f" {len(rolls)} × {len(heights)} points of its grid.",
                    where=where,
                )
    return FlankMap(rolls, heights, [[points[roll, z] for z in heights] for roll in rolls])


def _pitch(place: Place, rows: Rows, pair: GearPair) -> Float[np.ndarray, " teeth"]:
    name = f"{SHAFTS[place[0]]} flank {'AB'[place[1]]}"
    count = getattr(pair, SHAFTS[place[0]]).teeth
    teeth = _unique(name, rows, 1)
    for number in (*(tooth for (tooth,) in teeth), *range(1, count + 1)):
        if (number,) not in teeth or number not in range(1, count + 1):
            raise InputError(
                f"tooth {number:g} of the {name} is"
                f" {'missing' if (number,) not in teeth else 'no tooth'}; give all teeth from 1 to"
                f" {count}.",
                where=rows[-1][0],
            )
    return np.array([teeth[tooth,] for tooth in range(1, count + 1)])


def _unique(name: str, rows: Rows, count: int) -> dict[tuple[float, ...], float]:
    """Return a dictionary from the first `count` values of each row to its last value."""
    found: dict[tuple[float, ...], float] = {}
    for where, values in rows:
        if values[:count] in found:
            raise InputError(
                f"{name} has a second line for {values[:count]}; keep one of them.", where=where
            )
        found[values[:count]] = values[-1]
    return found
