"""What every column of a log must satisfy, whether it came from a file or from arrays."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int8, Real
from numpy.typing import ArrayLike

from ..base.errors import LogError
from ..base.units import ANGLE_UNITS
from .source import Source

if TYPE_CHECKING:
    from .encoder_log import RawLog

FEWEST_SAMPLES = 4

PAUSE = 5.0
"""Sampling intervals longer than this many median ones are pauses."""


def as_column(name: str, values: ArrayLike, size: int | None) -> Real[np.ndarray, " n"]:
    """A copy as a one-dimensional array of numbers of length `size` (any length for None).

    **Raises** `ValueError` naming the argument.
    """
    column = np.array(values)
    if column.ndim != 1 or (size is not None and len(column) != size):
        wanted = "one-dimensional" if size is None else f"of shape ({size},)"
        raise ValueError(f"Argument `{name}` must be {wanted}, but has shape {column.shape}.")
    if column.dtype.kind not in "iuf":
        raise ValueError(f"Argument `{name}` must hold numbers, but holds {column.dtype}.")
    return column.astype(np.int64) if column.dtype.kind in "iu" else column.astype(np.float64)


def check_arguments(
    with_driven: bool, with_error: bool, units: tuple[str, str], error_unit: str
) -> None:
    """Raise `ValueError` unless exactly one of both is given, in units there are."""
    if with_driven == with_error:
        seen = "both are" if with_driven else "neither is"
        raise ValueError(
            f"Argument `driven` must be given, or `transmission_error` instead, but {seen} given."
        )
    for unit in units:
        if unit not in ("counts", *ANGLE_UNITS):
            raise ValueError(
                f"Argument `unit` must be counts, {', '.join(ANGLE_UNITS)}, but is {unit!r}."
            )
    if error_unit not in ANGLE_UNITS:
        raise ValueError(
            f"Argument `transmission_error_unit` must be one of {', '.join(ANGLE_UNITS)}, but is"
            f" {error_unit!r}."
        )


def check_finite(raw: "RawLog") -> None:
    """Raise `LogError` at the first NaN or infinity of any column."""
    columns: dict[str, Any] = {
        "time": raw.time,
        "driving": raw.driving.values,
        "driven": None if raw.driven is None else raw.driven.values,
        "transmission_error": raw.error,
        "direction": raw.direction,
        "axial_mm": raw.axial_mm,
        "torque": raw.torque,
    }
    for role, column in columns.items():
        if column is None:
            continue
        finite = np.isfinite(column)
        if not finite.all():
            row = int(np.argmin(finite))
            raise LogError(
                f"{column[row]} is no measured value; remove the line or repair the reading.",
                where=raw.source.at(role, row),
            )


def check_time(time: Float[np.ndarray, " n"], source: Source) -> list[str]:
    """Raise `LogError` for too few samples or time running backwards; note repeated stamps."""
    if len(time) < FEWEST_SAMPLES:
        raise LogError(
            f"only {len(time)} samples; a log needs at least {FEWEST_SAMPLES}.",
            where=source.at("time"),
        )
    interval = np.diff(time)
    if np.any(interval < 0):
        row = int(np.argmax(interval < 0)) + 1
        raise LogError(
            f"time runs backwards, from {time[row - 1]:.9g} s to {time[row]:.9g} s; sort the log"
            " or cut it there.",
            where=source.at("time", row),
        )
    same = int(np.count_nonzero(interval == 0))
    if 2 * same > len(interval):
        raise LogError(
            f"{same} of {len(interval)} time steps are zero; write the time with more digits or"
            " give --sample-rate.",
            where=source.at("time"),
        )
    notes = [f"time: {same} stamps repeat the one before"] if same else []
    long = interval > PAUSE * np.median(interval)
    if long.any():
        count = int(long.sum())
        pauses = "pause" if count == 1 else "pauses"
        notes.append(f"time: {count} {pauses}, the longest of {interval.max():.4g} s")
    return notes


def check_direction(direction: Real[np.ndarray, " n"], source: Source) -> Int8[np.ndarray, " n"]:
    """The direction column as int8; `LogError` for anything but +1, 0 and −1."""
    odd = ~np.isin(direction, (-1, 0, 1))
    if odd.any():
        row = int(np.argmax(odd))
        raise LogError(
            f"{direction[row]:g} is no direction; write +1, 0 or -1.",
            where=source.at("direction", row),
        )
    return direction.astype(np.int8)
