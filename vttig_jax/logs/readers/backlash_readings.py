"""Small tables that are no logs: backlash readings, and deviations of flanks and pitch.

A backlash reading is taken at a single angle: gear 1 is held and gear 2 is turned to both flanks.
Flank and pitch deviations have one point or tooth on each line.
"""

import math
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64, Real
from numpy.typing import ArrayLike

from ...base.errors import InputError, LogError
from ...base.files.text_tables import key_values
from ...base.units import ANGLE_UNITS, DEG, LENGTH_UNITS, REV, radians_of
from ...geometry.deviations import Deviations, FlankMap
from ...geometry.tooth import SHAFTS
from ...pair.gear_pair import GearPair
from ...pair.schema import LogLayout
from ..source import Source
from .column_names import BACKLASH, index_of, name_and_unit, read_name, words_of
from .delimited import TextTable, find_table
from .text import read_text

UNITS = {
    "driving": ("deg", "rad", "rev"),
    "backlash": ("deg", "arcsec", "urad", "rad", "um", "mm", "inch"),
}
"""Columns of a file of readings, and usual units with which their names may end."""

MOST_DRIVING = 1e6 * REV
"""Largest driving angle of a reading in rad (chosen: a million turns, at which the last digit of
float64 is 1e-9 rad)."""

MOST_BACKLASH = REV / 2
"""Largest backlash of a reading in rad: half a turn, within which the next teeth engage."""


_RANGES = {
    "driving": ("an angle of a driving shaft", MOST_DRIVING, -np.inf),
    "backlash": ("a backlash, which is less than half a turn", MOST_BACKLASH, 0.0),
}
"""Role → what it is, and its largest and least value in rad."""

_SUBTRACT = (
    "subtract the position on flank A from that on flank B, so that the backlash is positive"
)


@dataclass(frozen=True, eq=False)
class BacklashReadings:
    """Backlash j = TE_B − TE_A at single driving angles, by the mechanical return method.

    **Arguments**
    - `driving_angle`: angle φ₁ in rad at which gear 1 was held, shape (n,), with the zero of the
      log.
    - `backlash`: angle in rad of the driven gear between its two flanks, shape (n,).
    - `source`, `sha256`: file name and digest of its bytes ("" without a file).
    - `lines`: line number of each reading in the file, from 1.
    """

    driving_angle: Float[np.ndarray, " n"]
    backlash: Float[np.ndarray, " n"]
    source: str
    sha256: str
    lines: Int64[np.ndarray, " n"]

    @classmethod
    def from_arrays(
        cls, driving_deg: ArrayLike, backlash_deg: ArrayLike, *, source: str = "arrays"
    ) -> "BacklashReadings":
        """Create readings from arrays of shape (n,) in degrees, validated like those of a file.

        **Raises** `ValueError` for arrays of other shapes, `LogError` for a reading that is not
        finite or is negative.

        **Example**
        ```python
        >>> from vttig_jax.logs import BacklashReadings
        >>> print(BacklashReadings.from_arrays([0.0, 90.0], [0.036, 0.021], source="bench"))
        bench
          readings       2
          driving angle  0° … 90°
          backlash       0.02100° … 0.03600°, mean 0.02850°

        ```
        """
        driving, backlash = (np.asarray(a, np.float64) for a in (driving_deg, backlash_deg))
        if driving.ndim != 1 or driving.shape != backlash.shape or not driving.size:
            raise ValueError(
                "Argument `backlash_deg` must have one reading for each of `driving_deg`, both of"
                f" shape (n,), but the shapes are {driving.shape} and {backlash.shape}."
            )
        # Line numbers in the file that `to_csv` writes; its header is line 1.
        lines = np.arange(2, 2 + driving.size, dtype=np.int64)
        names = {"driving": "driving_deg", "backlash": "backlash_deg"}
        place = Source(source, names, lines.__getitem__)
        driving = _radians("driving", driving, DEG, place)
        backlash = _radians("backlash", backlash, DEG, place)
        return cls(driving, backlash, source, "", lines)

    def to_csv(self) -> str:
        """Return the text of a file for `read_backlash_readings`: driving_deg,backlash_deg."""
        rows = zip(self.driving_angle / DEG, self.backlash / DEG, strict=True)
        body = "".join(f"{angle:.12g},{gap:.12g}\n" for angle, gap in rows)
        return "driving_deg,backlash_deg\n" + body

    def __len__(self) -> int:
        return len(self.driving_angle)

    def __str__(self) -> str:
        angle, gap = self.driving_angle / DEG, self.backlash / DEG
        rows = [
            ("readings", f"{len(self)}"),
            ("driving angle", f"{angle.min():.6g}° … {angle.max():.6g}°"),
            ("backlash", f"{gap.min():.5f}° … {gap.max():.5f}°, mean {gap.mean():.5f}°"),
        ]
        return key_values(rows, title=self.source)


def read_backlash_readings(
    path: str | Path,
    *,
    decimal: str | None = None,
    lead_mm: float | None = None,
    driving: str | None = None,
    driving_scale: float = 1.0,
) -> BacklashReadings:
    """Read a text file (CSV, TSV, TXT) of backlash readings.

    The file has one header line and one reading per line. It needs a column `driving_deg` (or
    `_rad`, `_rev`) and a column `backlash_deg` (or `_arcsec`, `_urad`, `_rad`) with the angle of
    the driven gear, or names that say the same in a log, such as `motor [°]` and `play [°]`. The
    backlash may be in µm or mm, as a dial gauge shows it: at the radius r its angle is
    length / r. Other columns are ignored; several readings may have the same angle.

    **Arguments**
    - `path`: path of the file.
    - `decimal`: decimal mark "." or ","; required only if the file is ambiguous.
    - `driving`: name or number (#2) of the column of angles, where no name says driving.
    - `driving_scale`: factor of these angles, i⁻¹ for positions of the driven shaft.
    - `lead_mm`: travel in one turn of the driven shaft, for a backlash in µm or mm: 2π r for a dial
      gauge at the radius r in mm.

    **Raises** `LogError` for a file that cannot be read, a missing or repeated column, an empty or
    non-finite field, and a negative backlash, which results from a subtraction in the wrong order.

    **Example**
    ```python
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from vttig_jax.logs import read_backlash_readings
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "readings.csv"
    ...     _ = path.write_text("driving_deg,backlash_arcsec\\n0,126\\n90,72\\n")
    ...     readings = read_backlash_readings(path)
    >>> print(readings.to_csv(), end="")
    driving_deg,backlash_deg
    0,0.035
    90,0.02

    ```
    """
    source = str(path)
    lines, digest, _ = read_text(path, None)
    try:
        mark: Any = decimal
        table = find_table(lines, source, LogLayout(decimal=mark))
    except LogError as error:  # the messages of `find_table` are about encoder logs
        raise LogError(
            "there is no header with rows of as many numbers below it; write a line"
            " driving_deg,backlash_deg and one reading per line (with semicolons between numbers"
            " with decimal commas).",
            where=error.where,
        ) from None
    columns = {role: _column(table, role, {"driving": driving}.get(role)) for role in UNITS}
    values = table.own_columns([index for index, _ in columns.values()], keep_last=True)
    lines = np.array([number for number, _ in table.rows()], np.int64)
    names = {role: table.names[index] for role, (index, _) in columns.items()}
    found, place = [], Source(source, names, lines.__getitem__)
    for (role, (_, unit)), one in zip(columns.items(), values, strict=True):
        radians = radians_of(unit, None, lead_mm)
        if radians is None:
            raise LogError(
                f"{unit} is a length; give --radius-mm, the radius in mm at which a dial gauge"
                " stands, or --lead-mm, the travel of a linear axis in one turn.",
                where=place.at(role),
            )
        found.append(_radians(role, one, radians, place))
    angle, backlash = found
    return BacklashReadings(driving_scale * angle, backlash, source, digest, lines)


def _column(table: TextTable, role: str, stated: str | None) -> tuple[int, str]:
    """Return the index and unit of the column of a role, by the words that say it in a log too.

    `stated` is its name if the user gives one.
    """
    named = index_of(stated, role, table.names, table.source) if stated else None
    first, *others, last = UNITS[role]
    suggested = f"{role}_{first}{''.join(f', _{unit}' for unit in others)} or _{last}"
    matches: list[tuple[int, str]] = []
    for index, name in enumerate(table.names):
        where = f"{table.source}: column `{name}`"
        known = (*ANGLE_UNITS, *(LENGTH_UNITS if role == "backlash" else ()))
        stem, unit = name_and_unit(name, known, where)
        gap = not BACKLASH.isdisjoint(words_of(stem))
        said = gap if role == "backlash" else not gap and read_name(name, where).role == role
        if index != named and (named is not None or (stem.lower() != role and not (said and unit))):
            continue
        if unit is None:
            raise LogError(f"the name has no unit; rename it {suggested}.", where=where)
        matches.append((index, unit))
    if len(matches) > 1:
        names = ", ".join(table.names[index] for index, _ in matches)
        raise LogError(
            f"{len(matches)} columns could be `{role}` ({names}); leave one of them.",
            where=table.source,
        )
    if not matches:
        raise LogError(
            f"there is no column {suggested}; the file has"
            f" {', '.join(table.names)}: rename the right one"
            f"{', or give --column driving=NAME without a log' * (role == 'driving')}.",
            where=table.source,
        )
    return matches[0]


def _radians(
    role: str, values: Real[np.ndarray, " n"], radians: float, place: Source
) -> Float[np.ndarray, " n"]:
    """Return a column in rad; `radians` is its unit.

    **Raises** `LogError` for values that are not finite, for a negative backlash, and for angles
    beyond `MOST_DRIVING` or `MOST_BACKLASH`.
    """
    angle, (what, most, least) = values * radians, _RANGES[role]
    for wrong, said in (
        (~np.isfinite(angle), "is not a reading; write the value or remove the line"),
        (np.abs(angle) > most, f"is not {what}; correct the value or the unit of its column"),
        (angle < least, f"is a negative {role}; {_SUBTRACT}"),
    ):
        if wrong.any():
            k = int(np.argmax(wrong))
            seen = f"{values[k]:g} ({np.count_nonzero(wrong)} of {len(values)} readings)"
            raise LogError(f"{seen} {said}.", where=place.at(role, k))
    return angle


MAP_COLUMNS = "roll_mm", "z_mm", "deviation_um"
PITCH_COLUMNS = "tooth", "deviation_um"

_MOST_MODULES = 0.25
"""Largest accepted deviation, in modules (chosen)."""

Place = tuple[int, int]
"""Indices of gear (driving, driven) and flank (A, B)."""

Points = dict[tuple[float, ...], tuple[str, float]]
"""Point or tooth of one flank → its place in the file, and the deviation in µm."""


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
    grids = {} if maps is None else _by_flank(maps, MAP_COLUMNS, pair)
    flanks = {place: _map(place, points, pair) for place, points in grids.items()}
    teeth = {} if pitches is None else _by_flank(pitches, PITCH_COLUMNS, pair)
    both: dict[int, np.ndarray] = {}
    for (gear, side), points in teeth.items():
        column = _pitch((gear, side), points, pair)
        both.setdefault(gear, np.zeros((2, len(column))))[side] = column
    driving, driven = ((flanks.get((gear, 0)), flanks.get((gear, 1))) for gear in (0, 1))
    return Deviations(driving, driven, both.get(0), both.get(1))


def _by_flank(path: str | Path, columns: tuple[str, ...], pair: GearPair) -> dict[Place, Points]:
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
    numbers = np.stack(table.own_columns(places[2:], keep_last=True), axis=-1).astype(float)
    most = _MOST_MODULES * 1e3 * float(pair.module_mm)
    flanks: dict[Place, Points] = {}
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
        points, point = flanks.setdefault(place, {}), tuple(values[:-1].tolist())
        if point in points:
            raise InputError(
                f"{_named(place)} has a second line for {point}; keep one of them.", where=where
            )
        points[point] = where, float(values[-1])
    return flanks


def _named(place: Place) -> str:
    return f"{SHAFTS[place[0]]} flank {'AB'[place[1]]}"


def _map(place: Place, points: Points, pair: GearPair) -> FlankMap:
    (gear, side), name = place, _named(place)
    base, tip = float(pair.base_radii[gear, side]), float(pair.tip_radii[gear])
    longest = math.sqrt(max(tip**2 - base**2, 0.0))
    half = float(getattr(pair, SHAFTS[gear]).face_width_mm) / 2
    for (roll, z), (where, _) in points.items():
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
    rolls, heights = (sorted({point[k] for point in points}) for k in (0, 1))
    where = next(iter(points.values()))[0]
    if len(rolls) < 2 or len(heights) < 2:
        raise InputError(
            f"{name} has {len(rolls)} roll lengths at {len(heights)} heights; give two or more of"
            " each.",
            where=where,
        )
    if lacking := set(product(rolls, heights)) - points.keys():
        roll, z = min(lacking)
        raise InputError(
            f"{name} has no point at roll length {roll:g} mm and z = {z:g} mm; give all"
            f" {len(rolls)} × {len(heights)} points of its grid.",
            where=where,
        )
    return FlankMap(rolls, heights, [[points[roll, z][1] for z in heights] for roll in rolls])


def _pitch(place: Place, teeth: Points, pair: GearPair) -> Float[np.ndarray, " teeth"]:
    name, count = _named(place), getattr(pair, SHAFTS[place[0]]).teeth
    for number in (*(tooth for (tooth,) in teeth), *range(1, count + 1)):
        if (number,) not in teeth or number not in range(1, count + 1):
            raise InputError(
                f"tooth {number:g} of the {name} is"
                f" {'missing' if (number,) not in teeth else 'no tooth'}; give all teeth from 1 to"
                f" {count}.",
                where=[*teeth.values()][-1][0],
            )
    return np.array([teeth[tooth,][1] for tooth in range(1, count + 1)])
