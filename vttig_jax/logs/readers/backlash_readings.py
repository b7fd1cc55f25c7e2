"""Backlash readings at single angles: gear 1 is held and gear 2 is turned to both flanks."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int64
from numpy.typing import ArrayLike

from ...base.errors import LogError
from ...base.files.text_tables import key_values
from ...base.units import ANGLE_UNITS, DEG, REV
from ...pair.schema import LogLayout
from .column_names import name_and_unit
from .delimited import TextTable, find_table
from .text import read_text

UNITS = {"driving": ("deg", "rad", "rev"), "backlash": ("deg", "arcsec", "urad", "rad")}
"""Columns of a file of readings, and the units with which their names may end."""

MOST_DRIVING = 1e6 * REV
"""Largest driving angle of a reading in rad (chosen: a million turns, at which the last digit of
float64 is 1e-9 rad)."""

MOST_BACKLASH = REV / 2
"""Largest backlash of a reading in rad: half a turn, within which the next teeth engage."""


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
        _check(driving, backlash, names, lines, source)
        driving, backlash = driving * DEG, backlash * DEG
        _check_sizes(driving, backlash, names, lines, source)
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


def read_backlash_readings(path: str | Path, *, decimal: str | None = None) -> BacklashReadings:
    """Read a text file (CSV, TSV, TXT) of backlash readings.

    The file has one header line and one reading per line. It needs a column `driving_deg` (or
    `_rad`, `_rev`) and a column `backlash_deg` (or `_arcsec`, `_urad`, `_rad`) with the angle of
    the driven gear. Other columns are ignored; several readings may have the same angle.

    **Arguments**
    - `path`: path of the file.
    - `decimal`: decimal mark "." or ","; required only if the file is ambiguous.

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
    text, digest, _ = read_text(path, None)
    table = _find_table(text, source, decimal)
    columns = {role: _column(table, role) for role in UNITS}
    values = table.columns([index for index, _ in columns.values()], keep_last=True)
    driving, backlash = (np.asarray(column, np.float64) for column in values)
    lines = np.array([number for number, _ in table.rows()], np.int64)
    names = {role: table.names[index] for role, (index, _) in columns.items()}
    _check(driving, backlash, names, lines, source)
    factors = {role: ANGLE_UNITS[unit] for role, (_, unit) in columns.items()}
    driving, backlash = driving * factors["driving"], backlash * factors["backlash"]
    _check_sizes(driving, backlash, names, lines, source)
    return BacklashReadings(driving, backlash, source, digest, lines)


def _find_table(text: str, source: str, decimal: Any) -> TextTable:
    try:
        return find_table(text, source, LogLayout(decimal=decimal))
    except LogError as error:
        # The messages of `find_table` are about encoder logs.
        raise LogError(
            "there is no header with rows of as many numbers below it; write a line"
            " driving_deg,backlash_deg and one reading per line (with semicolons between numbers"
            " with decimal commas).",
            where=error.where,
        ) from None


def _column(table: TextTable, role: str) -> tuple[int, str]:
    """Return the index and unit of the column of a role."""
    units = UNITS[role]
    matches: list[tuple[int, str]] = []
    for index, name in enumerate(table.names):
        stem, unit = name_and_unit(name, units, f"{table.source}: column `{name}`")
        if stem.lower() != role:
            continue
        if unit is None:
            raise LogError(
                f"the name has no unit; rename it {_suggested_names(role, units)}.",
                where=f"{table.source}: column `{name}`",
            )
        matches.append((index, unit))
    if len(matches) > 1:
        names = ", ".join(table.names[index] for index, _ in matches)
        raise LogError(
            f"{len(matches)} columns could be `{role}` ({names}); leave one of them.",
            where=table.source,
        )
    if not matches:
        raise LogError(
            f"there is no column {_suggested_names(role, units)}; the file has"
            f" {', '.join(table.names)}: rename or convert the right one.",
            where=table.source,
        )
    return matches[0]


def _suggested_names(role: str, units: Sequence[str]) -> str:
    first, *others, last = units
    rest = "".join(f", _{unit}" for unit in others)
    return f"{role}_{first}{rest} or _{last}"


def _check(
    driving: Float[np.ndarray, " n"],
    backlash: Float[np.ndarray, " n"],
    names: dict[str, str],
    lines: Int64[np.ndarray, " n"],
    source: str,
) -> None:
    """Raise `LogError` for values that are not finite and for negative backlash.

    The values are in the units of the file; `names` is role → column name.
    """
    for role, values in (("driving", driving), ("backlash", backlash)):
        invalid = np.flatnonzero(~np.isfinite(values))
        if invalid.size:
            raise LogError(
                f"{values[invalid[0]]:g} is not a reading; write the value or remove the line.",
                where=f"{source}: line {lines[invalid[0]]}, column `{names[role]}`",
            )
    negative = np.flatnonzero(backlash < 0)
    if negative.size:
        raise LogError(
            f"the file has a negative backlash ({backlash[negative[0]]:g}, {negative.size} of"
            f" {len(backlash)} readings); subtract the position on flank A from that on flank B, so"
            " that the backlash is positive.",
            where=f"{source}: line {lines[negative[0]]}, column `{names['backlash']}`",
        )


def _check_sizes(
    driving: Float[np.ndarray, " n"],
    backlash: Float[np.ndarray, " n"],
    names: dict[str, str],
    lines: Int64[np.ndarray, " n"],
    source: str,
) -> None:
    """Raise `LogError` for angles (rad) beyond `MOST_DRIVING` or `MOST_BACKLASH`."""
    for role, values, limit, cure in (
        ("driving", driving, MOST_DRIVING, "an angle of a driving shaft"),
        ("backlash", backlash, MOST_BACKLASH, "a backlash, which is less than half a turn"),
    ):
        large = np.flatnonzero(np.abs(values) > limit)
        if large.size:
            raise LogError(
                f"{values[large[0]] / DEG:.4g}° is not {cure}; correct the value or the unit of its"
                " column.",
                where=f"{source}: line {lines[large[0]]}, column `{names[role]}`",
            )
