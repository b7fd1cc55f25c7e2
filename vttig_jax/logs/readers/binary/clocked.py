"""Table of the columns of formats whose channels may have separate time stamps."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Real

from ..table import Table
from ..text import printable


@dataclass(frozen=True, eq=False)
class ClockedColumn:
    """Channel with its values and time stamps in s; `time` is None without separate stamps."""

    name: str
    values: Real[np.ndarray, " n"]
    time: Float[np.ndarray, " n"] | None = None


def table_of(
    columns: Iterable[ClockedColumn],
    source: str,
    *,
    held: bool = False,
    start: float | None = None,
) -> Table:
    """Return the table of all columns; channels with equal stamps share one column of time.

    Stamps are counted from `start`, by default from the earliest first stamp of all channels.
    `held` says that only changes of the channels are logged.
    """
    found = list(columns)
    if start is None:
        starts = [one.time[0] for one in found if one.time is not None and len(one.time)]
        start = min(starts, default=0.0)
    names: list[str] = []
    arrays: list[np.ndarray] = []
    clocks: dict[int, int] = {}
    stamps: list[int] = []
    for one in found:
        if one.time is not None:
            time = one.time - start
            clock = next((k for k in stamps if np.array_equal(arrays[k], time)), None)
            if clock is None:
                clock = len(names)
                stamps.append(clock)
                names.append(f"time {len(stamps)} [s]")
                arrays.append(time)
            clocks[len(names)] = clock
        names.append(printable(one.name))
        arrays.append(one.values)
    return Table(
        tuple(names),
        tuple(arrays),
        source,
        clocks=clocks,
        held=frozenset(clocks) if held else frozenset(),
    )
