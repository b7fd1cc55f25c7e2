"""Units of numeric time stamps that count from an epoch, recognised from their magnitude."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Real

FIRST_S, LAST_S = 978_307_200, 4_102_444_800
"""Seconds from 1970 to 2001 and to 2100; every log was recorded between these years (chosen)."""

FILETIME_OFFSET = 11_644_473_600
"""Seconds from 1601, the epoch of FILETIME, to 1970."""

FILETIME = "100ns"
"""Unit of FILETIME stamps: 100 nanoseconds since 1601."""


@dataclass(frozen=True)
class Epoch:
    """Unit of stamps, its length in ns, and the epoch from which the stamps count.

    `since` is a text for notes; `offset_s` are the seconds from the epoch to 1970.
    """

    unit: str
    nanoseconds: int
    since: str
    offset_s: int = 0

    def holds(self, low: int | float, high: int | float) -> bool:
        """Return whether all stamps from `low` to `high` lie between 2001 and 2100."""
        scale = 1_000_000_000 // self.nanoseconds
        first, last = FIRST_S + self.offset_s, LAST_S + self.offset_s
        return first * scale <= low <= high <= last * scale


EPOCHS = (
    Epoch("s", 1_000_000_000, "seconds since 1970"),
    Epoch("ms", 1_000_000, "milliseconds since 1970"),
    Epoch("us", 1_000, "microseconds since 1970"),
    Epoch("ns", 1, "nanoseconds since 1970"),
    Epoch(FILETIME, 100, "100 ns since 1601 (FILETIME)", FILETIME_OFFSET),
)
"""Units that are recognised; their number ranges for 2001 to 2100 do not overlap."""


def epoch_unit(stamps: Real[np.ndarray, " n"]) -> Epoch | None:
    """Return the epoch with which all stamps lie between 2001 and 2100, or None."""
    low, high = stamps.min().item(), stamps.max().item()
    return next((epoch for epoch in EPOCHS if epoch.holds(low, high)), None)
