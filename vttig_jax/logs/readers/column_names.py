"""What the name of a column says, and which column a name means."""

import difflib
import re
from collections.abc import Iterable, Sequence

from ...base.errors import LogError
from ...base.units import ANGLE_UNITS

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
"""Seconds per unit."""

LENGTH_UNITS = {"mm": 1.0, "um": 1e-3}
"""Millimetres per unit."""

SPEED_UNITS = {
    "rpm": ANGLE_UNITS["rev"] / 60,
    "deg_per_s": ANGLE_UNITS["deg"],
    "rad_per_s": 1.0,
}
"""rad/s per unit."""

ACCELERATION_UNITS = {"deg_per_s2": ANGLE_UNITS["deg"], "rad_per_s2": 1.0}
"""rad/s² per unit."""

ANGLES = ("counts", *ANGLE_UNITS)

_UNITS = {
    "time": tuple(TIME_UNITS),
    "driving": ANGLES,
    "driven": ANGLES,
    "transmission_error": tuple(ANGLE_UNITS),
    "axial_mm": tuple(LENGTH_UNITS),
    "torque": ("nm",),
    "speed": tuple(SPEED_UNITS),
    "acceleration": tuple(ACCELERATION_UNITS),
}
_SPELLINGS = {
    **{"°": "deg", "″": "arcsec", "µrad": "urad", "μrad": "urad", "µs": "us", "μs": "us"},
    **{"°/s": "deg_per_s", "deg/s": "deg_per_s", "rad/s": "rad_per_s"},
    **{"1/min": "rpm", "r/min": "rpm", "n·m": "nm", "n*m": "nm", "n m": "nm"},
    **{f"{angle}/s{two}": "deg_per_s2" for angle in ("°", "deg") for two in ("2", "^2", "²")},
    **{f"rad/s{two}": "rad_per_s2" for two in ("2", "^2", "²")},
}
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_INDEX = re.compile(r"\((?:(\d+),:|:,(\d+))\)$")
_NUMBER = re.compile(r"#([1-9]\d{0,5})")

ROW = "#row"
"""Name of the row's number 0, 1, 2, … as a column."""


def units_of(role: str) -> Sequence[str]:
    """Units a role can be written in."""
    return _UNITS.get(role, ())


def name_and_unit(name: str, units: Sequence[str], where: str) -> tuple[str, str | None]:
    """Split `driving_deg`, `driving [deg]` or `driving (deg)` into "driving" and "deg".

    **Raises** `LogError` where suffix and bracket differ.
    """
    bracket = _BRACKET.search(name)
    stem = name[: bracket.start()] if bracket else name
    inside = bracket[1].lower() if bracket else None
    inside = _SPELLINGS.get(inside or "", inside)
    if inside not in units:
        inside = None
    stem, suffix = stem.strip(), None
    for unit in sorted(units, key=len, reverse=True):  # `_rad_per_s` before `_s`
        if stem.lower().endswith(f"_{unit}"):
            stem, suffix = stem[: -len(unit) - 1], unit
            break
    if suffix and stem.lower().endswith("_per"):  # `_deg_per_s` is no time in s
        stem, suffix = f"{stem}_{suffix}", None
    if suffix and inside and suffix != inside:
        raise LogError(f"the name says both {suffix} and {inside}; rename the column.", where=where)
    return stem, suffix or inside


def number_of(name: str | None) -> int:
    """3 for `#3`, the third column; 0 for a name that is no number."""
    found = _NUMBER.fullmatch(name or "")
    return int(found[1]) if found else 0


def index_of(name: str, role: str, names: Sequence[str], source: str) -> int:
    """Index of a column: by its number, its exact name, without case or unit, or its last parts.

    `b.t` and `t` are last parts of `a.b.t` and of `a/b/t`.

    **Raises** `LogError` where none or several columns fit.
    """
    if number := number_of(name):
        return _index_of_number(number, name, names, source)
    wanted = _plain(name)
    tests = (
        lambda one: one == name,
        lambda one: _plain(one) == wanted,
        lambda one: _plain(str(name_and_unit(one, units_of(role), source)[0])) == wanted,
        lambda one: bool(re.search(rf"[/\\.]{re.escape(wanted)}$", _plain(one))),
        lambda one: bool(re.search(rf"(^|[/\\.]){re.escape(wanted)}$", _plain(_whole(one)))),
    )
    for test in tests:
        hits = [k for k, one in enumerate(names) if test(one)]
        if len(hits) == 1:
            return hits[0]
        if hits:
            found = [names[k] for k in hits]
            cure = "rename one" if len(set(found)) < len(found) else "write out the one meant"
            raise LogError(
                f"{len(hits)} columns fit `{name}` ({listed(found)}); {cure}.", where=source
            )
    raise missing(role, names, source, name)


def _index_of_number(number: int, name: str, names: Sequence[str], source: str) -> int:
    if name in names and names.index(name) != number - 1:
        raise LogError(
            f"`{name}` is column {number} or the one with that name; rename that one.",
            where=source,
        )
    if number > len(names):
        raise LogError(
            f"no column {name}; the log has {len(names)} ({listed(names)}).", where=source
        )
    return number - 1


def default_column(role: str, names: Sequence[str], source: str) -> int | None:
    """Column a role has by its default name, None where there is none; two are an error."""
    hits: list[int] = []
    parts: list[int] = []
    for k, name in enumerate(names):
        stem, unit = name_and_unit(name, units_of(role), f"{source}: column `{name}`")
        if unit is None and role != "time" and stem != name:
            continue
        if stem.lower() == role:
            hits.append(k)
        elif re.split(r"[/\\.]", stem)[-1].lower() == role:
            parts.append(k)
    hits = hits or parts
    if len(hits) > 1:
        raise LogError(
            f"{len(hits)} columns could be `{role}` ({listed([names[k] for k in hits])}); name"
            f" one with --column {role}=NAME or in [log].",
            where=source,
        )
    return hits[0] if hits else None


def missing(role: str, names: Sequence[str], source: str, name: str | None = None) -> LogError:
    """The error for a column that is not there, with what is."""
    patterns = {"time": "time_s", "driven": "driven_* or transmission_error_*"}
    wanted = name or patterns.get(role, f"{role}_*")
    close = difflib.get_close_matches(name or role, names, 1, 0.5)
    hint = f" (closest: {close[0]})" if close else ""
    rate = ", or give --sample-rate" if role == "time" else ""
    return LogError(
        f"no column {wanted}; the log has {listed(names)}{hint}; name it with --column"
        f" {role}=NAME or in [log]{rate}.",
        where=source,
    )


def listed(names: Iterable[str]) -> str:
    """The first dozen names; the columns of one matrix as `x(1…6,:)`."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name if _INDEX.search(name) is None else _whole(name), []).append(name)
    shown = []
    for whole, members in groups.items():
        first, last = _INDEX.search(members[0]), _INDEX.search(members[-1])
        if first is None or last is None or len(members) == 1:
            shown += members
        elif first[1]:
            shown.append(f"{whole}({first[1]}…{last[1]},:)")
        else:
            shown.append(f"{whole}(:,{first[2]}…{last[2]})")
    more = f" and {len(shown) - 12} more" if len(shown) > 12 else ""
    return ", ".join(shown[:12]) + more


def _whole(name: str) -> str:
    """`x` for `x(3,:)`, the matrix a column is of."""
    return _INDEX.sub("", name)


def _plain(name: str) -> str:
    """Without case, blanks and the leading slash of a path."""
    return name.lower().replace(" ", "").removeprefix("/")
