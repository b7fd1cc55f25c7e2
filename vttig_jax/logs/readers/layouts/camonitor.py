"""Output of EPICS `camonitor`: one line for each change of a channel, channels in any order.

A line contains the name in 30 characters, date and time, and the value, followed by status and
severity if they are not normal. Lines with `***` mean that a channel is disconnected.
"""

import re
from collections.abc import Sequence

from ....base.errors import LogError
from ..table import Table
from .channels import SPARE, Channel, table_of

_LINE = re.compile(r"(\S+)\s+(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d(?:\.\d+)?)\s+(\S+)(?:\s+(.*))?")
_STOP = "***"
INVALID = "INVALID"
"""Severity of a value that the channel itself marks as wrong."""


def matches(lines: Sequence[str]) -> bool:
    """Return whether all of the first non-empty lines are changes or disconnections of channels."""
    content = [line for line in lines[:SPARE] if line.strip()]
    found = [line for line in content if _LINE.fullmatch(line.strip()) or _STOP in line]
    return len(found) == len(content) and any(_LINE.fullmatch(line.strip()) for line in content)


def read(lines: list[str], source: str) -> tuple[Table, tuple[str, ...]]:
    """Return the channels with their stamps, and notes.

    **Raises** `LogError` for a line of another form; an incomplete last line is left out.
    """
    channels: dict[str, Channel] = {}
    lost = invalid = 0
    notes = ["EPICS camonitor: only changes are logged, between which a channel keeps its value"]
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text:
            continue
        if _STOP in text:
            lost += 1
            continue
        match = _LINE.fullmatch(text)
        if match is None:
            if not any(rest.strip() for rest in lines[number:]):
                notes.append(f"the last line ({number}) is cut off and left out")
                continue
            raise LogError(
                "this line is none of `camonitor` (name, date, time, value); remove it.",
                where=f"{source}: line {number}",
            )
        name, stamp, value, state = match.groups()
        if INVALID in (state or "") and "UDF" not in (state or ""):
            invalid += 1
            continue
        channels.setdefault(name, Channel()).add(stamp, value, number)
    if lost:
        notes.append(f"channels were disconnected {lost} times; values are held across the gaps")
    if invalid:
        notes.append(f"{invalid} values with severity INVALID are left out")
    return table_of(channels, source, held=True), tuple(notes)
