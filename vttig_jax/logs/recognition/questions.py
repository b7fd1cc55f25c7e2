"""Questions to the user where a log can be read in two ways, and notes on what was recognised.

Both are records; their sentences stand in the catalogues `QUESTIONS` and `GUESSES`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...base.errors import LogError, UsageError, VttigError
from .candidates import Candidate, listed_facts

_UNIT_OR_COUNTS = "give --unit deg (or rad, rev), or --counts A,B with the counts per revolution of"

QUESTIONS = {
    "several-columns": "{count} columns can be {role}: {facts}; choose one with {options}.",
    "only-a-setpoint": "the only column for {role} is `{a}`, and `{setpoint}` says a setpoint"
    " or a computed angle, which no encoder measured; name the measured column with --column"
    " {role}=NAME, or this one with --column {role}='{a}'.",
    "shafts-open": "no column name says {roles}, {why}; give {options}{seen}.",
    "driving-open": "no column name says driving; give --column driving=NAME, or, where a clock"
    " turns the driving shaft, --driving-rpm RPM (--driving-rpm sidereal for the worm of a"
    " telescope mount){seen}.",
    "several-pairs": "{number} pairs of columns have the given ratio: {pairs}; the columns are"
    " {facts}; choose with, for example, --column driving='{first}' --column driven='{second}'.",
    "named-speed": "the name `{a}` says {role}, but its values are the speed of `{b}`; name"
    " the angles with --column driving=NAME --column driven=NAME, such as --column"
    " {role}='{b}'.",
    "twin-columns": "`{a}` and `{b}` hold nearly the same angle, as a setpoint and a"
    " measured angle do; name the measured one with --column {role}='{b}' or --column"
    " {role}='{a}'.",
    "names-against-ratio": "the names say that `{a}` drives `{b}`, but these columns do not turn"
    " as given ({turns}), and `{c}` and `{d}` do; if those are the measured angles, give --column"
    " driving='{c}' --column driven='{d}', otherwise correct the ratio or name the columns with"
    " --column driving=NAME --column driven=NAME.",
    "ratio-of-two-readings": "--ratio {text} has two readings, and no column name tells the shafts"
    " apart: write --ratio {one} if {turns}, or --ratio {other_ratio} if {inverse}; or name both"
    " columns with --column driving=NAME --column driven=NAME.",
    "bare-ratio": "--ratio {text} may be meant as {other_ratio} or as {one}, and a curve of the"
    " transmission error does not show which: write --ratio {other_ratio} if {inverse}, or --ratio"
    " {one} if {turns}.",
    "opposite-directions": "`{a}` and `{b}` have the given ratio, but the readings of one"
    " grow while those of the other fall: one encoder counts backwards; {options}.",
    "no-unit": "the column {facts} for {role} names no unit, and degrees, radians and counts look"
    " the same; {options}.",
    "scaled-unit": "the name of the column {facts} for {role} holds a scale, `{scale}`: {options},"
    " or convert the column.",
    "no-counts": "the column `{a}` of {role} is in counts, and no log says how many make a"
    " turn; give {options}.",
    "no-lead": "the column {facts} for {role} is a length; {options}.",
    "unused-counts": "--counts is given, but no column is in counts; leave it out.",
    "no-time": "no column is certainly the time; give --column time=NAME, or --sample-rate"
    " HZ{seen}.",
    "two-clocks": "`{b}` has the stamps `{a}` and `{d}` has `{c}`, and the clocks run apart, so"
    " that no row holds one instant; interpolate one channel at the stamps of the other, or write"
    " both as a long table of time, channel and value, which is brought onto one clock.",
    "no-time-unit": "the time stamps are whole numbers without a unit, {facts}, and seconds and"
    " milliseconds look the same; give --unit time=s, ms, us or ns.",
    "unreadable-time": "the stamps of the time column `{a}` must be numbers, or dates such as"
    " 2026-11-30T12:00:00.25, and here {fault}; remove this line if it is no row of the table,"
    " name another column with --column time=NAME, or give --sample-rate HZ.",
    "days-or-seconds": "the time stamps, {facts}, may be days, as Excel and MATLAB count them, or"
    " seconds; give --unit time=d or --unit time=s.",
}
"""Slug of a question → its sentence, which names the options that decide."""

UNIT_TOO = f" No name states the unit of the angles either: {_UNIT_OR_COUNTS} both encoders."
"""What a question adds if the units of the shafts are open too."""

GUESSES = {
    "by-name": "column `{name}`, by its name",
    "by-ratio": "column `{name}`, the only one that has the given ratio",
    "same-stamps": "column `{name}`, the same stamps as `{other}`",
    "only-dates": "column `{name}`, the only one of dates or times",
    "grows-evenly": "column `{name}`, the only one that grows evenly",
    "epoch": "in {unit}, from the size of its stamps, {since}",
    "seconds": "column `{name}` in seconds, as its name states no unit",
}
"""Slug of a note → what was recognised, and the reason."""


class Question(VttigError):
    """Question that the user must answer, raised where no answer is stated.

    - `slug`: stable name of its kind in `QUESTIONS`. - `role`: role in question, or "".
    - `columns`: columns among which the answer is. - `options`: options that decide.
    """

    slug: str
    role: str
    columns: tuple[str, ...]
    options: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the record as an object for `--json`."""
        lists = {"columns": list(self.columns), "options": list(self.options)}
        return {"slug": self.slug, "role": self.role, **lists, "sentence": self.message}


class LogQuestion(Question, LogError):
    """Question about the columns of a log."""


class UsageQuestion(Question, UsageError):
    """Question about options that have two readings or no effect, at no place of a log."""


def ask(
    slug: str,
    where: str,
    *,
    role: str = "",
    columns: Sequence[Candidate] = (),
    options: Sequence[str] = (),
    **words: Any,
) -> Question:
    """Return a question; `words` are those of its sentence."""
    sentence = QUESTIONS[slug].format(
        role=role,
        count=len(columns),
        facts=columns[0].facts if len(columns) == 1 else listed_facts(columns),
        options=" or ".join(options),
        **dict(zip("abcd", (one.name for one in columns), strict=False)),
        **words,
    )
    asked = (LogQuestion if where else UsageQuestion)(sentence, where=where)
    asked.slug, asked.role, asked.options = slug, role, tuple(options)
    asked.columns = tuple(one.name for one in columns)
    return asked


@dataclass(frozen=True)
class Guess:
    """Column or unit of a role that was recognised and not stated by the user.

    `slug` is its kind in `GUESSES`, `taken` the choice with its reason, and `option` changes it.
    """

    slug: str
    role: str
    taken: str
    option: str

    @classmethod
    def of(cls, slug: str, role: str, option: str, **words: str) -> "Guess":
        """Return a guess; `words` are those of its sentence."""
        return cls(slug, role, GUESSES[slug].format(**words), option)

    @property
    def fact(self) -> str:
        """Text on the choice and its reason, for the notes of a log."""
        return f"{self.role}: {self.taken}"

    def __str__(self) -> str:
        return f"{self.fact}; {self.option} changes it"
