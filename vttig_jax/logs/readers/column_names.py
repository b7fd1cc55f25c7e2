"""Roles of columns, units in their names or in a row of units, and a column by its name."""

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ...base.errors import LogError
from ...base.units import ANGLE_UNITS, LENGTH_UNITS

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

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "100ns": 1e-7, "d": 86400.0}
TIME_UNITS |= {"min": 60.0, "h": 3600.0}
"""Seconds in one of each unit of time."""

SPEED_UNITS = {
    "rpm": ANGLE_UNITS["rev"] / 60,
    "deg_per_s": ANGLE_UNITS["deg"],
    "rad_per_s": 1.0,
}
"""Angular speed in rad/s of one of each unit of speed."""

ACCELERATION_UNITS = {"deg_per_s2": ANGLE_UNITS["deg"], "rad_per_s2": 1.0}
"""Angular acceleration in rad/s² of one of each unit of acceleration."""

ANGLES = ("counts", *ANGLE_UNITS)
SHAFT_UNITS = (*ANGLES, *LENGTH_UNITS)

_UNITS = {
    "time": tuple(TIME_UNITS),
    "driving": SHAFT_UNITS,
    "driven": SHAFT_UNITS,
    "transmission_error": tuple(ANGLE_UNITS),
    "axial_mm": tuple(LENGTH_UNITS),
    "torque": ("nm",),
    "speed": tuple(SPEED_UNITS),
    "acceleration": tuple(ACCELERATION_UNITS),
}
_SPELLINGS = {
    **{
        "°": "deg",
        "″": "arcsec",
        "′": "arcmin",
        "m°": "mdeg",
        "µrad": "urad",
        "μrad": "urad",
        "µs": "us",
        "μs": "us",
        "µm": "um",
        "μm": "um",
    },
    **dict.fromkeys(("º", "degree", "degrees", "degs", "grados", "gradi", "graus"), "deg"),
    **dict.fromkeys(("radian", "radians", "radiant"), "rad"),
    **dict.fromkeys(("turn", "turns", "revs", "revolution", "revolutions", "umdr", "tr"), "rev"),
    **dict.fromkeys(("count", "cnt", "cts", "inc", "incr", "ink", "inkr"), "counts"),
    **dict.fromkeys(("increments", "inkremente", "pulses", "ticks", "impulse"), "counts"),
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunden"), "s"),
    **{"msec": "ms", "millis": "ms", "usec": "us", "nsec": "ns", "days": "d", "tage": "d"},
    **{"°/s": "deg_per_s", "deg/s": "deg_per_s", "rad/s": "rad_per_s"},
    **{"1/min": "rpm", "r/min": "rpm", "n·m": "nm", "n*m": "nm", "n m": "nm"},
    **{f"{angle}/s{two}": "deg_per_s2" for angle in ("°", "deg") for two in ("2", "^2", "²")},
    **{f"rad/s{two}": "rad_per_s2" for two in ("2", "^2", "²")},
}
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_POWER = r"(?:1e[+-]?\d+|10+|0[.,]0*1)"
_SCALE = re.compile(
    rf"[x×*·]\s*{_POWER}(?![\d.])|(?<![\d.]){_POWER}\s*[x×*·]|(?<![^\W_])1e-?\d+|1/10+|10\^-?\d"
    r"|(?<![^\W_])(?:milli|micro|mikro|kilo|centi|zenti|deci|dezi|nano|tenths?|hundredths?"
    r"|thousandths?|zehntel|hundertstel|tausendstel|scaled|skaliert)(?![^\W_])",
    re.IGNORECASE,
)
"""Power of ten or a word for it in a name: the numbers are then no multiples of the unit alone."""

_TIME = re.compile("t_|time|zeit|temps|elapsed|clock", re.IGNORECASE)
_INDEX = re.compile(r"\((?:(\d+),:|:,(\d+))\)$")
_NUMBER = re.compile(r"#([1-9]\d{0,5})")

ROW = "#row"
"""Name of the column with the row numbers 0, 1, 2, …."""


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


def units_of(role: str) -> Sequence[str]:
    """Return the units that a column with the role `role` can have."""
    return _UNITS.get(role, ())


def name_and_unit(name: str, units: Sequence[str], where: str) -> tuple[str, str | None]:
    """Split `driving_deg`, `driving [deg]` or `driving (deg)` into name "driving" and unit "deg".

    The unit is None if the name has none of `units`, or if it has a scale such as `motor_milli_deg`
    or `motor x1000 [deg]`. `where` is the position for messages.

    **Raises** `LogError` if the name has two units that differ, such as a suffix and a bracket.
    """
    bracket = _BRACKET.search(name)
    stem = name[: bracket.start()] if bracket else name
    inside = bracket_of(name)
    if inside not in units:
        inside = None
    stem, suffix = stem.strip(), None
    earlier = bracket_of(stem)  # the name has a unit, and the row of units below it another one
    if earlier in units:
        stem, suffix = stem[: _BRACKET.search(stem).start()].strip(), earlier  # pyright: ignore
    for unit in sorted(units, key=len, reverse=True):  # tests `_rad_per_s` before `_s`
        ends = stem.lower().endswith(f"_{unit}")
        if ends and (unit not in ("min", "h") or _TIME.match(stem)):  # `motor_min` is the lowest
            stem, suffix = stem[: -len(unit) - 1], unit
            break
    if suffix and stem.lower().endswith("_per"):  # `_deg_per_s` is not a time in s
        stem, suffix = f"{stem}_{suffix}", None
    if suffix and inside and suffix != inside:
        raise LogError(f"the name has the units {suffix} and {inside}; keep one.", where=where)
    return stem, None if scale_of(stem) else suffix or inside


def scale_of(name: str) -> str:
    """Return the power of ten, or the word for it, that a name has beside its unit, or ""."""
    found = _SCALE.search(name)
    return found[0].strip(" _") if found else ""


def bracket_of(name: str) -> str:
    """Return the text in the bracket at the end of a name, in the spelling of a unit, or ""."""
    bracket = _BRACKET.search(name)
    return unit_spelt(bracket[1]) if bracket else ""


def unit_spelt(text: str) -> str:
    """Return a unit in the spelling of this package, `deg` for `°`; unknown units in lower case."""
    text = text.strip().lower()
    return _SPELLINGS.get(text, text)


def unit_of(role: str, name: str, stated: str | None, where: str) -> str:
    """Return the unit that the column name states, or that is `stated` beside it; "" without unit.

    **Raises** `LogError` if both state different units, if a required unit is missing, or if the
    role cannot have this unit.
    """
    written = name_and_unit(name, units_of(role), where)[1]
    if role == "time" and stated is None:
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


def number_of(name: str | None) -> int:
    """Return the column number in a name, 3 for `#3` (the third column), or 0 for other names."""
    match = _NUMBER.fullmatch(name or "")
    return int(match[1]) if match else 0


def index_of(name: str, role: str, names: Sequence[str], source: str) -> int:
    """Return the index of the column that `name` means: a number, a name, or the end of a path.

    An exact match is preferred to a match that differs in case, blanks or unit. `b.t` and `t` are
    ends of the paths `a.b.t` and `a/b/t`.

    **Raises** `LogError` if no column or several columns match.
    """
    if number := number_of(name):
        return _index_of_number(number, name, names, source)
    wanted = _normalised(name)
    end = re.escape(wanted) + "$"
    tests = (
        lambda column: column == name,
        lambda column: _normalised(column) == wanted,
        lambda column: _normalised(name_and_unit(column, units_of(role), source)[0]) == wanted,
        lambda column: re.search(rf"[/\\.]{end}", _normalised(column)),
        lambda column: re.search(rf"(^|[/\\.]){end}", _normalised(_matrix_name(column))),
    )
    for test in tests:
        matches = [k for k, column in enumerate(names) if test(column)]
        if len(matches) == 1:
            return matches[0]
        if matches:
            same = [names[k] for k in matches]
            cure = "rename one" if len(set(same)) < len(same) else "write the full name"
            raise LogError(
                f"{len(matches)} columns fit `{name}` ({listed(same)}); {cure}.", where=source
            )
    close = difflib.get_close_matches(name, names, 1, 0.5)
    hint = f" (closest: {close[0]})" if close else ""
    rate = ", or give --sample-rate" if role == "time" else ""
    raise LogError(
        f"there is no column {name}; the log has {listed(names)}{hint}; name it with --column"
        f" {role}=NAME or in [log]{rate}.",
        where=source,
    )


def _index_of_number(number: int, name: str, names: Sequence[str], source: str) -> int:
    if name in names and names.index(name) != number - 1:
        raise LogError(
            f"`{name}` is the number of a column and the name of another; rename the latter.",
            where=source,
        )
    if number > len(names):
        raise LogError(
            f"there is no column {name}; the log has {len(names)} ({listed(names)}).", where=source
        )
    return number - 1


def default_column(role: str, names: Sequence[str], source: str) -> int | None:
    """Return the index of the column with the default name of a role, or None.

    **Raises** `LogError` if several columns have this name.
    """
    matches: list[int] = []
    path_matches: list[int] = []
    for k, name in enumerate(names):
        stem, unit = name_and_unit(name, units_of(role), f"{source}: column `{name}`")
        if unit is None and role != "time" and stem != name:
            continue
        if stem.lower() == role:
            matches.append(k)
        elif re.split(r"[/\\.]", stem)[-1].lower() == role:
            path_matches.append(k)
    matches = matches or path_matches
    if len(matches) > 1:
        raise LogError(
            f"{len(matches)} columns could be `{role}` ({listed([names[k] for k in matches])});"
            f" name one with --column {role}=NAME or in [log].",
            where=source,
        )
    return matches[0] if matches else None


def listed(names: Iterable[str]) -> str:
    """Return the first twelve names as text; columns of one matrix are joined as `x(1…6,:)`."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(_matrix_name(name), []).append(name)
    shown = []
    for matrix, members in groups.items():
        first, last = _INDEX.search(members[0]), _INDEX.search(members[-1])
        if first is None or last is None or len(members) == 1:
            shown += members
        elif first[1]:
            shown.append(f"{matrix}({first[1]}…{last[1]},:)")
        else:
            shown.append(f"{matrix}(:,{first[2]}…{last[2]})")
    more = f" and {len(shown) - 12} more" if len(shown) > 12 else ""
    return ", ".join(shown[:12]) + more


def _matrix_name(name: str) -> str:
    """Return the name of the matrix of a column: `x` for `x(3,:)`."""
    return _INDEX.sub("", name)


def _normalised(name: str) -> str:
    """Return a name in lower case without blanks and without the leading slash of a path."""
    return name.lower().replace(" ", "").removeprefix("/")


_OTHER = """
    nm n·m n*m mnm a ma ka v mv kv w kw mw °c degc c k f °f % bar mbar pa kpa mpa psi n kn mm
    m cm um µm μm nm/a hz khz mhz rpm 1/min min-1 r/min u/min rev/min rad/s deg/s °/s rev/s
    rad/s2 rad/s^2 rad/s² deg/s2 deg/s^2 deg/s² °/s2 °/s^2 °/s² m/s m/s2 m/s^2 m/s² mm/s g kg
    ohm db lux ppm px pixel pixels bit bool °c/s deg_per_s rad_per_s deg_per_s2 rad_per_s2 min
    h inch in lb lbf ft degf mil volt volts ampere amperes
"""

OTHER_UNITS = frozenset(_OTHER.split())
"""Units of quantities other than angle and time, in lower case."""

NO_UNITS = frozenset(("", "-", "–", "none", "(none)", "n/a", "1"))
"""Fields in a row of units that mean "no unit"."""

_BRACKETS = {"[": "]", "(": ")"}


def unit_in(field: str) -> str | None:
    """Return the unit in a field of a row of units.

    It is "" for a field that means "no unit", and None for a field that is not a unit.
    """
    text = field.strip()
    if text[:1] in _BRACKETS and text.endswith(_BRACKETS[text[0]]):
        text = text[1:-1]
    unit = unit_spelt(text)
    if unit in NO_UNITS:
        return ""
    return unit if unit in OTHER_UNITS or unit in (*ANGLES, *TIME_UNITS) else None


def is_units_row(fields: Sequence[str]) -> bool:
    """Return whether every field is a unit or means "no unit", and at least one is a unit."""
    units = []
    for field in fields:
        units.append(unit_in(field))
        if units[-1] is None:
            return False
    return any(units)


def with_units(names: Sequence[str], fields: Sequence[str]) -> list[str]:
    """Return the names with the units in brackets; `fields` is the row of units below the names."""
    padded = [*fields, *[""] * (len(names) - len(fields))]
    return [
        f"{name} [{field.strip().strip('[]()')}]" if unit_in(field) else name
        for name, field in zip(names, padded, strict=False)
    ]
