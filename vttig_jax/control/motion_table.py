"""The CSV file of a recorded motion: two columns, and sentences for what is wrong with them."""

import csv
import math
from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from ..base.errors import InputError

COLUMNS: Final = ("time_s", "driving_deg")

SHORTEST_S: Final = 1e-9
"""Least time between two rows."""

LARGEST: Final = 1e12
"""Of a time or an angle in the file; beyond, neighbouring numbers are too far apart."""

_LIKE: Final = "it needs the columns time_s and driving_deg, separated by commas"


def read_columns(path: str | Path) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Times in s and driving angles in degrees, checked row by row.

    **Raises** `InputError` naming file, line and cure.
    """
    path = Path(path)
    rows = _rows(path)
    line, header = next(rows, (0, []))
    if not header:
        raise InputError(f"the file is empty; {_LIKE}.", where=str(path))
    places = [_place(header, name, path, line) for name in COLUMNS]
    found: list[tuple[float, float]] = []
    for line, fields in rows:
        where = f"{path}, line {line}"
        if len(fields) != len(header):
            raise InputError(
                f"{len(fields)} fields under {len(header)} column names; give every column one"
                " value, with a decimal point.",
                where=where,
            )
        time, angle = (
            _number(fields[place], name, where) for place, name in zip(places, COLUMNS, strict=True)
        )
        if found and time - found[-1][0] < SHORTEST_S:
            raise InputError(
                f"time_s goes from {found[-1][0]!r} to {time!r}; times must increase from row to"
                f" row, by {SHORTEST_S:g} s or more, so take the row out or sort the file.",
                where=where,
            )
        found.append((time, angle))
    if len(found) < 2:
        raise InputError(
            f"the number of rows is {len(found)}; a motion needs two or more.", where=str(path)
        )
    times, angles = np.array(found, np.float64).T
    if np.ptp(angles) == 0:
        raise InputError(
            f"driving_deg is {angles[0]:.10g} in every row; a motion must move the shaft.",
            where=str(path),
        )
    return times, angles


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and stripped fields of every line that is neither empty nor a remark."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            for row in reader:
                fields = [field.strip() for field in row]
                if any(fields) and not fields[0].startswith("#"):
                    yield reader.line_num, fields
    except FileNotFoundError:
        raise InputError("no such file; check the path of the motion.", where=str(path)) from None
    except IsADirectoryError:
        raise InputError(
            "this is a folder; name the file of the motion in it.", where=str(path)
        ) from None
    except PermissionError:
        raise InputError(
            "no permission to read this file; change its access rights.", where=str(path)
        ) from None
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error}); check the path and the disk.",
            where=str(path),
        ) from None
    except UnicodeDecodeError:
        raise InputError(
            f"not text in UTF-8; save the motion as CSV: {_LIKE}.", where=str(path)
        ) from None
    except csv.Error as error:
        raise InputError(
            f"not a CSV file ({error}); save the motion as CSV: {_LIKE}.", where=str(path)
        ) from None


def _place(header: list[str], name: str, path: Path, line: int) -> int:
    """Where a column stands."""
    where = f"{path}, line {line}"
    count = header.count(name)
    if count > 1:
        raise InputError(f"{count} columns are named {name}; keep one of them.", where=where)
    if count == 1:
        return header.index(name)
    like = get_close_matches(name, header, n=1)
    shown = ", ".join(header[:8]) + (", …" if len(header) > 8 else "")
    cure = f"rename `{like[0]}` if it is meant" if like else _LIKE
    raise InputError(f"no column {name} among: {shown}; {cure}.", where=where)


def _number(field: str, name: str, where: str) -> float:
    try:
        value = float(field)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST or "_" in field:
        seen = f"`{field}`" if field else "empty"
        raise InputError(
            f"{name} is {seen}; write a number up to {LARGEST:g} with a decimal point, or take the"
            " row out.",
            where=where,
        )
    return value
