"""Error tables in the formats of controls: LinuxCNC, TwinCAT and CSV; and how LinuxCNC reads one.

Numbers alone decide what a control does. Text that comes from a log or a pair file stands in
comments only, in plain characters, so that no name becomes code.
"""

import re
import unicodedata
from collections.abc import Iterable
from textwrap import wrap
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.errors import UsageError
from .correction import DIRECTIONS, CorrectionTable

LINUXCNC_ROWS = 256
"""Rows that LinuxCNC reads of a compensation file (EMCMOT_COMP_SIZE)."""

_LINE = 253
"""Longest line that LinuxCNC reads as one; what follows would be a line of its own."""

WIDTH = 88
"""Characters of a line of comments and arrays: a chosen value."""

_JOINED = "\x1f"
"""Placeholder for a space at which a line must not be broken."""

_NUMBER = r"(?>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?i:inf(?:inity)?|nan))"
_ROW = re.compile(rf"\s*({_NUMBER})\s*({_NUMBER})\s*({_NUMBER})")
_LIKE_A_ROW = re.compile(rf"\s*{_NUMBER}[\s,;]+{_NUMBER}")


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
        rows = rows_of(f"{value:.9f}" for value in np.degrees(values))
        text.append(f"  {prefix}_{key}_deg : ARRAY[0..{last}] OF LREAL := [\n{rows}\n  ];")
    return "\n".join([*text, "END_VAR"]) + "\n"


def csv(table: CorrectionTable) -> str:
    """Return a table with the columns position and correction of each direction, in degrees."""
    names = ["position_deg", *(f"{name}_correction_deg" for name in table.values)]
    rows = np.degrees(np.stack([table.positions, *table.values.values()], axis=1))
    return "\n".join([",".join(names), *(",".join(f"{v:.9f}" for v in row) for row in rows)]) + "\n"


FAULTS = {
    "comma": "has a comma: LinuxCNC ends its table there; separate numbers by blanks, and write"
    " decimals with a point",
    "blank-line": "is blank: LinuxCNC ends its table there; remove it",
    "long-line": f"is longer than {_LINE} characters: LinuxCNC ends its table behind it; cut it",
    "byte-order-mark": "begins with a byte order mark, which is no number: LinuxCNC ends its table"
    " there; save the file as UTF-8 without one",
    "carriage-return": "holds several lines that only a carriage return parts, of which LinuxCNC"
    " takes the first; save the file with the line ends of Unix",
    "no-numbers": "does not begin with three numbers: LinuxCNC ends its table there; move it behind"
    " the last row",
    "no-rows": "and all others do not begin with three numbers; give position, forward and reverse",
    "not-increasing": "is not above the position before it in single precision: LinuxCNC leaves it"
    " out; sort the rows and remove what is there twice",
    "not-finite": "has a number that is not finite; remove it",
    "too-many-rows": f"is beyond the {LINUXCNC_ROWS} rows that LinuxCNC takes; give a larger step",
    "type-unclear": "and all others have numbers that are neither small beside their position nor"
    " near it: with the wrong COMP_FILE_TYPE the axis moves by its whole position; write"
    " corrections, for COMP_FILE_TYPE = 1",
}
"""Slug → what LinuxCNC does with a line of a COMP_FILE without a word, and the cure."""


class CompFile(NamedTuple):
    """What LinuxCNC reads of a COMP_FILE.

    **Arguments**
    - `rows`: nominal, forward, reverse in the units of the file. - `type`: COMP_FILE_TYPE that its
      numbers need, 1 for corrections and 0 for positions; None if they do not tell.
    - `faults`: slug of `FAULTS` → lines, from 1.
    """

    rows: Float[np.ndarray, "rows 3"]
    type: int | None
    faults: dict[str, list[int]]

    @property
    def sentences(self) -> list[str]:
        """One sentence for each fault."""
        more = {
            slug: f" (and {len(at) - 1} more)" * (len(at) > 1) for slug, at in self.faults.items()
        }
        return [f"Line {at[0]}{more[s]} {FAULTS[s]}." for s, at in self.faults.items()]


def read_linuxcnc(text: str) -> CompFile:
    """Return what LinuxCNC reads of a COMP_FILE, and where that is not what stands there.

    It reads up to the first line that does not begin with three numbers, drops rows whose position
    is not above the one before, and takes 256 rows (`usrmotLoadComp` of its source). What stands
    behind the last row is no fault.

    **Example**
    ```python
    >>> from vttig_jax.control.compensation.table_formats import read_linuxcnc
    >>> found = read_linuxcnc("0 0.01 0.02\\n90 0.03 0.04\\n\\n180 0.01 0.02\\n")
    >>> len(found.rows), found.type, found.faults
    (2, 1, {'blank-line': [3]})

    ```
    """
    rows, faults, lines = [], {}, text.removesuffix("\n").split("\n")
    for number, line in enumerate(lines, 1):
        found = _ROW.match(line)
        if found is not None:
            row, slug = np.array(found.groups(), float), None
            if not np.isfinite(row).all():
                slug = "not-finite"
            elif rows and np.float32(row[0]) <= np.float32(rows[-1][0]):
                slug = "not-increasing"
            elif len(rows) == LINUXCNC_ROWS:
                slug = "too-many-rows"
            elif "\r" in line.rstrip():
                slug = "carriage-return"
            if slug in (None, "carriage-return"):
                rows.append(row)
            if slug is not None:
                faults.setdefault(slug, []).append(number)
        if found is None or len(line) > _LINE:
            if any(map(_LIKE_A_ROW.match, lines[number - (found is None) :])):
                seen = {
                    "long-line": found is not None,
                    "blank-line": not line.strip(),
                    "byte-order-mark": line.startswith("\ufeff"),
                    "comma": "," in line,
                    "no-numbers": True,
                }
                faults[next(slug for slug, is_so in seen.items() if is_so)] = [number]
            break
    held = np.array(rows, float).reshape(-1, 3)
    added, off = np.abs([held[:, 1:], held[:, 1:] - held[:, :1]]).sum(axis=(1, 2))
    kind = 1 if 2 * added < off else 0 if 2 * off < added else None
    if not faults and kind is None:
        faults["type-unclear" if rows else "no-rows"] = [1]
    return CompFile(held, kind, faults)


def rows_of(items: Iterable[str]) -> str:
    """Return the elements of an array on lines of limited width; no element is broken."""
    text = ", ".join(item.replace(" ", _JOINED) for item in items)
    lines = wrap(text, WIDTH, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines).replace(_JOINED, " ")


def plain(text: str) -> str:
    """Return text as one line of printable ASCII that neither opens nor ends a comment."""
    marked = text.replace("″", "arcsec").replace("°", " deg").replace("…", "to")
    folded = unicodedata.normalize("NFKD", " ".join(marked.split()))
    letters = "".join(letter for letter in folded if not unicodedata.combining(letter))
    kept = re.sub(r"[^ -~]", "_", letters).replace("*/", "*|").replace("/*", "|*")
    return kept.replace("*)", "*|")[: _LINE - 2]
