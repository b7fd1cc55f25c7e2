"""Roles and units of the columns of a log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...base.errors import LogError
from ...pair.schema import LogLayout, UnitTable
from .column_names import ROW, default_column, index_of, listed, missing, name_and_unit, units_of
from .column_names import TIME_UNITS as TIME_UNITS

ROLES = (
    "time",
    "driving",
    "driven",
    "transmission_error",
    "direction",
    "axial_mm",
    "torque",
    "speed",
    "acceleration",
)
"""Roles that the option `--column role=name` accepts."""

SOUGHT = ("time", "driving", "driven", "transmission_error")
"""Roles whose columns are searched by default names if no name is given."""

ROW_INDEX = -1
"""Index of the column `#row`, which is not in the table."""

_SUFFIXES = {  # required for roles without a key in [unit]
    "speed": "_rpm, _deg_per_s or _rad_per_s",
    "acceleration": "_rad_per_s2 or _deg_per_s2",
}


@dataclass(frozen=True)
class Column:
    """Column of the file with a role; `unit` is "" for a column without unit."""

    role: str
    index: int
    name: str
    unit: str


def requested_names(layout: LogLayout, overrides: Mapping[str, str]) -> dict[str, str | None]:
    """Return role → column name from `overrides`, otherwise from [log]; None if neither has one.

    An override of `driven` replaces a `transmission_error` of [log], and vice versa.
    """
    named = {role: overrides.get(role) or getattr(layout, role) for role in ROLES}
    for role, other in (("driven", "transmission_error"), ("transmission_error", "driven")):
        if role in overrides and other not in overrides:
            named[other] = None
    return named


def find_columns(
    names: Sequence[str],
    layout: LogLayout,
    units: UnitTable,
    overrides: Mapping[str, str],
    source: str,
    *,
    timed: bool,
) -> dict[str, Column]:
    """Return the column of every role in `ROLES` that the log has.

    The name of the column is taken from `overrides` if it is given there, otherwise from `layout`.
    If neither gives a name, the roles in `SOUGHT` are searched by their default names, and other
    roles have no column. The role `driving` has none if `layout.driving_rpm` is given. The name
    `#1` means the first column of the file. The name `#row` means the row numbers 0, 1, 2, …, which
    are not a column of the file.

    **Arguments**
    - `names`: names of the columns in the file. - `layout`: table [log] of the pair file.
    - `units`: table [unit] of the pair file. - `overrides`: role → name, as from `--column`.
    - `source`: name of the log, for error messages.
    - `timed`: False if a sample rate replaces the time column.

    **Raises** `LogError` for missing, ambiguous or repeated columns and for contradictory units.
    """
    named = requested_names(layout, overrides)
    columns: dict[str, Column] = {}
    for role in ROLES:
        if role == "time" and not timed:
            continue
        name = named[role]
        if name == ROW:
            place = f"{source}: column `{ROW}`"
            columns[role] = Column(role, ROW_INDEX, ROW, _unit_of(role, ROW, units, place))
            continue
        if name is not None:
            index = index_of(name, role, names, source)
        elif role in SOUGHT and not (role == "driving" and layout.driving_rpm is not None):
            index = default_column(role, names, source)
        else:
            index = None
        if index is not None:
            place = f"{source}: column `{names[index]}`"
            unit = _unit_of(role, names[index], units, place)
            columns[role] = Column(role, index, names[index], unit)
    if layout.driving_rpm is not None:
        if "driving" in columns:
            raise LogError(
                "a driving column and `driving_rpm` are both given; keep one of them.", where=source
            )
        named = {**named, "driving": ROW}
    return _complete(columns, named, names, source, timed)


def _complete(
    columns: dict[str, Column],
    named: Mapping[str, str | None],
    names: Sequence[str],
    source: str,
    timed: bool,
) -> dict[str, Column]:
    """Check the columns, and return them with either `driven` or `transmission_error`.

    If both were found, the one with a given name is kept; if neither was named, `driven` is kept.
    `named` is role → given name.

    **Raises** `LogError` if both were named, for a missing column and for a column with two roles.
    """
    if "driven" in columns and "transmission_error" in columns:
        if named["transmission_error"] is not None and named["driven"] is None:
            del columns["driven"]
        elif named["transmission_error"] is None:
            del columns["transmission_error"]
        else:
            raise LogError(
                "columns for `driven` and `transmission_error` are both named; keep one of them.",
                where=source,
            )
    for role in ("time", "driving") if timed else ("driving",):
        if role not in columns and named[role] != ROW:
            raise missing(role, names, source)
    if "driven" not in columns and "transmission_error" not in columns:
        raise missing("driven", names, source)
    assigned: dict[int, str] = {}
    for column in columns.values():
        if column.index in assigned:
            raise LogError(
                f"this column is `{assigned[column.index]}` and `{column.role}` at once; name"
                f" another column with --column {column.role}=NAME.",
                where=f"{source}: column `{column.name}`",
            )
        assigned[column.index] = column.role
    return columns


def _unit_of(role: str, name: str, units: UnitTable, where: str) -> str:
    """Return the unit that the column name or the table [unit] of the pair file states.

    **Raises** `LogError` if both state different units, if a required unit is missing, or if the
    role cannot have this unit.
    """
    written = name_and_unit(name, units_of(role), where)[1]
    if role == "time" and units.time is None:
        return written or "s"
    if role == "axial_mm":
        return written or "mm"
    if role in ("direction", "torque"):
        return ""
    if role in _SUFFIXES:
        if written is None:
            message = f"this column has no unit; end the name with {_SUFFIXES[role]}."
            raise LogError(message, where=where)
        return written
    stated = getattr(units, role)
    if stated is not None and written is not None and stated != written:
        raise LogError(
            f"the name has the unit {written}, but [unit] {role} has {stated}; correct one.",
            where=where,
        )
    unit = written or stated
    if unit is None:
        raise LogError(
            "this column has no unit; end the name with _deg, _rad, … or write"
            f' `{role} = "deg"` in [unit].',
            where=where,
        )
    if unit not in units_of(role):
        raise LogError(
            f"{unit} is no unit of a {role.replace('_', ' ')}; use one of"
            f" {listed(units_of(role))}.",
            where=where,
        )
    return unit
