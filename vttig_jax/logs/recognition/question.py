"""Questions to the user if a log can be read in two ways, and notes on what was recognised.

A question is an error that the caller raises; its message names the options that decide.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from ...base.errors import LogError, UsageError
from ..readers.column_names import ROW, scale_of
from .candidates import MOST_LISTED, Candidate, listed_facts
from .request import in_words


@dataclass(frozen=True)
class Guess:
    """Column or unit that was recognised and not stated by the user, for example for a role.

    `taken` is the choice, `reason` says why, and `option` is the option that changes it.
    """

    role: str
    taken: str
    reason: str
    option: str

    @property
    def fact(self) -> str:
        """Text on the choice and its reason, for the notes of a log."""
        return f"{self.role}: {self.taken}, {self.reason}"

    def __str__(self) -> str:
        return f"{self.fact}; {self.option} changes it"


def several(role: str, candidates: Sequence[Candidate], source: str) -> LogError:
    """Return the question which of several columns has the role `role`."""
    options = " or ".join(f"--column {role}='{one.name}'" for one in candidates[:4])
    return LogError(
        f"{len(candidates)} columns can be {role}: {listed_facts(list(candidates))}; choose one"
        f" with {options}.",
        where=source,
    )


def only_setpoint(role: str, one: Candidate, source: str) -> LogError:
    """Return the question whether a setpoint column may replace the measured angle."""
    return LogError(
        f"the only column for {role} is `{one.name}`, and `{one.reading.setpoint}` says a setpoint"
        f" or a computed angle, which no encoder measured; name the measured column with"
        f" --column {role}=NAME, or this one with --column {role}='{one.name}'.",
        where=source,
    )


def no_fit(
    roles: Sequence[str],
    candidates: list[Candidate],
    ratio: Fraction | None,
    source: str,
    others: Sequence[Candidate] = (),
    *,
    clocked: bool = False,
) -> LogError:
    """Return the question for roles that neither the names nor the ratio determine.

    `candidates` are columns whose names allow a shaft. Those whose names have a unit of angles are
    listed first, and constant columns as left out. `others` are columns whose names mean a quantity
    other than an angle. `clocked` is true if a clock turns the driving shaft, so that the log shows
    no ratio.
    """
    named = " and ".join(roles)
    options = " ".join(f"--column {role}=NAME" for role in roles)
    still = [one for one in candidates if one.is_constant and one.reading.is_angle]
    candidates = [one for one in candidates if not one.is_constant]
    if ratio is None:
        why = "and without a ratio the motion says nothing"
        if not clocked:
            options = f"--ratio A:B (driving turns to driven turns) or --teeth Z1/Z2, or {options}"
    elif not candidates:
        why = "and no other column holds numbers that change"
    else:
        why = f"and no columns turn as given ({in_words(ratio)})"
    listed = sorted(candidates, key=_unlikely)
    seen = f"; there are {listed_facts(listed)}" if candidates else ""
    if len(candidates) == 1 and len(roles) == 2:
        alone = candidates[0].name
        seen += (
            "; if the number of the row is the reading of the other encoder, as in a table of"
            f" calibration, give --column driving='{alone}' --column driven={ROW}"
        )
    if still:
        shown = ", ".join(f"`{one.name}` (always {_value(one)})" for one in still[:MOST_LISTED])
        seen += f"; left out, as they do not change: {shown}"
    if others:
        shown = ", ".join(f"`{one.name}` ({one.reading.other})" for one in others[:MOST_LISTED])
        seen += f"; left out, as their names say another quantity: {shown}"
    return LogError(f"no column name says {named}, {why}; give {options}{seen}.", where=source)


def _value(one: Candidate) -> str:
    """Return the value of a constant column as text."""
    return "" if one.values is None else f"{one.values[0]:.6g}"


def _unlikely(one: Candidate) -> tuple[bool, bool, bool]:
    """Return a key that sorts columns by how little their names look like a measured angle."""
    reading = one.reading
    return not reading.is_angle, reading.unit is None, bool(reading.setpoint)


def no_driving(candidates: list[Candidate], source: str) -> LogError:
    """Return the question for the driving angle in a log with a transmission error."""
    seen = f"; there are {listed_facts(candidates)}" if candidates else ""
    return LogError(
        "no column name says driving; give --column driving=NAME, or, where a clock turns the"
        " driving shaft, --driving-rpm RPM (--driving-rpm sidereal for the worm of a telescope"
        f" mount){seen}.",
        where=source,
    )


def two_fits(pairs: Sequence[tuple[Candidate, Candidate]], source: str) -> LogError:
    """Return the question which of several pairs of columns are the shafts."""
    shown = ", or ".join(f"`{a.name}` drives `{b.name}`" for a, b in pairs[:4])
    columns = list({one.index: one for pair in pairs for one in pair}.values())
    first, second = pairs[0]
    return LogError(
        f"{len(pairs)} pairs of columns have the given ratio: {shown}; the columns are"
        f" {listed_facts(columns)}; choose with, for example, --column driving='{first.name}'"
        f" --column driven='{second.name}'.",
        where=source,
    )


def named_speed(role: str, one: Candidate, angle: Candidate, source: str) -> LogError:
    """Return the question for a shaft whose named column is the speed of another column."""
    return LogError(
        f"the name `{one.name}` says {role}, but its values are the speed of `{angle.name}`; name"
        f" the angles with --column driving=NAME --column driven=NAME, such as"
        f" --column {role}='{angle.name}'.",
        where=source,
    )


def twins(role: str, one: Candidate, other: Candidate, source: str) -> LogError:
    """Return the question which of two columns with nearly the same angle was measured."""
    return LogError(
        f"`{one.name}` and `{other.name}` hold nearly the same angle, as a setpoint and a measured"
        f" angle do; name the measured one with --column {role}='{other.name}' or"
        f" --column {role}='{one.name}'.",
        where=source,
    )


def names_against_ratio(
    named: Mapping[str, Candidate],
    turning: tuple[Candidate, Candidate],
    ratio: Fraction,
    source: str,
) -> LogError:
    """Return the question for the shafts if the columns with their names do not turn as given.

    `named` is role → column with such a name. `turning` are the driving and the driven column that
    turn as the given `ratio` says.
    """
    a, b = (f"`{named[role].name}`" for role in ("driving", "driven"))
    c, d = (one.name for one in turning)
    return LogError(
        f"the names say that {a} drives {b}, but these columns do not turn as given"
        f" ({in_words(ratio)}), and `{c}` and `{d}` do; if those are the measured angles, give"
        f" --column driving='{c}' --column driven='{d}', otherwise correct the ratio or name the"
        " columns with --column driving=NAME --column driven=NAME.",
        where=source,
    )


def two_readings(text: str, ratio: Fraction) -> UsageError:
    """Return the question whether a ratio such as 9/16 is driven over driving speed or the inverse.

    It arises if no column name distinguishes the shafts. `text` is the ratio as the user wrote it,
    `ratio` its value as driven over driving speed.
    """
    above, slash, below = text.replace(" ", "").partition("/")
    one, other = f"{below if slash else 1}:{above}", f"{above}:{below if slash else 1}"
    return UsageError(
        f"--ratio {text} has two readings, and no column name tells the shafts apart: write --ratio"
        f" {one} if {in_words(ratio)}, or --ratio {other} if {in_words(1 / ratio)}; or name both"
        " columns with --column driving=NAME --column driven=NAME."
    )


def bare_ratio(text: str, ratio: Fraction) -> UsageError:
    """Return the question which shaft turns faster, of a log without the other shaft."""
    return UsageError(
        f"--ratio {text} may be meant as {text}:1 or as 1:{text}, and a transmission-error curve"
        f" does not show which: write --ratio {text}:1 if {in_words(1 / ratio)}, or --ratio"
        f" 1:{text} if {in_words(ratio)}."
    )


def inverted(first: Candidate, second: Candidate, source: str) -> LogError:
    """Return the error for two shafts whose readings have opposite directions."""
    return LogError(
        f"`{first.name}` and `{second.name}` have the given ratio, but the readings of one grow"
        " while those of the other fall: one encoder counts backwards; give --invert driven (or"
        " --invert driving).",
        where=source,
    )


def no_unit(role: str, one: Candidate, source: str) -> LogError:
    """Return the question for the unit of a shaft."""
    if scale := scale_of(one.name):
        return LogError(
            f"the name of the column {one.facts} for {role} holds a scale, `{scale}`: give the unit"
            f" of its numbers with --unit {role}=mdeg (or mrad, deg, rad, …), or convert the"
            " column.",
            where=source,
        )
    return LogError(
        f"the column {one.facts} for {role} names no unit, and degrees, radians and counts look"
        f" the same; give --unit deg (or {role}=deg, rad, rev), or --counts A,B with the counts per"
        " revolution of the driving and of the driven encoder.",
        where=source,
    )


def no_counts(role: str, name: str, source: str) -> LogError:
    """Return the question for the counts per revolution of an encoder."""
    return LogError(
        f"the column `{name}` of {role} is in counts, and no log says how many make a turn; give"
        " --counts A,B with the counts per revolution of the driving and of the driven encoder.",
        where=source,
    )


def no_time(candidates: Sequence[Candidate], source: str) -> LogError:
    """Return the question for the time."""
    rising = [one for one in candidates if one.rises]
    seen = f"; columns that only grow are {listed_facts(rising)}" if rising else ""
    return LogError(
        f"no column is certainly the time; give --column time=NAME, or --sample-rate HZ{seen}.",
        where=source,
    )


def also_no_unit(error: LogError) -> LogError:
    """Return `error`, a question for the time, that also asks for the unit of the angles."""
    return LogError(
        f"{error.message} No name states the unit of the angles either: give --unit deg (or rad,"
        " rev), or --counts A,B with the counts per revolution of both encoders.",
        where=error.where,
    )


def two_clocks(pairs: Sequence[tuple[str, str]], source: str) -> LogError:
    """Return the error for shafts with different stamps; `pairs` are (stamps, shaft)."""
    (a, b), (c, d) = pairs
    return LogError(
        f"`{b}` has the stamps `{a}` and `{d}` has `{c}`, and the clocks run apart, so that no row"
        " holds one instant; interpolate one channel at the stamps of the other, or write both as a"
        " long table of time, channel and value, which is brought onto one clock.",
        where=source,
    )


def no_time_unit(one: Candidate, source: str) -> LogError:
    """Return the question for the unit of time stamps without decimals."""
    return LogError(
        f"the time stamps are whole numbers without a unit, {one.facts}, and seconds and"
        " milliseconds look the same; give --unit time=s, ms, us or ns.",
        where=source,
    )


def unreadable_time(one: Candidate, fault: LogError) -> LogError:
    """Return the question for the time; `fault` is the first stamp that cannot be read."""
    seen = fault.message.split(";")[0].rstrip(".")
    return LogError(
        f"the stamps of the time column `{one.name}` must be numbers, or dates such as"
        f" 2026-11-30T12:00:00.25, and here {seen}; remove this line if it is no row of the table,"
        " name another column with --column time=NAME, or give --sample-rate HZ.",
        where=fault.where,
    )


def days_or_seconds(one: Candidate, source: str) -> LogError:
    """Return the question whether time stamps are days or seconds."""
    return LogError(
        f"the time stamps, {one.facts}, may be days, as Excel and MATLAB count them, or seconds;"
        " give --unit time=d or --unit time=s.",
        where=source,
    )
