"""Error tables in the formats of controls: LinuxCNC, TwinCAT, CSV and JSON.

Numbers alone decide what a control does. Text that comes from a log or a pair file stands in
comments only, in plain characters, so that no name becomes code.
"""

import re

import numpy as np

from ...base.errors import UsageError
from .correction import DIRECTIONS, CorrectionTable

LINUXCNC_ROWS = 256
"""Rows that LinuxCNC reads of a compensation file (EMCMOT_COMP_SIZE)."""

_LINE = 240
"""Longest line of a comment: LinuxCNC reads lines of up to 255 characters."""


def linuxcnc(table: CorrectionTable, provenance: tuple[str, ...]) -> str:
    """Return a COMP_FILE of LinuxCNC for COMP_FILE_TYPE = 1: nominal, forward, reverse, degrees.

    Both values are added to the command. LinuxCNC interpolates between the rows in single precision
    and holds the values of the ends. A comment in front of the last row would empty the table, so
    that `provenance` follows it. A direction without a correction has that of the other one.

    **Raises** `UsageError` for more than 256 rows, or rows that do not increase in single
    precision.
    """
    nominal = np.degrees(table.positions)
    if len(nominal) > LINUXCNC_ROWS:
        raise UsageError(
            f"a table of LinuxCNC has at most {LINUXCNC_ROWS} rows, and this one has"
            f" {len(nominal)}; give a larger --step-deg or a shorter travel."
        )
    if np.any(np.diff(nominal.astype(np.float32)) <= 0) or np.any(np.diff(nominal) < 1e-6):
        raise UsageError(
            "the positions do not increase in the single precision of LinuxCNC, or by less than"
            " 1e-6°; give a larger --step-deg."
        )
    columns = [table.values.get(name, next(iter(table.values.values()))) for name in DIRECTIONS]
    rows = zip(nominal, *np.degrees(columns), strict=True)
    text = [f"{place:.7f} {forward:.9f} {reverse:.9f}" for place, forward, reverse in rows]
    return "\n".join([*text, *(f"; {plain(line)}" for line in provenance)]) + "\n"


def twincat(table: CorrectionTable, provenance: tuple[str, ...], name: str) -> str:
    """Return a list of global constants in Structured Text, in degrees.

    The values are added to the command. Positions are equidistant, as
    `MC_TableBasedPositionCompensation` of Tc2_MC2 asks.
    """
    last, prefix = len(table.positions) - 1, "axis_" + re.sub(r"\W+", "_", name, flags=re.ASCII)
    arrays = {"positions": table.positions, **table.values}
    text = ["{attribute 'qualified_only'}", "VAR_GLOBAL CONSTANT"]
    text += [f"  // {plain(line)}" for line in provenance]
    text += [f"  {prefix}_last : UDINT := {last};"]
    for key, values in arrays.items():
        text.append(f"  {prefix}_{key}_deg : ARRAY[0..{last}] OF LREAL := [")
        shown = [f"{value:.9f}" for value in np.degrees(values)]
        text += [f"    {', '.join(shown[k : k + 8])}," for k in range(0, len(shown), 8)]
        text[-1] = text[-1].removesuffix(",")
        text.append("  ];")
    return "\n".join([*text, "END_VAR"]) + "\n"


def csv(table: CorrectionTable) -> str:
    """Return a table with the columns position and correction of each direction, in degrees."""
    names = ["position_deg", *(f"{name}_correction_deg" for name in table.values)]
    rows = np.degrees(np.stack([table.positions, *table.values.values()], axis=1))
    return "\n".join([",".join(names), *(",".join(f"{v:.9f}" for v in row) for row in rows)]) + "\n"


def plain(text: str) -> str:
    """Return text in printable ASCII without characters that end a comment, cut to one line."""
    kept = text.replace("*)", ")").replace("″", "arcsec").replace("°", " deg").replace("…", "to")
    return "".join(c if " " <= c <= "~" else "?" for c in kept)[:_LINE]
