"""Names of columns: roles, units, other quantities, setpoints, and a column by its name.

The words are those of common languages, and a unit may stand in the name or in a row of units. A
word with another meaning in a second language is not in the lists: an unknown word leads to a
question to the user, but a wrong word leads to a wrong role.
"""

import difflib
import re
import tomllib
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

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
    "command",
)
"""Roles that the option `--column role=name` accepts."""

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "100ns": 1e-7, "d": 86400.0}
TIME_UNITS |= {"min": 60.0, "h": 3600.0}
"""Seconds in one of each unit of time."""

SPEED_UNITS = {"rpm": ANGLE_UNITS["rev"] / 60, "deg_per_s": ANGLE_UNITS["deg"], "rad_per_s": 1.0}
"""Angular speed in rad/s of one of each unit of speed."""

ACCELERATION_UNITS = {"deg_per_s2": ANGLE_UNITS["deg"], "rad_per_s2": 1.0}
"""Angular acceleration in rad/s² of one of each unit of acceleration."""

ANGLES = ("counts", *ANGLE_UNITS)
SHAFT_UNITS = (*ANGLES, *LENGTH_UNITS)

_UNITS = {
    "time": tuple(TIME_UNITS),
    **dict.fromkeys(("driving", "driven", "command"), SHAFT_UNITS),
    "transmission_error": (*ANGLE_UNITS, *LENGTH_UNITS),
    "axial_mm": tuple(LENGTH_UNITS),
    "torque": ("nm",),
    "speed": tuple(SPEED_UNITS),
    "acceleration": tuple(ACCELERATION_UNITS),
}
_WORDS_OF = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
"""Words for roles, other quantities and setpoints, and spellings of units."""

_SPELLINGS = {
    text: unit for unit, texts in _WORDS_OF["spellings"].items() for text in texts.split(", ")
}
OTHER_UNITS = frozenset(_WORDS_OF["other_units"].split())
"""Units of quantities other than angle and time, in lower case."""

_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_QUOTIENT = re.compile(
    r"(?:\s*[/,]\s*(°|deg|[mµμu]?rad|gon|arcsec|arcmin|[″\"′']|[mµμu]m|m?s)"
    r"|(?<=\w)\s+(°|deg|gon|arcsec|arcmin|[″\"′']))\s*$"
)
"""Unit at the end of a name, behind a solidus, a comma or a blank."""
_LAST_WORD = re.compile(r"(.*?)[\s_/]*[\[(]?\s*([^\s_/\[\]()]+)\s*[\])]?")
_INNER = re.compile(r"(.*?)\s*[\[(]\s*([^()\[\]]*?)\s*[\])]\s*([^()\[\]\s][^()\[\]]*)")
"""Name with a bracket inside, such as `Deviation (arcsec) run 1`."""

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
    """Split `driving_deg`, `driving [deg]`, `driving (deg)` or `driving/deg` into name and unit.

    The unit is None if the name has none of `units`, or if it has a scale such as `motor_milli_deg`
    or `motor x1000 [deg]`. `where` is the position for messages.

    **Raises** `LogError` if the name has two units that differ, such as a suffix and a bracket.
    """
    stem, inside = _without_bracket(name)
    stem, suffix, inside = stem.strip(), None, inside if inside in units else None
    rest, earlier = _without_bracket(stem)
    if earlier in units:  # the name has a unit, and the row of units below it another one
        stem, suffix = rest.strip(), earlier
    for unit in sorted(units, key=len, reverse=True):  # tests `_rad_per_s` before `_s`
        ends = stem.lower().endswith(f"_{unit}")
        if ends and (unit not in ("min", "h") or _TIME.match(stem)):  # `motor_min` is the lowest
            stem, suffix = stem[: -len(unit) - 1], unit
            break
    if suffix is None and "rev" in units and stem.lower().endswith(("_turns", "_revs")):
        stem, suffix = stem.rpartition("_")[0], "rev"
    if suffix and stem.lower().endswith("_per"):  # `_deg_per_s` is not a time in s
        stem, suffix = f"{stem}_{suffix}", None
    if unit_spelt(name) in ("s", "ms", "us", "ns"):  # a unit of time is the whole name
        suffix = unit_spelt(name)
    if suffix and inside and suffix != inside:
        raise LogError(f"the name has the units {suffix} and {inside}; keep one.", where=where)
    return stem, None if scale_of(stem) else suffix or inside


def _unit_last(name: str) -> str:
    """Return a name with its unit in brackets at the end: `TE [deg]` for `TE / deg`."""
    inner = _INNER.fullmatch(name)
    if inner and unit_in(inner[2]):
        return f"{inner[1]} {inner[3]} [{inner[2]}]"
    return _QUOTIENT.sub(r" [\1\2]", name)


def stem_and_unit(name: str) -> tuple[str, str]:
    """Split a name into its stem and the unit in its last word, which is a bracket or not."""
    found = _LAST_WORD.fullmatch(name.strip())
    return (found[1], unit_spelt(found[2])) if found else (name, "")


def scale_of(name: str) -> str:
    """Return the power of ten, or the word for it, that a name has beside its unit, or ""."""
    found = _SCALE.search(name)
    return found[0].strip(" _") if found else ""


def bracket_of(name: str) -> str:
    """Return the unit at the end of a name, in brackets or behind a solidus, as it is spelt."""
    return _without_bracket(name)[1]


def _without_bracket(name: str) -> tuple[str, str]:
    """Return a name without the unit at its end, and this unit as `bracket_of` does."""
    name = _unit_last(name)
    bracket = _BRACKET.search(name)
    return (name[: bracket.start()], unit_spelt(bracket[1])) if bracket else (name, "")


def unit_spelt(text: str) -> str:
    """Return a unit in the spelling of this package, `deg` for `°`; unknown units in lower case."""
    text = text.strip().lower().rstrip(".")
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
    if stated is not None and written is not None and stated != written:
        raise LogError(
            f"the name has the unit {written}, but [unit] {role} has {stated}; correct one.",
            where=where,
        )
    unit = written or stated
    if unit is None:
        cure = f"_deg, _arcsec, …, or state the unit (--unit {role}=UNIT, `{role}` in [unit])"
        cure = _SUFFIXES.get(role, cure)
        raise LogError(f"this column has no unit; end the name with {cure}.", where=where)
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
        if name in names and names.index(name) != number - 1:
            raise LogError(
                f"`{name}` is the number of a column and the name of another; rename the latter.",
                where=source,
            )
        if number > len(names):
            told = f"there is no column {name}; the log has {len(names)} ({listed(names)})."
            raise LogError(told, where=source)
        return number - 1
    wanted = _normalised(name)
    end = re.escape(wanted) + "$"
    tests = (
        lambda column: column == name,
        lambda column: _normalised(column) == wanted,
        lambda column: _normalised(name_and_unit(column, units_of(role), source)[0]) == wanted,
        lambda column: re.search(rf"[/\\.]{end}", _normalised(column)),
        lambda column: re.search(rf"(^|[/\\.]){end}", _normalised(matrix_name(column))),
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
        groups.setdefault(matrix_name(name), []).append(name)
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


def matrix_name(name: str) -> str:
    """Return the name of the matrix of a column: `x` for `x(3,:)`."""
    return _INDEX.sub("", name)


def _normalised(name: str) -> str:
    """Return a name in lower case without blanks and without the leading slash of a path."""
    return name.lower().replace(" ", "").removeprefix("/")


NO_UNITS = frozenset(("", "-", "–", "none", "(none)", "n/a", "1", "sequence"))
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
    return all(unit_in(field) is not None for field in fields) and any(map(unit_in, fields))


def with_units(names: Sequence[str], fields: Sequence[str]) -> list[str]:
    """Return the names with the units in brackets; `fields` is the row of units below the names."""
    padded = [*fields, *[""] * (len(names) - len(fields))]
    return [
        f"{name} [{field.strip().strip('[]()')}]".strip() if unit_in(field) else name
        for name, field in zip(names, padded, strict=False)
    ]


def fold(text: str) -> str:
    """Return a text in lower case without accents."""
    decomposed = unicodedata.normalize("NFKD", text.casefold())
    plain = "".join(letter for letter in decomposed if not unicodedata.combining(letter))
    return unicodedata.normalize("NFC", plain)  # joins Korean syllables again


_SETS = {
    key: frozenset(fold(text).split()) for key, text in _WORDS_OF.items() if isinstance(text, str)
}
DRIVING, DRIVEN, OUTPUT_SIDE, TIME, QUANTITIES, SETPOINTS = (
    _SETS[key] for key in ("driving", "driven", "output_side", "time", "quantities", "setpoints")
)
DIRECTION, TURNING, BACKLASH, ERRORS, _OF_TRANSMISSION, _STATISTICS, _UP, _DOWN = (
    _SETS[key]
    for key in (
        *("direction", "turning", "backlash", "errors", "transmission_error", "statistics"),
        *("rising", "falling"),
    )
)
"""Words for the shafts and for time; words such as `joint`, which are the driven shaft where no
other name says it; words for other quantities, and for angles that were not measured; names of a
column of directions, directions whose sense depends on the side from which one looks, names of
readings of the backlash, of errors and of the transmission error, and of statistics."""
QUANTITIES |= ERRORS

WAYS = dict.fromkeys(_UP, 1.0) | dict.fromkeys(_DOWN, -1.0)
"""Word for a direction → +1 for rising positions, −1 for falling ones."""


_KNOWN_WORDS = frozenset().union(*_SETS.values())


def known_words(text: str) -> int:
    """Return how many words of a text have letters beyond ASCII, and are in the lists."""
    words = [word for word in _WORDS.findall(text) if len(word) > 1 and not word.isascii()]
    wide = [word for word in words if _WIDE.search(word)]
    parts = sum(any(one in word for one in _KNOWN_WORDS if _WIDE.search(one)) for word in wide)
    return parts + sum(fold(word) in _KNOWN_WORDS for word in words if word not in wide)


def is_statistic(name: str) -> bool:
    """Return whether a name says what follows from several readings, their mean or reversal."""
    return not (_STATISTICS | BACKLASH).isdisjoint(words_of(name))


def has_time(names: Iterable[str]) -> bool:
    """Return whether one of these names has a word for time."""
    return not TIME.isdisjoint(word for name in names for word in words_of(name))


def ways_in(name: str) -> set[float]:
    """Return the senses of the words for directions in the name of a reading.

    A single letter is none: `F` and `R` are a force and a radius too.
    """
    words = [word for word in (*words_of(name), *name.split()) if word != "pos"]
    said = [word for word in words if len(word) > 1 or not word.isalpha()]
    wide = {one for one in WAYS if len(one) > 1 and _WIDE.search(one) and one in name}
    return {WAYS[word] for word in (*said, *wide) if word in WAYS}


def first_way(words: Sequence[str]) -> str:
    """Return the first of these words if all are directions, and of both senses, or ""."""
    return words[0] if {WAYS.get(fold(word)) for word in words} == {1, -1} else ""


def is_error(name: str) -> bool:
    """Return whether a name says an error of an angle: `Deviation`, `Ist-Soll`."""
    return bool(_found(words_of(name), ERRORS)) or len({*_sides(name)}) == 2


def is_setpoint_first(name: str) -> bool:
    """Return whether a name says a setpoint minus what was measured, as `Soll-Ist` does."""
    return _sides(name) == [True, False]


def _sides(name: str) -> list[bool]:
    """Return for each side of a minus in a name whether it is a setpoint; [] without both sides."""
    sides = [words_of(part) for part in name.partition("-" if "-" in name else "−")[::2]]
    return [not SETPOINTS.isdisjoint(words) for words in sides] if all(sides) else []


def is_transmission_error(name: str, where: str) -> bool:
    """Return whether a name says the transmission error and its unit: `TE [µm]`, not `Te [Nm]`."""
    words = words_of(name)
    said = not _OF_TRANSMISSION.isdisjoint(words) or {"transmission", "error"} <= {*words}
    return said and name_and_unit(name, _UNITS["transmission_error"], where)[1] is not None


COMPOUND: Final = 5
"""Least number of letters of a word that is also searched inside a longer word, such as `drehzahl`
in `motordrehzahl`; a word for a role must be at the start or end of the longer word (chosen)."""

SHORT: Final = 4
"""Least number of letters of a word for another quantity that is joined to a word for a shaft, such
as `temp` in `motortemp` (chosen)."""

_KNOWN = {**dict.fromkeys(DRIVING, "driving"), **dict.fromkeys(DRIVEN, "driven")}
_KNOWN |= dict.fromkeys(TIME, "time")
_COMPOUNDS = [one for one, role in _KNOWN.items() if len(one) >= COMPOUND and role != "time"]
_LONGEST_FIRST = sorted((one for one in DRIVING | DRIVEN if len(one) >= SHORT), key=len)[::-1]
_PARTS = re.compile(r"[/\\.:]+")
_CAMEL = re.compile(r"(?<=[a-zß-ÿ0-9])(?=[A-ZÀ-Þ])|(?<=[A-Z])(?=[A-Z][a-z])")
_WORDS = re.compile(r"[^\W\d_]+")
_NUMBERED = re.compile(r"(?<![^\W_])[^\W\d_]\d+(?![^\W_])")
_WIDE = re.compile(r"[\u1100-\u11ff\u2e80-\uffef]")


@dataclass(frozen=True)
class NameReading:
    """Meaning of one column name.

    **Arguments**
    - `role`: "driving", "driven" or "time", or None if the name contains none or two of them.
    - `unit`: unit of an angle or of time in the name, or None.
    - `other`: word or unit in the name for a quantity other than angle and time, "" if none.
    - `setpoint`: word for a setpoint in the name, "" if there is none.
    - `output_side`: whether a name without a role has a word such as `joint`.
    """

    role: str | None
    unit: str | None
    other: str
    setpoint: str
    output_side: bool = False

    @property
    def is_angle(self) -> bool:
        """Whether the name allows that the column is the angle of a shaft."""
        return self.role != "time" and not self.other and self.unit not in TIME_UNITS


def read_name(name: str, where: str, units: Sequence[str] = ANGLES) -> NameReading:
    """Return role, unit, other quantity and setpoint that the name of a column contains.

    Slashes, dots and colons divide a name into parts, as in `rec/motor.pos`. The role comes from
    the last part, or from the whole name if the last part has no role. A name with two different
    roles gets no role. `where` names file and column in error messages; `units` are those of a
    shaft.

    **Raises** `LogError` if the name has two different units.
    """
    stem, unit = name_and_unit(name, (*units, *TIME_UNITS), where)
    inside = bracket_of(name)
    other = inside if unit is None and inside in OTHER_UNITS else ""
    last = [part for part in _PARTS.split(stem) if part.strip()][-1:]
    # `n1` in `n1_motor_pos` numbers a node; alone it is a speed.
    words = words_of(_NUMBERED.sub("", "".join(last))) or words_of("".join(last))
    quantities = _found(words, QUANTITIES)
    if unit in ANGLES and quantities in OTHER_UNITS:  # such as Hz [gon], a horizontal direction
        quantities = ""
    role = _role(words) or _role(words_of(stem))
    if role == "time" and other:  # `T_Gehäuse (°C)`
        role = None
    if unit in TIME_UNITS and role in ("driving", "driven"):
        role = None
    every = words_of(stem)
    setpoint = _found(every, SETPOINTS)
    output_side = role is None and not OUTPUT_SIDE.isdisjoint(every)
    return NameReading(role, unit, other or quantities, setpoint, output_side)


def words_of(text: str) -> list[str]:
    """Return the words of a name in lower case; `MotorPos_deg` gives motor, pos and deg."""
    return [fold(word) for word in _WORDS.findall(_CAMEL.sub(" ", text))]


def inputs_and_outputs(names: Sequence[str]) -> dict[int, str]:
    """Return index → role for names that differ only by `in` (driving) and `out` (driven)."""
    words = [words_of(name) for name in names]
    roles: dict[int, str] = {}
    for k, own in enumerate(words):
        if own.count("in") != 1:
            continue
        twin = ["out" if word == "in" else word for word in own]
        if words.count(own) == 1 and words.count(twin) == 1:
            roles |= {k: "driving", words.index(twin): "driven"}
    return roles


def _role(words: Iterable[str]) -> str | None:
    """Return the role of the words, or None if they have no role or several roles."""
    roles = {role for word in words for role in _roles_of(word)}
    return roles.pop() if len(roles) == 1 else None


def _roles_of(word: str) -> set[str]:
    """Return the roles of one word, from the known words that it contains.

    A longer known word has priority over a shorter one that is a part of it.
    """
    if word in _KNOWN:
        return {_KNOWN[word]}
    found = [one for one in _COMPOUNDS if word.startswith(one) or word.endswith(one)]
    if _WIDE.search(word):
        found = [one for one in _KNOWN if _WIDE.search(one) and one in word]
    roles = set()
    for known in sorted(found, key=len, reverse=True):
        if known in word:
            roles.add(_KNOWN[known])
            word = word.replace(known, " ")  # 被駆動 contains 駆動, which means the opposite
    return roles


def _found(words: Iterable[str], known: frozenset[str]) -> str:
    """Return the first of `words` that is in `known` or contains a word of `known`, or ""."""
    for word in words:
        if word in known or any(_holds(word, one) for one in known):
            return word
    return ""


def _holds(word: str, known: str) -> bool:
    """Return whether `word` is a compound that contains the known word `known`.

    A short known word counts only next to a word for a shaft: `motortemp`, but not `temps`.
    """
    if known not in word:
        return False
    if _WIDE.search(known) or len(known) >= COMPOUND:
        return True
    shafts = (one for one in _LONGEST_FIRST if word.startswith(one) or word.endswith(one))
    shaft = next(shafts, "")
    if not shaft or len(known) < SHORT:
        return False
    rest = word.replace(shaft, "")
    starts = rest.startswith(known) or rest.startswith(f"s{known}")  # Antriebssoll has an s between
    return starts or rest.endswith(known)
