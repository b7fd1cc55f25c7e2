"""Which column plays which part, and in which unit."""

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
"""What `--column role=name` can name."""

SOUGHT = ("time", "driving", "driven", "transmission_error")
"""Roles looked for by their default names."""

ROW_INDEX = -1
"""Index of the column `#row`, which no table holds."""

_CURES = {  # roles without a key in [unit]
    "speed": "_rpm, _deg_per_s or _rad_per_s",
    "acceleration": "_rad_per_s2 or _deg_per_s2",
}


@dataclass(frozen=True)
class Column:
    """A column of the file that plays a part; `unit` is "" where it has none."""

    role: str
    index: int
    name: str
    unit: str


def names_asked(layout: LogLayout, overrides: Mapping[str, str]) -> dict[str, str | None]:
    """The name of the column of every role, from `overrides`, else from [log], else None."""
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
    """Find the columns of a log; `timed` is False where a sample rate stands for the time.

    A name comes from `overrides`, else from [log], else the default is looked for. `#1` is the
    first column, `#row` the number 0, 1, 2, … of the row.

    **Raises** `LogError` for missing, doubtful or repeated columns and for units that disagree.
    """
    named = names_asked(layout, overrides)
    found: dict[str, Column] = {}
    for role in ROLES:
        if role == "time" and not timed:
            continue
        name = named[role]
        if name == ROW:
            place = f"{source}: column `{ROW}`"
            found[role] = Column(role, ROW_INDEX, ROW, _unit_of(role, ROW, units, place))
            continue
        if name is not None:
            index = index_of(name, role, names, source)
        elif role in SOUGHT:
            index = default_column(role, names, source)
        else:
            index = None
        if index is not None:
            place = f"{source}: column `{names[index]}`"
            unit = _unit_of(role, names[index], units, place)
            found[role] = Column(role, index, names[index], unit)
    return _complete(found, named, names, source, timed)


def _complete(
    found: dict[str, Column],
    named: Mapping[str, str | None],
    names: Sequence[str],
    source: str,
    timed: bool,
) -> dict[str, Column]:
    """Drop the curve where both shafts are there unasked; refuse what is missing or doubled."""
    if "driven" in found and "transmission_error" in found:
        if named["transmission_error"] is not None and named["driven"] is None:
            del found["driven"]
        elif named["transmission_error"] is None:
            del found["transmission_error"]
        else:
            raise LogError(
                "both `driven` and `transmission_error` are named; a log has the second shaft or"
                " the curve.",
                where=source,
            )
    for role in ("time", "driving") if timed else ("driving",):
        if role not in found:
            raise missing(role, names, source)
    if "driven" not in found and "transmission_error" not in found:
        raise missing("driven", names, source)
    seen: dict[int, str] = {}
    for column in found.values():
        if column.index in seen:
            raise LogError(
                f"is `{seen[column.index]}` and `{column.role}` at once; name another column with"
                f" --column {column.role}=NAME.",
                where=f"{source}: column `{column.name}`",
            )
        seen[column.index] = column.role
    return found


def _unit_of(role: str, name: str, units: UnitTable, where: str) -> str:
    """Unit from the column's name and from [unit], which must agree."""
    written = name_and_unit(name, units_of(role), where)[1]
    if role == "time":
        return written or "s"
    if role == "axial_mm":
        return written or "mm"
    if role in ("direction", "torque"):
        return ""
    if role in _CURES:
        if written is None:
            raise LogError(f"no unit: end the name with {_CURES[role]}.", where=where)
        return written
    stated = getattr(units, role)
    if stated is not None and written is not None and stated != written:
        raise LogError(
            f"the name says {written}, [unit] {role} says {stated}; correct one of them.",
            where=where,
        )
    unit = written or stated
    if unit is None:
        raise LogError(
            f'no unit: end the name with _deg, _rad, … or write `{role} = "deg"` in [unit].',
            where=where,
        )
    if unit not in units_of(role):
        raise LogError(
            f"{unit} is no unit of a {role.replace('_', ' ')}; it is an angle in"
            f" {listed(units_of(role))}.",
            where=where,
        )
    return unit
