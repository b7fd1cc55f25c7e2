"""Text layouts that are recognised, in the order in which they are tested."""

from ..text import Lines
from .cells import Found
from .groups import LABVIEW, OSCILLOSCOPE, TWINCAT
from .halsampler import HALSAMPLER
from .phd2 import PHD2
from .records import BRACKETS, JSON, PAIRS, SIDE
from .samples import CAMONITOR, CANTOOLS, LONG_TABLE
from .sections import SECTIONS

LAYOUTS = (
    *(JSON, TWINCAT, LABVIEW, OSCILLOSCOPE, CANTOOLS, CAMONITOR, HALSAMPLER, PHD2),
    *(LONG_TABLE, SIDE, PAIRS, BRACKETS, SECTIONS),
)
"""Layouts other than a table with one row for each instant."""


def read_layout(text: str, source: str) -> Found | None:
    """Return the table and notes of a text in one of the layouts, or None for another text.

    **Raises** `LogError` for a text that is damaged in its layout.
    """
    lines = Lines(text)
    layout = next((one for one in LAYOUTS if one.matches(lines)), None)
    return None if layout is None else layout.read(list(lines), source)
