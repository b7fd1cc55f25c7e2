"""Output of `candump | cantools decode`, with one line or several lines for each message."""

import re
from collections.abc import Iterator, Sequence

from ....base.errors import LogError
from ..table import Table
from .channels import SPARE, Channel, table_of

_FRAME = re.compile(
    r"\((?P<stamp>[\d.: -]+)\)\s+\S+\s+[0-9A-Fa-f]+\s+\[\d+\]\s+(?:[0-9A-Fa-f]{2}\s+)*::"
    r"(?P<rest>.*)"
)
_MESSAGE = re.compile(r"\s*(?P<name>[^\s(]+)\((?P<signals>.*)\)\s*")
_SIGNAL = re.compile(r"\s*(?P<name>[^\s:,]+):\s*(?P<value>[^\s,]+)(?:\s+(?P<unit>[^,]+?))?\s*")


def matches(lines: Sequence[str]) -> bool:
    """Return whether one of the first lines is a decoded frame."""
    return any(_FRAME.fullmatch(line.strip()) for line in lines[:SPARE])


def read(lines: list[str], source: str) -> tuple[Table, tuple[str, ...]]:
    """Return a table of signals with names `Message.Signal [unit]` and their stamps, and notes.

    **Raises** `LogError` if no frame could be decoded; an incomplete last message is left out.
    """
    channels: dict[str, Channel] = {}
    undecoded = cut = 0
    for number, stamp, rest in _messages(lines):
        message = _MESSAGE.fullmatch(rest)
        if message is None:
            cut += number > len(lines) - SPARE and "(" in rest
            undecoded += 1
            continue
        for part in message["signals"].split(","):
            signal = _SIGNAL.fullmatch(part)
            if signal is None:
                continue
            unit = f" [{signal['unit']}]" if signal["unit"] else ""
            name = f"{message['name']}.{signal['name']}{unit}"
            channels.setdefault(name, Channel()).add(stamp, signal["value"], number)
    if not channels:
        raise LogError("no frame of this file is decoded; give cantools the DBC.", where=source)
    notes = ["cantools decode: every message has its own time stamps"]
    if cut:
        notes.append("the last message is cut off and left out")
    if undecoded - cut:
        notes.append(f"{undecoded - cut} frames without decoded signals are left out")
    return table_of(channels, source, held=False), tuple(notes)


def _messages(lines: Sequence[str]) -> Iterator[tuple[int, str, str]]:
    """Yield line number, stamp, and the text `Message(signals)` joined to one line."""
    number, stamp, parts = 0, "", []
    for k, line in enumerate(lines, 1):
        frame = _FRAME.fullmatch(line.strip())
        if frame is None:
            parts.append(line.strip())
            continue
        if stamp:
            yield number, stamp, " ".join(parts)
        number, stamp, parts = k, frame["stamp"].strip(), [frame["rest"].strip()]
    if stamp:
        yield number, stamp, " ".join(parts)
