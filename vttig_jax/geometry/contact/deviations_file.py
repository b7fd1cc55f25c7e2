"""Reader of measured flank and pitch deviations from CSV files with one point or tooth per line."""

import csv
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.errors import InputError
from ...base.files.limits import read_regular
from ...pair.gear_pair import GearPair
from .deviations import Deviations, FlankMap

GEARS = "driving", "driven"
FLANKS = "A", "B"
MAP_COLUMNS = "roll_mm", "z_mm", "deviation_um"
PITCH_COLUMNS = "tooth", "deviation_um"

_MOST_MODULES = 0.25
"""Largest accepted deviation, in modules (chosen)."""

Place = tuple[int, int]
"""Indices of gear and flank in `GEARS` and `FLANKS`."""


class Row(NamedTuple):
    """One line of a file: its number, counted from 1, its flank and its values."""

    line: int
    flank: Place
    values: tuple[float, ...]

    def __str__(self) -> str:
        return f"{GEARS[self.flank[0]]} flank {FLANKS[self.flank[1]]}"


def read_deviations(
    maps: str | Path | None = None, pitches: str | Path | None = None, *, pair: GearPair
) -> Deviations:
    """Read measured deviations of the gears of a pair.

    Both files are UTF-8 text with a header, commas between fields and decimal points. The order of
    columns is free and other columns are ignored. `gear` is driving or driven, `flank` is A or B.

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
    >>> from vttig_jax.geometry import read_deviations
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
    flanks = {} if maps is None else _by_flank(maps, MAP_COLUMNS)
    by_flank = {place: _map(str(maps), rows, pair) for place, rows in flanks.items()}
    teeth = {} if pitches is None else _by_flank(pitches, PITCH_COLUMNS)
    columns = {place: _pitch(str(pitches), rows, pair) for place, rows in teeth.items()}
    return Deviations(
        driving=(by_flank.get((0, 0)), by_flank.get((0, 1))),
        driven=(by_flank.get((1, 0)), by_flank.get((1, 1))),
        driving_pitch_um=_both_flanks(columns, 0),
        driven_pitch_um=_both_flanks(columns, 1),
    )


def _map(path: str, rows: list[Row], pair: GearPair) -> FlankMap:
    for row in rows:
        _check_on_flank(path, row, pair)
        _check_size(path, row, pair)
    points = _unique(path, rows, 2, "the point at roll length {:g} mm and z = {:g} mm".format)
    rolls, heights = (sorted({point[k] for point in points}) for k in (0, 1))
    for name, knots in (("roll length", rolls), ("height", heights)):
        if len(knots) < 2:
            raise InputError(
                f"{rows[0]} has a single {name} ({knots[0]:g} mm); give two or more.",
                where=f"{path}: line {rows[0].line}",
            )
    for row in rows:
        for z in heights:
            if (row.values[0], z) not in points:
                raise InputError(
                    f"{row} has no point at roll length {row.values[0]:g} mm and z = {z:g} mm,"
                    " where other roll lengths have one; give all"
                    f" {len(rolls)} × {len(heights)} points of its grid.",
                    where=f"{path}: line {row.line}",
                )
    return FlankMap(rolls, heights, [[points[roll, z][-1] for z in heights] for roll in rolls])


def _check_on_flank(path: str, row: Row, pair: GearPair) -> None:
    """Raise `InputError` for a point that is not on the flank.

    Such a point has, for example, a diameter or an angle as roll length, or another zero of z.
    """
    gear, side = row.flank
    roll, z, _ = row.values
    base, tip = float(pair.base_radii[gear, side]), float(pair.tip_radii[gear])
    longest = math.sqrt(max(tip**2 - base**2, 0.0)) + 0.5 * float(pair.module_mm)
    where = f"{path}: line {row.line}"
    if not 0 <= roll <= longest:
        raise InputError(
            f"roll length {roll:g} mm is not on the {row}, which ends at"
            f" {longest - 0.5 * float(pair.module_mm):.2f} mm; give √(r² − r_b²) in mm, not radii,"
            " diameters or angles.",
            where=where,
        )
    half = float((pair.driving, pair.driven)[gear].face_width_mm) / 2
    if abs(z) > half * (1 + 1e-9):
        raise InputError(
            f"z = {z:g} mm is off the {GEARS[gear]} face ({-half:g} to {half:g} mm); count heights"
            " from the middle of the face.",
            where=where,
        )


def _check_size(path: str, row: Row, pair: GearPair) -> None:
    """Raise `InputError` for a deviation so large that its unit or its column is wrong."""
    most = _MOST_MODULES * 1e3 * float(pair.module_mm)
    if abs(row.values[-1]) > most:
        raise InputError(
            f"a deviation of {row.values[-1]:g} µm is more than a quarter of the module"
            f" ({most:g} µm); give µm.",
            where=f"{path}: line {row.line}",
        )


def _pitch(path: str, rows: list[Row], pair: GearPair) -> Float[np.ndarray, " teeth"]:
    count = (pair.driving, pair.driven)[rows[0].flank[0]].teeth
    for row in rows:
        if row.values[0] not in range(1, count + 1):
            raise InputError(
                f"{row.values[0]:g} is not a tooth of the {GEARS[row.flank[0]]} gear; count teeth"
                f" from 1 to {count}.",
                where=f"{path}: line {row.line}",
            )
        _check_size(path, row, pair)
    teeth = _unique(path, rows, 1, "tooth {:g}".format)
    missing = next((tooth for tooth in range(1, count + 1) if (tooth,) not in teeth), None)
    if missing is not None:
        raise InputError(
            f"{rows[0]} has no tooth {missing}; give all {count} of them.",
            where=f"{path}: line {rows[-1].line}",
        )
    return np.array([teeth[tooth,][-1] for tooth in range(1, count + 1)])


def _both_flanks(
    columns: dict[Place, Float[np.ndarray, " teeth"]], gear: int
) -> Float[np.ndarray, "2 teeth"] | None:
    """Return the pitch deviations of both flanks, 0 on an unmeasured flank; None without any."""
    flanks = [columns.get((gear, side)) for side in (0, 1)]
    measured = next((column for column in flanks if column is not None), None)
    if measured is None:
        return None
    return np.stack([np.zeros_like(measured) if column is None else column for column in flanks])


def _unique(
    path: str, rows: list[Row], count: int, name: Callable[..., str]
) -> dict[tuple[float, ...], tuple[float, ...]]:
    """Return a dictionary from the first `count` values of each row to all its values.

    Raise `InputError` if two rows have the same first values; `name` formats them for the message.
    """
    by_key: dict[tuple[float, ...], Row] = {}
    for row in rows:
        first = by_key.setdefault(row.values[:count], row)
        if first is not row:
            raise InputError(
                f"{row} has {name(*row.values[:count])} in line {first.line} already; keep one of"
                " them.",
                where=f"{path}: line {row.line}",
            )
    return {key: row.values for key, row in by_key.items()}


def _by_flank(path: str | Path, columns: tuple[str, ...]) -> dict[Place, list[Row]]:
    flanks: dict[Place, list[Row]] = {}
    for row in _rows(Path(path), columns):
        flanks.setdefault(row.flank, []).append(row)
    if not flanks:
        raise InputError(
            f"nothing is below the header; give a line for each {columns[0].removesuffix('_mm')}.",
            where=f"{path}: line 1",
        )
    return flanks


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[Row]:
    reader = csv.reader(_text(path).splitlines())
    header = ("gear", "flank", *columns)
    places: list[int] | None = None
    names: list[str] = []
    try:
        for fields in reader:
            if not any(field.strip() for field in fields):
                continue
            where = f"{path}: line {reader.line_num}"
            if places is None:
                names = [field.strip() for field in fields]
                places = _places(names, header, where)
                continue
            if len(fields) != len(names):
                raise InputError(
                    f"there are {len(fields)} fields, but the header has {len(names)}; separate"
                    " fields by commas and write decimal points.",
                    where=where,
                )
            gear, side, *texts = (fields[place].strip() for place in places)
            flank = _index_of(gear, GEARS, "gear", where), _index_of(side, FLANKS, "flank", where)
            pairs = zip(columns, texts, strict=True)
            values = tuple(_number(name, text, where) for name, text in pairs)
            yield Row(reader.line_num, flank, values)
    except csv.Error as error:
        raise InputError(
            f"the line is not CSV ({error}); write plain text with commas between fields.",
            where=f"{path}: line {reader.line_num}",
        ) from None
    if places is None:
        raise InputError(
            f"the file is empty; write the header {','.join(header)} and lines below it.",
            where=f"{path}: line 1",
        )


def _text(path: Path) -> str:
    try:
        return read_regular(path).decode("utf-8-sig").replace("\r\n", "\n")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}.", where=str(path)) from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"byte {error.start} is not UTF-8; save it as UTF-8 text.", where=str(path)
        ) from None


def _places(names: list[str], header: tuple[str, ...], where: str) -> list[int]:
    for name in header:
        if (count := names.count(name)) != 1:
            columns = "no column" if not count else f"{count} columns"
            raise InputError(
                f"the file has {columns} `{name}` (the header has {', '.join(names)}); write the"
                f" header {','.join(header)}.",
                where=where,
            )
    return [names.index(name) for name in header]


def _index_of(text: str, words: tuple[str, ...], name: str, where: str) -> int:
    if text not in words:
        raise InputError(f"{text!r} is not a {name}; write {' or '.join(words)}.", where=where)
    return words.index(text)


def _number(name: str, text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{text!r} is not a number for {name}; write a finite number.", where=where
        )
    return value
