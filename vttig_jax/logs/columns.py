"""Which column plays which part, and in which unit."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..base.errors import LogError
from ..base.units import ANGLE_UNITS
from ..pair.spec import LogLayout, UnitTable

ROLES = ("time", "driving", "driven", "transmission_error", "direction", "axial_mm", "torque")
"""What `--column role=name` can name."""

SOUGHT = ("time", "driving", "driven", "transmission_error")
"""Roles looked for by their default names."""

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
"""Seconds per unit."""

LENGTH_UNITS = {"mm": 1.0, "um": 1e-3}
"""Millimetres per unit."""

ANGLES = ("counts", *ANGLE_UNITS)
_SPELLINGS = {"°": "deg", "″": "arcsec", "µrad": "urad", "μrad": "urad", "µs": "us", "μs": "us"}
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")


@dataclass(frozen=True)
class Column:
    """A column of the file that plays a part; `unit` is "" where it has none."""

    role: str
    index: int
    name: str
    unit: str


def units_of(role: str) -> Sequence[str]:
    """Units a role can be written in."""
    if role == "time":
        return tuple(TIME_UNITS)
    if role == "axial_mm":
        return tuple(LENGTH_UNITS)
    if role == "transmission_error":
        return tuple(ANGLE_UNITS)
    return ANGLES if role in ("driving", "driven") else ()


def name_and_unit(name: str, units: Sequence[str], where: str) -> tuple[str, str | None]:
    """Split `driving_deg`, `driving [deg]` or `driving (deg)` into "driving" and "deg".

    **Raises** `LogError` where suffix and bracket differ.
    """
    bracket = _BRACKET.search(name)
    stem = name[: bracket.start()] if bracket else name
    inside = _SPELLINGS.get(bracket[1], bracket[1].lower()) if bracket else None
    if inside not in units:
        inside = None
    stem, suffix = stem.strip(), None
    if "_" in stem and stem.rpartition("_")[2].lower() in units:
        stem, _, suffix = stem.rpartition("_")
        suffix = suffix.lower()
    if suffix and inside and suffix != inside:
        raise LogError(f"the name says both {suffix} and {inside}; rename the column.", where=where)
    return stem, suffix or inside


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

    A name comes from `overrides`, else from [log], else the default is looked for.

    **Raises** `LogError` for missing, doubtful or repeated columns and for units that disagree.
    """
    named = {role: overrides.get(role) or getattr(layout, role) for role in ROLES}
    for role, other in (("driven", "transmission_error"), ("transmission_error", "driven")):
        if role in overrides and other not in overrides:
            named[other] = None
    found: dict[str, Column] = {}
    for role in ROLES:
        if role == "time" and not timed:
            continue
        name = named[role]
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
            raise _missing(role, names, source)
    if "driven" not in found and "transmission_error" not in found:
        raise _missing("driven", names, source)
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


def index_of(name: str, role: str, names: Sequence[str], source: str) -> int:
    """Index of a column: by its exact name, else without case or unit, else by its last part."""
    tests = (
        lambda one: one == name,
        lambda one: one.lower() == name.lower(),
        lambda one: str(name_and_unit(one, units_of(role), source)[0]).lower() == name.lower(),
        lambda one: re.split(r"[/\\.]", one)[-1] == name,
    )
    for test in tests:
        hits = [k for k, one in enumerate(names) if test(one)]
        if len(hits) == 1:
            return hits[0]
        if hits:
            raise LogError(
                f"{len(hits)} columns fit `{name}` ({_listed([names[k] for k in hits])}); rename"
                " one.",
                where=source,
            )
    raise _missing(role, names, source, name)


def default_column(role: str, names: Sequence[str], source: str) -> int | None:
    """Column a role has by its default name, None where there is none; two are an error."""
    hits: list[int] = []
    for k, name in enumerate(names):
        stem, unit = name_and_unit(name, units_of(role), f"{source}: column `{name}`")
        if stem.lower() == role and (unit is not None or role == "time" or stem == name):
            hits.append(k)
    if len(hits) > 1:
        raise LogError(
            f"{len(hits)} columns could be `{role}` ({_listed([names[k] for k in hits])}); name"
            f" one with --column {role}=NAME or in [log].",
            where=source,
        )
    return hits[0] if hits else None


def _unit_of(role: str, name: str, units: UnitTable, where: str) -> str:
    """Unit from the column's name and from [unit], which must agree."""
    written = name_and_unit(name, units_of(role), where)[1]
    if role == "time":
        return written or "s"
    if role == "axial_mm":
        return written or "mm"
    if role in ("direction", "torque"):
        return ""
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
            f" {_listed(units_of(role))}.",
            where=where,
        )
    return unit


def _missing(role: str, names: Sequence[str], source: str, name: str | None = None) -> LogError:
    patterns = {"time": "time_s", "driven": "driven_* or transmission_error_*"}
    wanted = name or patterns.get(role, f"{role}_*")
    close = difflib.get_close_matches(name or role, names, 1, 0.5)
    hint = f" (closest: {close[0]})" if close else ""
    rate = ", or give --sample-rate" if role == "time" else ""
    return LogError(
        f"no column {wanted}; the log has {_listed(names)}{hint}; name it with --column"
        f" {role}=NAME or in [log]{rate}.",
        where=source,
    )


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    shown = ", ".join(names[:12])
    return shown + (f" and {len(names) - 12} more" if len(names) > 12 else "")
