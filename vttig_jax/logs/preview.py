"""A first look at a log without a pair file: columns, units by their names, rate, turns, ratio."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Real

from ..base.errors import LogError
from ..base.tables import key_values
from ..base.units import ANGLE_UNITS, ARCSEC, REV
from .channel import step_of
from .checks import check_time
from .columns import ROLES, SOUGHT, TIME_UNITS, default_column, index_of, name_and_unit, units_of
from .inspection import ColumnReport
from .ratio import simple_fraction, slope
from .read import check_arguments
from .sampling import Sampling, sampling_of
from .source import Source
from .table import Table, find_table
from .text import read_text
from .unwrap import find_modulus, unwrap, wrap_steps
from .wording import bullets, column_table, sampling_rows


@dataclass(frozen=True)
class Preview:
    """What a log shows by itself."""

    source: str
    sha256: str
    rows: int
    columns: tuple[ColumnReport, ...]
    sampling: Sampling | None
    ratio: tuple[float, float] | None
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The report as `vttig.inspect/1`; what needs a pair file is absent."""
        seen, std = self.ratio or (None, None)
        return {
            "schema": "vttig.inspect/1",
            "source": self.source,
            "sha256": self.sha256,
            "samples": {"read": self.rows},
            "columns": [asdict(column) for column in self.columns],
            "sampling": None if self.sampling is None else asdict(self.sampling),
            "ratio": {"given": None, "seen": seen, "std": std},
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        rows: list[tuple[str, str]] = [("samples", str(self.rows))]
        if self.sampling is not None:
            rows = sampling_rows(self.sampling, self.rows)
        if self.ratio is not None:
            seen, std = self.ratio
            near = simple_fraction(seen, std)
            rows.append(("ratio seen", f"{seen:.6g} ± {std:.1g}, driven over driving ({near})"))
        parts = [self.source, column_table(self.columns), key_values(rows)]
        parts.append(bullets("note", self.notes))
        return "\n\n".join(part for part in parts if part)


def preview_log(
    path: str | Path,
    *,
    columns: Mapping[str, str] | None = None,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> Preview:
    """Look at a log without knowing the pair; arguments as `read_log`.

    **Raises** `LogError` for files that hold no table, and for names that are not there.
    """
    columns = columns or {}
    check_arguments(columns, decimal, sample_rate_hz)
    text, digest, notes = read_text(path, None)
    table = find_table(text, str(path), decimal=decimal)
    roles = _roles(table, columns)
    arrays, broken = _readable(table)
    source = Source(str(path), {r: table.names[k] for k, r in roles.items()}, table.line_of)
    angles: dict[str, np.ndarray] = {}
    reports = []
    for k, values in arrays.items():
        report, angle = _report(table.names[k], roles.get(k), values)
        reports.append(report)
        if angle is not None and report.role is not None:
            angles[report.role] = angle
    size = len(next(iter(arrays.values())))
    hints = [*notes, *broken]
    time = _time(table, roles, arrays, size, sample_rate_hz)
    sampling = None
    if time is not None:
        hints += check_time(time, source)
        sampling = sampling_of(time)
    hints += _hints(roles, sample_rate_hz, reports)
    ratio = None
    counts = {r.unit == "counts" for r in reports if r.role in ("driving", "driven")}
    if {"driving", "driven"} <= set(angles) and len(counts) == 1:
        ratio = slope(angles["driving"], angles["driven"])
    return Preview(str(path), digest, size, tuple(reports), sampling, ratio, tuple(hints))


def _roles(table: Table, columns: Mapping[str, str]) -> dict[int, str]:
    """Column index to role: as named, else by the default names."""
    roles = {}
    for role in ROLES:
        if role in columns:
            index = index_of(columns[role], role, table.names, table.source)
        else:
            index = default_column(role, table.names, table.source) if role in SOUGHT else None
        if index is not None:
            roles[index] = role
    return roles


def _readable(table: Table) -> tuple[dict[int, np.ndarray], list[str]]:
    """All columns of numbers, and a note on each of the others."""
    every = range(len(table.names))
    try:
        return dict(enumerate(table.columns(every))), []
    except LogError:
        pass
    arrays, errors = {}, {}
    for k in every:
        try:
            arrays[k] = table.columns([k])[0]
        except LogError as error:
            errors[k] = error
    if not arrays:
        raise errors[0]
    notes = [
        f"column `{table.names[k]}` is not read: {error.message}" for k, error in errors.items()
    ]
    return arrays, notes


def _report(
    name: str, role: str | None, values: Real[np.ndarray, " n"]
) -> tuple[ColumnReport, Real[np.ndarray, " n"] | None]:
    """A row of the column table, and the unwrapped channel (rad, or counts) of a shaft."""
    units = units_of(role) if role else (*units_of("driving"), *TIME_UNITS)
    unit = name_and_unit(name, units, name)[1]
    plain = ColumnReport(role, name, unit, float(values.min()), float(values.max()))
    shaft = role in ("driving", "driven") or (role is None and unit in ("counts", *ANGLE_UNITS))
    if not shaft or unit is None or not np.isfinite(values).all() or np.ptp(values) == 0:
        return plain, None
    if unit == "counts" and np.all(values == np.rint(values)):
        values = values.astype(np.int64)
    radians = ANGLE_UNITS.get(unit)
    modulus = find_modulus(values, None if radians is None else REV / radians)
    wraps = 0
    if modulus is not None:
        wraps = int(np.count_nonzero(wrap_steps(values, modulus)))
        values = unwrap(values, modulus)
    if radians is None:
        report = ColumnReport(role, name, unit, plain.low, plain.high, None, None, modulus, wraps)
        return report, values.astype(np.float64)
    report = ColumnReport(
        role,
        name,
        unit,
        plain.low,
        plain.high,
        step_of(values) * radians / ARCSEC or None,
        float(np.ptp(values)) * radians / REV,
        modulus,
        wraps,
    )
    return report, values * radians


def _time(
    table: Table,
    roles: Mapping[int, str],
    arrays: Mapping[int, np.ndarray],
    size: int,
    sample_rate_hz: int | float | None,
) -> np.ndarray | None:
    if sample_rate_hz is not None:
        return np.arange(size) / sample_rate_hz
    for k, role in roles.items():
        if role == "time" and k in arrays:
            unit = name_and_unit(table.names[k], tuple(TIME_UNITS), table.names[k])[1]
            return arrays[k] * TIME_UNITS[unit or "s"]
    return None


def _hints(
    roles: Mapping[int, str], sample_rate_hz: int | float | None, reports: list[ColumnReport]
) -> list[str]:
    """What is still missing for a fit, and how to name it."""
    taken = set(roles.values())
    hints = []
    if "time" not in taken and sample_rate_hz is None:
        hints.append("no time column found; name it with --column time=NAME or give --sample-rate")
    if "driving" not in taken:
        hints.append("no driving column found; name it with --column driving=NAME")
    if not taken & {"driven", "transmission_error"}:
        hints.append(
            "no driven column found; name it with --column driven=NAME (or transmission_error=NAME)"
        )
    units = {r.role: r.unit for r in reports if r.role in ("driving", "driven")}
    for role, unit in units.items():
        if unit is None:
            hints.append(f"{role}: its name tells no unit; state it in [unit] of a pair file")
    if "counts" in units.values():
        hints.append("turns need counts_per_rev: give --pair; the ratio takes counts as equal")
    hints.append("this is a first look; --pair PAIR.toml adds flanks, speeds and the orders")
    return hints
