"""Text layouts that are recognised, in the order in which they are tested."""

from ..table import Table
from ..text import Lines
from . import camonitor, cantools, halsampler, long_table, lvm, phd2, sections, twincat
from .channels import Layout

LAYOUTS = (
    Layout("TwinCAT Scope", twincat.matches, twincat.read),
    Layout("LabVIEW measurement", lvm.matches, lvm.read),
    Layout("cantools decode", cantools.matches, cantools.read),
    Layout("EPICS camonitor", camonitor.matches, camonitor.read),
    Layout("LinuxCNC halsampler", halsampler.matches, halsampler.read),
    Layout("PHD2 guide log", phd2.matches, phd2.read),
    Layout("long table", long_table.matches, long_table.read),
    Layout("file in sections", sections.matches, sections.read),
)
"""Layouts other than a table with one row for each instant."""


def read_layout(text: str, source: str) -> tuple[Table, tuple[str, ...]] | None:
    """Return the table and notes of a text in one of the layouts, or None for another text.

    **Raises** `LogError` for a text that is damaged in its layout.
    """
    lines = Lines(text)
    layout = next((one for one in LAYOUTS if one.matches(lines)), None)
    return None if layout is None else layout.read(list(lines), source)
