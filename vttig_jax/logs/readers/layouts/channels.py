"""Table of channels with separate time stamps, which are collected line by line."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ....base.errors import LogError
from ..table import Table
from ..text import Lines
from ..times.seconds import exact_numbers
from ..times.stamps import looks_like_stamp, read_stamps

SPARE = 16
"""Number of first lines of a text in which a layout is recognised (chosen)."""


@dataclass
class Channel:
    """Stamps and values of one channel as text, and the line number of each sample."""

    stamps: list[str] = field(default_factory=list)
    values: list[str] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)

    def add(self, stamp: str, value: str, line: int) -> None:
        """Append one sample."""
        self.stamps.append(stamp)
        self.values.append(value)
        self.lines.append(line)


@dataclass(frozen=True)
class Layout:
    """A text layout of a recording program.

    **Arguments**
    - `name`: name of the layout in notes.
    - `matches`: function that returns whether lines have this layout.
    - `read`: function of all lines and the file name that returns the table and its notes.
    """

    name: str
    matches: Callable[[Lines], bool]
    read: Callable[[list[str], str], tuple[Table, tuple[str, ...]]]


def table_of(channels: Mapping[str, Channel], source: str, *, held: bool) -> Table:
    """Return a table of the numeric channels with their stamps in s since the earliest stamp.

    `held` is true if only changes are logged.

    **Raises** `LogError` for a file without numbers and for stamps that cannot be read.
    """
    numeric = {name: channel for name, channel in channels.items() if _is_numeric(channel)}
    if not numeric:
        raise LogError("no channel of this file holds numbers; export the log again.", where=source)
    seconds = _seconds(numeric, source)
    names: list[str] = []
    arrays: list[np.ndarray] = []
    clocks = {}
    for number, (name, channel) in enumerate(numeric.items(), 1):
        clocks[len(names)] = len(names) + 1
        names += [name, f"time {number} [s]"]
        arrays += [_numbers(channel, name, source), seconds[name]]
    return Table(
        names=tuple(names),
        arrays=tuple(arrays),
        source=source,
        clocks=clocks,
        held=frozenset(clocks) if held else frozenset(),
    )


def _is_numeric(channel: Channel) -> bool:
    return len(channel.values) > 1 and _number(channel.values[-1]) is not None


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _numbers(channel: Channel, name: str, source: str) -> np.ndarray:
    """Return the values of a channel: as int64 if all are whole numbers, else as float64."""
    try:
        if all(value.lstrip("+-").isdigit() for value in channel.values):
            return np.array([int(value) for value in channel.values], np.int64)
        return np.array([float(value) for value in channel.values])
    except (ValueError, OverflowError):
        wrong = next(k for k, value in enumerate(channel.values) if _number(value) is None)
        raise LogError(
            f"`{channel.values[wrong]}` is no number; correct it or remove the line.",
            where=f"{source}: line {channel.lines[wrong]}, channel `{name}`",
        ) from None


def _seconds(channels: Mapping[str, Channel], source: str) -> dict[str, np.ndarray]:
    """Return channel → stamps in s since the earliest stamp, subtracted as integers."""
    stamps = [stamp for channel in channels.values() for stamp in channel.stamps]
    if looks_like_stamp(stamps[0]):
        seconds = read_stamps(stamps, source)[0] / 1e9
    else:
        exact = exact_numbers(stamps)
        if exact is None:
            raise LogError("the time stamps are no numbers; export the log again.", where=source)
        seconds = exact
    seconds = seconds - seconds.min()
    ends = np.cumsum([len(channel.stamps) for channel in channels.values()])
    return dict(zip(channels, np.split(seconds, ends[:-1]), strict=True))
