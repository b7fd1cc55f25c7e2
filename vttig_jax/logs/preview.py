"""Preview of a log without a pair file: columns, units from their names, rate, turns and ratio."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Real

from ..base.errors import LogError
from ..base.files.text_tables import key_values
from ..base.files.toml_io import plain_table
from ..base.shown_text import shown_name
from ..base.units import ANGLE_UNITS, ARCSEC, REV
from ..pair.schema import PairSpec, as_ratio
from .channel.steps import step_of
from .channel.unwrap import find_modulus, unwrap, wrap_steps
from .checks.fractions import likely_fraction, ratio_option
from .checks.missing_cells import missing_notes
from .checks.sampling import Sampling, sampling_of
from .checks.slope import slope
from .inspection import ColumnReport, bullets, column_table, sampling_rows
from .magnitudes import LEAST_RANGE, check_time
from .proposals import Proposal, proposals, with_ratio
from .read import check_arguments
from .readers.column_names import (
    ROW,
    TIME_UNITS,
    listed,
    name_and_unit,
    units_of,
)
from .readers.column_roles import ROLES, ROW_INDEX
from .readers.delimited import TextTable
from .readers.nested import NestedTable
from .readers.open_table import open_table
from .readers.times.seconds import seconds_of_numbers, seconds_of_stamps
from .recognition.command import fit_command
from .recognition.recognise import Search
from .recognition.request import DriveRequest, in_words
from .source import Source

SHAFTS = ("driving", "driven", "transmission_error")
"""Roles whose column defines the length of the record; the first role with a column is used."""

MOST_COLUMNS = 30
"""A table of more columns than this shows the columns of one matrix in one row (chosen)."""

MOST_PROPOSED = 4
"""Largest number of proposed commands in the text of a preview (chosen)."""

_NO_RATIO = (
    "this log shows no ratio: with --ratio A:B (driving turns to driven turns), `vttig inspect`"
    " prints the command for a fit"
)
_ANSWER = (
    "the command for a fit is printed here once options of `vttig inspect` answer these questions"
)


@dataclass(frozen=True)
class Preview:
    """Properties of a log that is read without a pair file.

    The record consists of the arrays of equal length that belong together; `rows` is this length
    and `columns` describes them. `ratio` is the ratio in the log with its standard error.
    """

    source: str
    sha256: str
    rows: int
    columns: tuple[ColumnReport, ...]
    sampling: Sampling | None
    ratio: tuple[float, float] | None
    notes: tuple[str, ...]
    others: tuple[tuple[str, int], ...] = ()
    """Names and lengths of the arrays whose length differs from that of the record."""
    fit_command: str = ""
    """Command that fits the log with the ratio estimated from it; "" if information is missing."""
    proposals: tuple[Proposal, ...] = ()
    """Commands of which one fits the log, if only the user knows which column is which shaft."""

    def to_json(self) -> dict[str, Any]:
        """Return the report in the schema `vttig.inspect/1` without parts that need a pair file."""
        ratio, std = self.ratio or (None, None)
        others = [{"name": name, "values": length} for name, length in self.others]
        return {
            "schema": "vttig.inspect/1",
            "source": self.source,
            "sha256": self.sha256,
            "samples": {"read": self.rows},
            "columns": [asdict(column) for column in self.columns],
            **({"other_arrays": others} if others else {}),
            "sampling": None if self.sampling is None else asdict(self.sampling),
            "ratio": {"given": None, "seen": ratio, "std": std},
            **({"fit_command": self.fit_command} if self.fit_command else {}),
            **({"proposals": [asdict(one) for one in self.proposals]} if self.proposals else {}),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        rows: list[tuple[str, str]] = [("samples", str(self.rows))]
        if self.sampling is not None:
            rows = sampling_rows(self.sampling, self.rows)
        if self.ratio is not None:
            ratio, std = self.ratio
            near = likely_fraction(abs(ratio), std)
            whole = "" if near is None else f" ({near if ratio > 0 else -near})"
            rows.append(("ratio seen", f"{ratio:.6g} ± {std:.1g}, driven over driving{whole}"))
        parts = [shown_name(self.source), column_table(_grouped(self.columns)), key_values(rows)]
        parts.append(bullets("note", (*_other_arrays(self.others, self.rows), *self.notes)))
        if self.fit_command and self.ratio is not None:
            turns = in_words(as_ratio(ratio_option(abs(self.ratio[0]), self.ratio[1]), ""))
            parts.append(f"if {turns}:\n  {self.fit_command}")
        parts += _proposed(self.proposals)
        return "\n\n".join(part for part in parts if part)


def preview_log(
    path: str | Path,
    *,
    spec: PairSpec | None = None,
    request: DriveRequest = DriveRequest(),
    columns: Mapping[str, str] | None = None,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> Preview:
    """Return a preview of a log; `columns`, `decimal` and `sample_rate_hz` are as in `read_log`.

    `spec` is a pair file that names columns and units. Without it they are recognised from the
    column names, and the notes ask for information that neither the names nor `request` give.

    Text without a header has the columns #1, #2, …. The record of a nested file consists of the
    arrays as long as the driving array, or else of the arrays with the most frequent length.

    **Raises** `LogError` for files without a table, and for names that do not exist.
    """
    columns = columns or {}
    check_arguments(columns, decimal, sample_rate_hz)
    table, digest, notes = open_table(
        path, decimal=decimal, requested=columns.values(), headerless=True
    )
    table, cut = table.complete_rows(range(len(table.names)))
    search = Search(table, str(path), request, _named(spec, columns))
    search.take_stated(timed=sample_rate_hz is None)
    questions = search.questions(timed=sample_rate_hz is None)
    roles = {ROW_INDEX if k is None else k: role for role, k in search.roles.items()}
    units = dict(search.units) if spec is None else plain_table(spec.unit)
    arrays, broken = _readable(table, roles)
    size = _size(arrays, roles)
    others = [(table.names[k], len(a)) for k, a in arrays.items() if len(a) != size]
    names = dict(enumerate(table.names)) | {ROW_INDEX: ROW}
    rows = {ROW_INDEX: np.arange(size)} if ROW_INDEX in roles else {}
    arrays = {k: a for k, a in (arrays | rows).items() if len(a) == size}
    source = Source(str(path), {r: names[k] for k, r in roles.items()}, table.line_of)
    shown = [_report(names[k], roles.get(k), a, units, request) for k, a in arrays.items()]
    reports = [report for report, _ in shown]
    angles = {r.role: angle for r, angle in shown if angle is not None and r.role is not None}
    hints = [*notes, *cut, *broken, *missing_notes(table, arrays)]
    hints += _unusable_roles(roles, arrays, dict(others), source, size)
    time = _time(reports, arrays, size, sample_rate_hz)
    hints += [] if time is None else check_time(time, source)
    ratio = _ratio(reports, angles)
    command, proposed = "", ()
    keywords = {"decimal": decimal, "sample_rate_hz": sample_rate_hz}
    if spec is None:
        hints += map(str, search.guesses)
        hints += _missing_input(reports)
        hints += [f"a fit asks: {question.message}" for question in questions]
        if not questions and ratio is not None and ratio[0] != 0:
            shown = with_ratio(request, ratio)
            command = fit_command(path, shown, search.column_names, **keywords)
        elif questions and not request.names_a_drive:
            proposed = proposals(search, path, **keywords)
        if not command and not proposed:
            hints.append(_ANSWER if questions else _NO_RATIO)
    return Preview(
        source=str(path),
        sha256=digest,
        rows=size,
        columns=tuple(reports),
        sampling=None if time is None else sampling_of(time),
        ratio=ratio,
        notes=tuple(hints),
        others=tuple(others),
        fit_command=command,
        proposals=proposed,
    )


def _proposed(found: Sequence[Proposal]) -> list[str]:
    """Return the commands of which one fits the log, each below its condition."""
    if not found:
        return []
    parts = ["to fit it, copy the command whose sentence is true:"]
    parts += [f"if {one.condition}:\n  {one.command}" for one in found[:MOST_PROPOSED]]
    if len(found) > MOST_PROPOSED:
        parts.append(f"{len(found) - MOST_PROPOSED} more are in the output of --json")
    return parts


def _ratio(
    reports: Sequence[ColumnReport], angles: Mapping[str, np.ndarray]
) -> tuple[float, float] | None:
    """Return the slope of driven over driving angle and its standard error, or None."""
    counts = {r.turns is None for r in reports if r.role in ("driving", "driven")}
    if not {"driving", "driven"} <= set(angles) or len(counts) != 1:
        return None
    return slope(angles["driving"], angles["driven"])


def _named(spec: PairSpec | None, columns: Mapping[str, str]) -> dict[str, str]:
    """Return role → column name from a pair file and from the options, which have priority."""
    stated = {} if spec is None else {role: getattr(spec.log, role) for role in ROLES}
    return {role: name for role, name in stated.items() if name is not None} | dict(columns)


def _readable(
    table: TextTable | NestedTable, roles: Mapping[int, str]
) -> tuple[dict[int, np.ndarray], list[str]]:
    """Return index → values of all numeric columns, and notes on the columns that are not read.

    A time column of dates is converted to seconds.
    """
    dated = [k for k in range(len(table.names)) if table.is_dated(k)]
    indices = [k for k in range(len(table.names)) if k not in dated]
    arrays, errors = {}, {}
    for k in dated:
        if roles.get(k) == "time" and isinstance(table, TextTable):
            where = f"{table.source}: column `{table.names[k]}`"
            arrays[k] = seconds_of_stamps(table.texts(k), where)[0]
    try:
        return arrays | dict(zip(indices, table.columns(indices), strict=True)), []
    except LogError:
        pass
    for k in indices:
        try:
            arrays[k] = table.columns([k])[0]
        except LogError as error:
            errors[k] = error
    if not arrays:
        raise next(iter(errors.values()))
    notes = [
        f"column `{table.names[k]}` is not read: {error.message}" for k, error in errors.items()
    ]
    return arrays, notes


def _size(arrays: Mapping[int, np.ndarray], roles: Mapping[int, str]) -> int:
    """Return the length of the record: that of the first column in `SHAFTS` that is available.

    Without such a column it is the most frequent length.
    """
    lengths = {role: len(arrays[k]) for k, role in roles.items() if k in arrays}
    for role in SHAFTS:
        if role in lengths:
            return lengths[role]
    return Counter(map(len, arrays.values())).most_common(1)[0][0]


def _unusable_roles(
    roles: Mapping[int, str],
    arrays: Mapping[int, np.ndarray],
    others: Collection[str],
    source: Source,
    size: int,
) -> list[str]:
    return [
        f"column `{source.columns[role]}` cannot be the {role} of this record of {size} samples:"
        f" it {'differs in length' if source.columns[role] in others else 'is not read'}"
        for k, role in roles.items()
        if k not in arrays
    ]


def _grouped(columns: Sequence[ColumnReport]) -> list[ColumnReport]:
    """Return the columns; if there are many, join the columns of one matrix that have no role."""
    if len(columns) <= MOST_COLUMNS:
        return list(columns)
    shown = []
    for (role, _), group in groupby(columns, lambda c: (c.role, _matrix(c.name))):
        members = list(group)
        if role is not None or len(members) == 1 or len({c.unit for c in members}) > 1:
            shown += members
            continue
        low, high = min(c.low for c in members), max(c.high for c in members)
        name = listed([c.name for c in members])
        shown.append(ColumnReport(None, name, members[0].unit, low, high))
    return shown


def _matrix(name: str) -> str:
    """Return `x` for `x(3,:)` and `x(:,3)`, and any other name unchanged."""
    matrix, bracket, index = name.rpartition("(")
    return matrix if bracket and (index.endswith(",:)") or index.startswith(":,")) else name


def _other_arrays(others: Sequence[tuple[str, int]], size: int) -> list[str]:
    """Return notes on arrays (name, length) outside the record of length `size`, by length."""
    lengths = sorted({length for _, length in others}, reverse=True)
    return [
        f"arrays of {length} values are no part of this record of {size}: "
        + listed([name for name, values in others if values == length])
        for length in lengths
    ]


def _report(
    name: str,
    role: str | None,
    values: Real[np.ndarray, " n"],
    stated: Mapping[str, str],
    request: DriveRequest,
) -> tuple[ColumnReport, Real[np.ndarray, " n"] | None]:
    """Return a row of the column table, and the unwrapped readings if the column is a shaft.

    The readings are in rad, or in counts if `request` does not state the counts per revolution.
    `stated` is role → unit for a name without a unit.
    """
    counts = request.counts
    per_turn = counts[SHAFTS.index(role)] if counts and role in ("driving", "driven") else None
    units = units_of(role) if role else (*units_of("driving"), *TIME_UNITS)
    unit = name_and_unit(name, units, name)[1] or stated.get(role or "")
    plain = ColumnReport(role, name, unit, float(values.min()), float(values.max()))
    shaft = role in ("driving", "driven") or (role is None and unit in ("counts", *ANGLE_UNITS))
    if not shaft or unit is None or not np.isfinite(values).all() or np.ptp(values) < LEAST_RANGE:
        return plain, None
    if unit == "counts" and np.all(values == np.rint(values)):
        values = values.astype(np.int64)
    radians = ANGLE_UNITS.get(unit)
    if unit == "counts" and per_turn is not None:
        radians = REV / per_turn
    modulus = find_modulus(values, None if radians is None else per_turn or REV / radians)
    wraps = 0
    if modulus is not None:
        wraps = int(np.count_nonzero(wrap_steps(values, modulus)))
        values = unwrap(values, modulus)
    if radians is None:
        report = ColumnReport(
            role=role,
            name=name,
            unit=unit,
            low=plain.low,
            high=plain.high,
            resolution_arcsec=None,
            turns=None,
            modulus=modulus,
            wraps=wraps,
        )
        return report, values.astype(np.float64)
    report = ColumnReport(
        role=role,
        name=name,
        unit=unit,
        low=plain.low,
        high=plain.high,
        resolution_arcsec=step_of(values) * radians / ARCSEC or None,
        turns=float(np.ptp(values)) * radians / REV,
        modulus=modulus,
        wraps=wraps,
    )
    return report, values * radians


def _time(
    reports: Sequence[ColumnReport],
    arrays: Mapping[int, np.ndarray],
    size: int,
    sample_rate_hz: int | float | None,
) -> np.ndarray | None:
    if sample_rate_hz is not None:
        return np.arange(size) / sample_rate_hz
    for report, values in zip(reports, arrays.values(), strict=True):
        if report.role == "time":
            return seconds_of_numbers(values, report.unit or "s")
    return None


def _missing_input(reports: Sequence[ColumnReport]) -> list[str]:
    """Return notes on what a preview cannot say."""
    hints = []
    if any(r.turns is None and r.unit == "counts" for r in reports if r.role in SHAFTS[:2]):
        hints.append("turns need counts_per_rev: give --counts; the ratio takes counts as equal")
    hints.append(
        "this is a first look; --ratio A:B (or --pair PAIR.toml) adds flanks, speeds and the orders"
    )
    return hints
