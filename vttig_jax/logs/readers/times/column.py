"""Conversion of the time column of a log, written dates or numbers, to seconds."""

import numpy as np
from jaxtyping import Float, Real

from ..column_names import TIME_UNITS, name_and_unit
from ..column_roles import Column
from ..delimited import TextTable
from ..nested import NestedTable
from .seconds import check_days, exact_numbers, seconds_of_numbers, seconds_of_stamps

FAR = 1e6
"""Stamps in text beyond this number are subtracted as whole numbers to keep all digits (chosen:
float64 represents 1e6 s with a step of 0.1 ns)."""


def column_seconds(
    table: TextTable | NestedTable,
    column: Column,
    values: Real[np.ndarray, " n"] | None,
    where: str,
    *,
    stated: bool,
) -> tuple[Float[np.ndarray, " n"], tuple[str, ...]]:
    """Return the time in s, and notes on its start and unit.

    **Arguments**
    - `values`: numbers of the column; None for written dates or times of day.
    - `where`: file and column for messages. - `stated`: whether the unit was stated.

    **Raises** `LogError` for stamps that cannot be read or that do not resolve the sampling.
    """
    if values is None:
        assert isinstance(table, TextTable)  # only text holds written stamps
        seconds, note = seconds_of_stamps(table.texts(column.index), where)
        return seconds, (note,)
    notes = ()
    if not stated and name_and_unit(column.name, tuple(TIME_UNITS), where)[1] is None:
        notes = (f"time: column `{column.name}` names no unit, taken as seconds",)
    far = values.dtype.kind == "f" and len(values) > 0 and abs(values[0]) > FAR
    if isinstance(table, TextTable) and (far or column.unit == "d"):
        fields = table.texts(column.index)
        exact = exact_numbers(fields)
        if exact is not None:
            seconds = exact * TIME_UNITS[column.unit]
            if column.unit == "d":
                check_days(fields, seconds, where)
            return seconds, notes
    return seconds_of_numbers(values, column.unit), notes
