"""Preview of a log without a pair file: columns, rate, turns, ratio, and commands to fit it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from textwrap import fill
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Real

from ..base.errors import LogError, UsageError, VttigError
from ..base.files.text_tables import key_values, text_table
from ..base.shown_text import one_line, shown_name
from ..base.units import ARCSEC, REV, per_turn, radians_of
from ..pair.schema import PairSpec, as_ratio
from .channel.unwrap import find_modulus, kept_rows, step_of, unwrap, whole, wrap_steps
from .checks.sampling import Sampling, sampling_of
from .readers.column_names import (
    ANGLES,
    ROW,
    ROW_INDEX,
    SHAFT_UNITS,
    TIME_UNITS,
    listed,
    matrix_name,
    name_and_unit,
    units_of,
)
from .readers.open_table import open_table
from .readers.times import read_stamps, seconds_of_numbers
from .recognition.answers import all_questions
from .recognition.assign import Roles, Search
from .recognition.candidates import EQUAL, Candidate, Question, is_copy
from .recognition.request import (
    SHAFTS,
    DriveRequest,
    ReadingOptions,
    Statement,
    fit_command,
    in_words,
    roles_of,
)
from .slope import likely_fraction, ratio_option, slope
from .source import LEAST_RANGE, Source, check_time

MOST_COLUMNS = 30
"""Largest number of columns in the table of a preview; those of a matrix go first (chosen)."""

MOST_PROPOSED = 4
"""Largest number of proposed commands in the text of a preview (chosen)."""

_NO_RATIO = "no ratio is seen: `vttig inspect` with --ratio A:B prints the command for a fit"
_ANSWER = "to fit it, complete this command (`vttig inspect` takes the same options)"


_MOST_COLUMNS = 8
"""Among more columns that can be a shaft no pairs are compared, only listed (chosen)."""


WIDTH = 100  # characters in a line of the report (chosen)


@dataclass(frozen=True)
class ColumnReport:
    """Properties of one column of a log; `low` and `high` are the range of its values in `unit`.

    `turns` and `resolution_arcsec` (encoder step) are None if the column is not an angle.
    """

    role: str | None
    name: str
    unit: str | None
    low: float
    high: float
    resolution_arcsec: float | None = None
    turns: float | None = None
    modulus: int | float | None = None
    wraps: int = 0


@dataclass(frozen=True)
class Proposal:
    """Command that fits the log if `condition` is true, such as "the motor drives the load"."""

    condition: str
    command: str


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
    questions: tuple[Question, ...] = ()
    """What a fit asks, if neither a name nor an option says it."""
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
            **({"questions": [q.to_json() for q in self.questions]} if self.questions else {}),
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
        shown = self.columns
        if len(shown) > MOST_COLUMNS:
            shown = [c for c in shown if c.role or matrix_name(c.name) == c.name][:MOST_COLUMNS]
        parts = [shown_name(self.source), column_table(shown), key_values(rows)]
        if len(shown) < len(self.columns):
            names = [one.name for one in self.columns if one not in shown]
            parts.append(f"{len(names)} more columns: {listed(names)}")
        lengths = sorted({length for _, length in self.others}, reverse=True)
        outside = [
            f"arrays of {length} values are no part of this record of {self.rows}: "
            + listed([name for name, values in self.others if values == length])
            for length in lengths
        ]
        parts.append(bullets("note", (*outside, *self.notes)))
        if self.fit_command and self.ratio is not None:
            turns = in_words(as_ratio(ratio_option(abs(self.ratio[0]), self.ratio[1]), ""))
            parts.append(f"if {turns}:\n  {self.fit_command}")
        if self.proposals:
            parts.append("to fit it, copy the command whose sentence is true:")
        parts += [f"if {p.condition}:\n  {p.command}" for p in self.proposals[:MOST_PROPOSED]]
        if (more := len(self.proposals) - MOST_PROPOSED) > 0:
            parts.append(f"{more} more are in the output of --json")
        return "\n\n".join(part for part in parts if part)


def preview_log(
    path: str | Path,
    *,
    spec: PairSpec | None = None,
    request: DriveRequest = DriveRequest(),
    reading: ReadingOptions = ReadingOptions(),
) -> Preview:
    """Return a preview of a log that is read with the options `reading`.

    `spec` is a pair file that names columns and units. Without it they are recognised from the
    column names, and the notes ask for information that neither the names nor `request` give.

    Text without a header has the columns #1, #2, …. The record of a nested file consists of the
    arrays as long as the driving array, or else of the arrays with the most frequent length.

    **Raises** `LogError` for files without a table, and for names that do not exist.
    """
    statement = request.statement(reading) if spec is None else Statement.of(spec, reading)
    table, rate_hz = open_table(path, statement.layout), statement.layout.sample_rate_hz
    search = Search(table, statement)
    found = search.result()
    roles = {index: role for role, index in search.roles.items()}
    arrays, unread = _readable(search)
    lengths = {role: len(arrays[k]) for k, role in roles.items() if k in arrays}
    usual = Counter(map(len, arrays.values())).most_common(1)[0][0]
    size = next((lengths[r] for r in (*SHAFTS, "transmission_error") if r in lengths), usual)
    others = [(table.names[k], len(a)) for k, a in arrays.items() if len(a) != size]
    if ROW_INDEX in roles:
        arrays[ROW_INDEX] = np.arange(size)
    arrays = {k: a for k, a in arrays.items() if len(a) == size}
    names = {k: ROW if k == ROW_INDEX else table.names[k] for k in (*roles, *arrays)}
    source = Source(table.source, {r: names[k] for k, r in roles.items()}, table.line_of)
    shown = [_report(names[k], roles.get(k), a, found) for k, a in arrays.items()]
    hints = [*table.notes, *table.left_out(range(len(table.names))), *unread]
    for role, name in source.columns.items():
        if search.roles[role] not in arrays:
            how = "differs in length" if name in dict(others) else "is not read"
            told = f"cannot be the {role} of this record of {size} samples: it {how}"
            hints.append(f"column `{name}` {told}")
    time = None if rate_hz is None else np.arange(size) / rate_hz
    for (report, _), values in zip(shown, arrays.values(), strict=True):
        if report.role == "time" and time is None:
            time = seconds_of_numbers(values, report.unit or "s")

    def turns() -> np.ndarray:
        for report, angle in shown:
            if report.role == "driving" and report.turns is not None and angle is not None:
                return angle / REV
        raise UsageError(
            "turns of the driving shaft are known once its column and unit are; name them with"
            " --column driving=NAME and --unit."
        )

    used = {roles.get(k, names[k]): a for k, a in arrays.items() if k in roles or not roles}
    used |= {"time": np.arange(size) if time is None else time}
    rows, told = kept_rows(statement.layout, used, turns, source)
    if rows is not None:
        arrays, size = {k: a[rows] for k, a in arrays.items()}, len(rows)
        time, source = None if time is None else time[rows], replace(source, rows=rows)
        shown = [_report(names[k], roles.get(k), a, found) for k, a in arrays.items()]
    hints += told
    reports = [report for report, _ in shown]
    angles = {r.role: angle for r, angle in shown if angle is not None and r.role is not None}
    hints += [] if time is None else check_time(time, source)
    counted = {r.turns is None for r in reports if r.role in SHAFTS}
    both = {*SHAFTS} <= angles.keys() and len(counted) == 1
    ratio = slope(angles["driving"], angles["driven"]) if both else None
    command, proposed, questions = "", (), list[VttigError]()
    if spec is None:
        hints += map(str, found.guesses)
        if any(r.turns is None and r.unit == "counts" for r in reports if r.role in SHAFTS):
            hints.append(
                "turns need counts_per_rev: give --counts; the ratio takes counts as equal"
            )
        hints.append(
            "this is a first look; --ratio A:B (or --pair PAIR.toml) adds flanks, speeds and the"
            " orders"
        )
        questions, options = all_questions(path, found, request, reading)
        asked = [one for one in questions if one.message not in "".join(hints)]
        hints += [f"a fit asks: {str(one).removeprefix(f'{table.source}: ')}" for one in asked]
        if not questions and ratio is not None and ratio[0] != 0:
            command = fit_command(path, with_ratio(request, ratio), found.names, reading)
        elif questions and not request.names_a_drive:
            proposed = proposals(search, request, path, reading)
        if not command and not proposed:
            told = fit_command(path, request, roles_of(reading.columns), reading, options)
            hints.append(f"{_ANSWER}: {told}" if questions else _NO_RATIO)
    return Preview(
        source=str(path),
        sha256=table.digest,
        rows=size,
        columns=tuple(reports),
        sampling=None if time is None else sampling_of(time),
        ratio=ratio,
        notes=tuple(hints),
        others=tuple(others),
        fit_command=command,
        questions=tuple(one for one in questions if isinstance(one, Question)),
        proposals=proposed,
    )


def column_table(columns: "Sequence[ColumnReport]") -> str:
    """Return a table with one row for each column of the log; constant columns are marked."""
    rows = [
        (
            c.role or "",
            c.name,
            c.unit,
            f"{c.low:.9g}",
            f"{c.high:.9g}",
            "constant" if c.low == c.high else None if c.turns is None else f"{c.turns:.4g}",
            None if c.resolution_arcsec is None else f"{c.resolution_arcsec:.3g}",
            f"{c.wraps} at {c.modulus:.6g}" if c.modulus is not None else "no",
        )
        for c in columns
    ]
    heads = ["used as", "column", "unit", "lowest", "highest", "turns", ("step", "″"), "wraps"]
    return text_table(rows, heads, align="lllrrrrr")


def sampling_rows(sampling: Sampling, rows: int) -> list[tuple[str, str]]:
    """Return (name, text) of the properties of the time stamps of a log with `rows` samples."""
    share = sampling.jitter_s * sampling.rate_hz
    properties = [
        ("samples", f"{rows} in {sampling.duration_s:.6g} s"),
        ("rate", f"{sampling.rate_hz:.6g} Hz (every {1 / sampling.rate_hz:.4g} s)"),
        ("jitter", f"{sampling.jitter_s:.2g} s rms, {share:.1%} of it" if share > 1e-6 else "none"),
        (
            "gaps",
            f"{sampling.gaps}, the longest {sampling.longest_s:.4g} s" if sampling.gaps else "none",
        ),
    ]
    if sampling.duplicates:
        properties.append(("repeated stamps", str(sampling.duplicates)))
    return properties


def bullets(title: str, sentences: Sequence[str]) -> str:
    """Return sentences as wrapped lines that each begin with "title:"."""
    indent = " " * (len(title) + 2)
    return "\n".join(
        fill(f"{title}: {one_line(s)}", WIDTH, subsequent_indent=indent, break_long_words=False)
        for s in sentences
    )


def _readable(search: Search) -> tuple[dict[int, np.ndarray], list[str]]:
    """Return index → values of all numeric columns, and notes on the columns that are not read.

    A time column of dates is converted to seconds.

    **Raises** `LogError` if no column is read.
    """
    table, arrays, errors = search.table, search.table.numeric(), {}
    for k, name in enumerate(table.names):
        if table.is_dated(k):
            if search.roles.get("time") == k:
                size = max((len(values) for values in arrays.values()), default=None)
                place = Source(table.source, {"time": name}, table.line_of)
                arrays[k] = read_stamps(table.texts(k)[:size], partial(place.at, "time"))[0]
        elif k not in arrays:
            try:
                (arrays[k],) = table.columns([k])
            except LogError as error:
                errors[name] = error
    if not arrays:
        raise next(iter(errors.values()))
    seen = {name: error.message.replace("; correct it.", ".") for name, error in errors.items()}
    notes = [f"column `{name}` is not read: {fault}" for name, fault in seen.items()]
    return dict(sorted(arrays.items())), notes


def _report(
    name: str, role: str | None, values: Real[np.ndarray, " n"], found: Roles
) -> tuple[ColumnReport, Real[np.ndarray, " n"] | None]:
    """Return a row of the column table, and the unwrapped readings if the column is a shaft.

    The readings are in rad, or in counts if the counts per revolution are not stated.
    """
    counts = found.statement.encoders[role == "driven"].counts_per_rev if role in SHAFTS else None
    units = units_of(role) if role else (*units_of("driving"), *TIME_UNITS)
    unit = name_and_unit(name, units, name)[1] or found.units.get(role or "")
    low, high = float(np.fmin.reduce(values)), float(np.fmax.reduce(values))
    plain = ColumnReport(role, name, unit, low, high)
    lead = found.statement.layout.lead_mm
    shaft = role in SHAFTS or (role is None and unit in ANGLES)
    if not shaft or unit is None or not np.isfinite(values).all() or np.ptp(values) < LEAST_RANGE:
        return plain, None
    values = whole(values) if unit == "counts" else values
    radians = radians_of(unit, counts, lead) if unit in SHAFT_UNITS else None
    modulus = find_modulus(values, per_turn(unit, counts) if unit in SHAFT_UNITS else None)
    wraps = 0
    if modulus is not None:
        wraps = int(np.count_nonzero(wrap_steps(values, modulus)))
        values = unwrap(values, modulus)
    report = replace(plain, modulus=modulus, wraps=wraps)
    if radians is None:
        return report, values.astype(np.float64)
    step = step_of(values) * radians / ARCSEC or None
    turns = float(np.ptp(values)) * radians / REV
    return replace(report, resolution_arcsec=step, turns=turns), values * radians


def with_ratio(request: DriveRequest, seen: tuple[float, float]) -> DriveRequest:
    """Return `request` with the likeliest text of the ratio `seen` (value, standard error).

    If the readings of the shafts have opposite directions, the driven encoder is inverted.
    """
    request = request if seen[0] > 0 else request.with_driven_inverted()
    return replace(request, ratio=ratio_option(abs(seen[0]), seen[1]))


def proposals(
    search: Search, request: DriveRequest, path: str | Path, reading: ReadingOptions
) -> tuple[Proposal, ...]:
    """Return the commands for both readings of the pairs of columns that turn together.

    The slope of two columns is the ratio of the shafts; which of them drives the other is known
    only to the user. `search` is a finished search without a ratio. A command that would end in
    another question, for example for the time, is left out. One reading in two units is no pair,
    unless there is no other. Pairs of which a name tells a shaft come first, then those whose ratio
    is known best; of the two readings of a pair, the one with the faster driving shaft.
    """
    found: list[tuple[tuple[bool, float], list[Proposal]]] = []
    copies: list[Proposal] = []
    for pair in _pairs(search):
        slopes = [(search.slope(*order), order) for order in (pair, pair[::-1])]
        known = [
            (seen, order)
            for seen, order in slopes
            if seen and order[0].reading.role != "driven" and order[1].reading.role != "driving"
        ]
        commands: list[Proposal] = []
        for seen, (driving, driven) in sorted(known, key=lambda one: abs(one[0][0])):
            chosen = {"driving": driving, "driven": driven}
            if any(search.roles.get(role, one.index) != one.index for role, one in chosen.items()):
                continue  # an option or a name gives the role to another column
            trial = with_ratio(request, seen)
            names = roles_of(reading.columns)
            names |= {role: search.name_of(one.index) for role, one in chosen.items()}
            named = msgspec.structs.replace(
                reading, columns=tuple(f"{role}={name}" for role, name in names.items())
            )
            other = Search(search.table, trial.statement(named))
            other.__dict__["candidates"] = search.candidates  # their values are compared once
            complete = other.result()
            questions, options = all_questions(path, complete, trial, named)
            if len(options) < len(questions) or "NAME" in "".join(options):
                continue
            drives = f"`{driving.name}` drives `{driven.name}`"
            command = fit_command(path, trial, complete.names, reading, options)
            commands.append(Proposal(f"{drives}: {in_words(trial.speed_ratio)}", command))
        if is_copy(*pair) and all(abs(abs(seen[0]) - 1) < EQUAL for seen, _ in known):
            copies += commands
            continue
        unnamed = not any(one.reading.role for one in pair)
        share = min((std / abs(value) for (value, std), _ in known), default=0.0)
        found.append(((unnamed, share), commands))
    ordered = [one for _, own in sorted(found, key=lambda one: one[0]) for one in own]
    return tuple(ordered or copies)


def _pairs(search: Search) -> list[tuple[Candidate, Candidate]]:
    """Return the pairs of columns that can be the two shafts; a shaft with a role stays in all.

    There are none if more than `_MOST_COLUMNS` columns can be a shaft.
    """
    free = [one for one in search.free() if one.turns and one.reading.is_angle]
    fixed = [*search.shafts.values()]
    if len(free) > _MOST_COLUMNS or "transmission_error" in search.roles:
        return []
    if len(fixed) == 1:
        return [(fixed[0], one) for one in free] if fixed[0].turns else []
    return list(combinations(free, 2))
