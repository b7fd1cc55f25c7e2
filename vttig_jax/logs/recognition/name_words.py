"""Meaning of a column name: its role, unit, another quantity, or a setpoint."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..readers.column_names import ANGLES, TIME_UNITS, bracket_of, name_and_unit
from ..readers.units_row import OTHER_UNITS
from .vocabulary import COMPOUND, DRIVEN, DRIVING, QUANTITIES, SETPOINTS, SHORT, TIME, fold

_ROLE_WORDS = {"driving": DRIVING, "driven": DRIVEN, "time": TIME}
_KNOWN = {word: role for role, words in _ROLE_WORDS.items() for word in words}
_LONGEST_FIRST = sorted((one for one in DRIVING | DRIVEN if len(one) >= SHORT), key=len)[::-1]
_PARTS = re.compile(r"[/\\.:]+")
_CAMEL = re.compile(r"(?<=[a-zß-ÿ0-9])(?=[A-ZÀ-Þ])|(?<=[A-Z])(?=[A-Z][a-z])")
_WORDS = re.compile(r"[^\W\d_]+")
_WIDE = re.compile(r"[\u1100-\u11ff\u2e80-\uffef]")


@dataclass(frozen=True)
class NameReading:
    """Meaning of one column name.

    **Arguments**
    - `role`: "driving", "driven" or "time", or None if the name contains none or two of them.
    - `unit`: unit of an angle or of time in the name, or None.
    - `other`: word or unit in the name for a quantity other than angle and time, "" if none.
    - `setpoint`: word for a setpoint in the name, "" if there is none.
    """

    role: str | None
    unit: str | None
    other: str
    setpoint: str

    @property
    def is_angle(self) -> bool:
        """Whether the name allows that the column is the angle of a shaft."""
        return self.role != "time" and not self.other and self.unit not in TIME_UNITS


def read_name(name: str, where: str) -> NameReading:
    """Return role, unit, other quantity and setpoint that the name of a column contains.

    Slashes, dots and colons divide a name into parts, as in `rec/motor.pos`. The role comes from
    the last part, or from the whole name if the last part has no role. A name with two different
    roles gets no role. `where` names file and column in error messages.

    **Raises** `LogError` if the name has two different units.
    """
    stem, unit = name_and_unit(name, (*ANGLES, *TIME_UNITS), where)
    inside = bracket_of(name)
    other = inside if unit is None and inside in OTHER_UNITS else ""
    last = [part for part in _PARTS.split(stem) if part.strip()][-1:]
    words = words_of("".join(last))
    quantities = _found(words, QUANTITIES)
    role = _role(words) or _role(words_of(stem))
    if unit in TIME_UNITS and role in ("driving", "driven"):
        role = None
    setpoint = _found(words_of(stem), SETPOINTS)
    return NameReading(role, unit, other or quantities, setpoint)


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
    wide = bool(_WIDE.search(word))
    found = [
        known
        for known in _KNOWN
        if (wide and _WIDE.search(known) and known in word)
        or (not wide and len(known) >= COMPOUND and _is_part(known, word))
    ]
    roles = set()
    for known in sorted(found, key=len, reverse=True):
        if known in word:
            roles.add(_KNOWN[known])
            word = word.replace(known, " ")  # 被駆動 contains 駆動, which means the opposite
    return roles


def _is_part(known: str, word: str) -> bool:
    return _KNOWN[known] != "time" and (word.startswith(known) or word.endswith(known))


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
