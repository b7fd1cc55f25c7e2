"""Times of a log: dates and times of day, stamps since an epoch, and their seconds.

Written forms become whole nanoseconds: ISO 8601 with or without date, zone, and decimal comma, also
in its basic form `20261101T235950.5`; German dates `01.11.2026`; dates with slashes; names of
months; AM and PM; times of day, which may pass midnight; and minutes and seconds `59:50.5`, which
may pass the hour. The unit of a numeric stamp that counts from an epoch follows from its size.
Stamps become seconds without loss of digits.
"""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from decimal import Decimal

import numpy as np
from jaxtyping import Float, Real

from ...base.errors import LogError
from .column_names import TIME_UNITS

_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_GERMAN = {"mrz": 3, "mär": 3, "mai": 5, "okt": 10, "dez": 12}
_MONTH = {name: k for k, name in enumerate(_MONTHS, 1)} | _GERMAN
_DATE = re.compile(
    r"\d{4}[-/.]\d\d?[-/.]\d\d?"
    r"|\d\d?[-/.]\d\d?[-/.](?:\d{4}|\d\d)"
    r"|\d\d?[- .]+[A-Za-zä]{3}[a-z]*[- .]+\d{4}"
    r"|[A-Za-zä]{3}[a-z]*[- .]+\d\d?,?[- ]+\d{4}"
)
_PARTS = re.compile(r"[-/. ,]+")
_CLOCK = re.compile(
    r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,:;](?P<part>\d{1,12}))?)?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|GMT|[A-Z]{3,4}|[+-]\d\d:?(?:\d\d)?)?"
)
_BASIC = re.compile(r"(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d)(.*)")
_MINUTES = re.compile(r"(\d\d?):(\d\d)[.,](\d{1,12})")
_BETWEEN = re.compile(r"[T ,;_]+")
_ZONE = re.compile(r"([+-])(\d\d):?(\d\d)?")
HOUR_NS = 3_600_000_000_000
"""Nanoseconds in an hour."""

DAY_NS = 86_400_000_000_000
"""Nanoseconds in a day."""


@dataclass(frozen=True)
class Stamp:
    """Parts of one stamp: its date as text, the time of day in ns, and the zone.

    The time of a stamp without a date restarts at zero after `period_ns`.
    """

    day: str
    clock_ns: int
    zone: str
    period_ns: int = DAY_NS


def looks_like_stamp(field: str) -> bool:
    """Return whether a field is a time of day, with or without a date."""
    text = field.strip()
    return (":" in text or _BASIC.fullmatch(text) is not None) and _split(text) is not None


def read_stamps(
    fields: Sequence[str], at: Callable[[int | None], str]
) -> tuple[Float[np.ndarray, " n"], str]:
    """Return stamps in seconds since the first stamp, and a note on the first stamp.

    `at` returns the place of a row, or that of the whole column for None.

    **Raises** `LogError` for a field of another form, a zone name that changes, and dates such as
    01/02/2026 that change and have two orders of day and month.
    """
    parsed = []
    for row, field in enumerate(fields):
        stamp = _split(field.strip())
        if stamp is None:
            raise LogError(
                f"`{field}` is no time like that of the first row, `{fields[0]}`; correct it or"
                " remove the line.",
                where=at(row),
            )
        parsed.append(stamp)
    days = _days({stamp.day for stamp in parsed}, at(None))
    shifts = _shifts_ns({stamp.zone for stamp in parsed}, at(None))
    first_day = days[parsed[0].day]

    def since_first_day_ns(stamp: Stamp) -> int:
        return (days[stamp.day] - first_day) * DAY_NS + stamp.clock_ns - shifts[stamp.zone]

    nanoseconds = np.array([*map(since_first_day_ns, parsed)], np.int64)
    if not parsed[0].day:
        period = parsed[0].period_ns
        falls = np.diff(nanoseconds) < -period // 2  # the clock has passed midnight or the hour
        nanoseconds[1:] += period * np.cumsum(falls)
    return (nanoseconds - nanoseconds[0]) / 1e9, f"time: starts at {fields[0].strip()}"


def _split(text: str) -> Stamp | None:
    """Return the parts of a stamp, or None for text of another form."""
    minutes = _MINUTES.fullmatch(text)
    if minutes is not None:
        if int(minutes[1]) > 59 or int(minutes[2]) > 59:
            return None
        seconds = int(minutes[1]) * 60 + int(minutes[2])
        return Stamp("", seconds * 1_000_000_000 + _part_ns(minutes[3]), "", HOUR_NS)
    text = _BASIC.sub(r"\1-\2-\3T\4:\5:\6\7", text)
    dated = _DATE.match(text)
    rest = text
    if dated is not None:
        between = _BETWEEN.match(text, dated.end())
        if between is None:
            return None
        rest = text[between.end() :]
    clock = _CLOCK.fullmatch(rest)
    if clock is None:
        return None
    hour, minute, second = (int(clock[name] or 0) for name in ("hour", "minute", "second"))
    if clock["half"]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + 12 * (clock["half"][0] in "pP")
    if hour > 23 or minute > 59 or second > 60:
        return None
    clock_ns = ((hour * 60 + minute) * 60 + second) * 1_000_000_000 + _part_ns(clock["part"] or "0")
    return Stamp(dated[0] if dated is not None else "", clock_ns, clock["zone"] or "")


def _part_ns(digits: str) -> int:
    """Return the decimals of a second, as text, in nanoseconds."""
    return int(digits.ljust(9, "0")[:9])


def _shifts_ns(zones: set[str], where: str) -> dict[str, int]:
    """Return zone of a stamp → what is subtracted from its clock, in nanoseconds.

    A zone that all stamps share has no effect, because only time differences are used: then it may
    be a name such as CET, or "" for none.

    **Raises** `LogError` for zones that differ, unless every one of them states its offset from
    UTC.
    """
    if len(zones) == 1:
        return dict.fromkeys(zones, 0)
    shifts = dict.fromkeys(zones & {"Z", "UTC", "GMT"}, 0)
    for zone in zones - shifts.keys():
        match = _ZONE.fullmatch(zone)
        if match is None:
            names = ", ".join(sorted(zone or "none" for zone in zones))
            raise LogError(f"the time zone changes ({names}); export the log in UTC.", where=where)
        minutes = 60 * int(match[2]) + int(match[3] or 0)
        shifts[zone] = (1 if match[1] == "+" else -1) * minutes * 60_000_000_000
    return shifts


def _days(texts: set[str], where: str) -> dict[str, int]:
    """Return text of a date → day number; all dates of a log have one order of day and month."""
    if texts == {""}:
        return {"": 0}
    found: list[dict[str, int]] = []
    for order in ("day first", "month first"):
        with suppress(ValueError):
            found.append({t: date(*_year_month_day(t, order)).toordinal() for t in texts})
    if not found:
        raise LogError(f"`{sorted(texts)[0]}` is no date; correct it.", where=where)
    first, last = found[0], found[-1]
    low = min(first.values()), min(last.values())
    if any(first[text] - low[0] != last[text] - low[1] for text in texts):
        raise LogError(
            f"`{sorted(texts)[0]}` can be day and month or month and day, and the date changes;"
            " write the dates as 2026-11-30.",
            where=where,
        )
    return first


def _year_month_day(text: str, order: str) -> tuple[int, int, int]:
    """Return the parts of a date; **raises** `ValueError` for another text."""
    day, month, year = _PARTS.split(text)
    if len(day) == 4:
        day, year = year, day
    elif day.isalpha() or ("." not in text and month.isdigit() and order == "month first"):
        day, month = month, day
    number = _MONTH.get(month[:3].lower(), 0) if month.isalpha() else int(month)
    return int(year) + (2000 if len(year) == 2 else 0), number, int(day)


FAR = 2**31
"""If stamps exceed this number, the first stamp is subtracted, because float64 has too few digits
(chosen)."""

_DECIMAL = re.compile(r"[+-]?\d+(?:[.,]\d*)?")
_LONGEST = 40  # most characters of a stamp (chosen); nanoseconds since 1970 have 20

FINE_ENOUGH = 0.1
"""Largest step of the printed stamps as a fraction of the sampling interval (chosen)."""


def since_first(stamps: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return dates or durations of NumPy in s since the first valid one; a missing one is NaN.

    They are subtracted as whole nanoseconds.
    """
    kind = "datetime64[ns]" if stamps.dtype.kind == "M" else "timedelta64[ns]"
    whole = stamps.ravel().astype(kind)
    known, counted = ~np.isnat(whole), whole.astype(np.int64)
    return np.where(known, (counted - counted[known][:1].sum()) / 1e9, np.nan)


def seconds_of_numbers(values: Real[np.ndarray, " n"], unit: str) -> Float[np.ndarray, " n"]:
    """Return numeric stamps in seconds; stamps beyond `FAR` are counted from the first stamp.

    Integers are subtracted before the conversion to float64, because float64 represents nanoseconds
    since 1970 only with a step of 256 ns.
    """
    if len(values) and max(float(values.max()), -float(values.min())) > FAR:
        values = values - values[0]
    factor = TIME_UNITS[unit]
    return values if factor == 1 and values.dtype.kind == "f" else values * factor


def exact_numbers(fields: Sequence[str]) -> Float[np.ndarray, " n"] | None:
    """Return decimal stamps minus the first stamp, subtracted without loss of digits.

    The result is None unless all fields are plain decimal numbers of at most 40 characters.
    """
    if any(len(field) > _LONGEST for field in fields):
        return None
    if not all(map(_DECIMAL.fullmatch, fields)):
        return None
    values = [Decimal(field.replace(",", ".")) for field in fields]
    return np.array([float(value - values[0]) for value in values])


def check_days(fields: Sequence[str], seconds: Float[np.ndarray, " n"], where: str) -> None:
    """Raise `LogError` if stamps in days have too few decimals to resolve the sampling interval."""
    if len(seconds) < 3:
        return
    digits = min(len(field.replace(",", ".").partition(".")[2]) for field in fields[:1000])
    step_s = TIME_UNITS["d"] * 10.0**-digits
    usual = float(np.median(np.abs(np.diff(seconds))))
    if step_s > FINE_ENOUGH * usual:
        raise LogError(
            f"days with {digits} decimals hold time to {step_s:.2g} s, too coarse for samples"
            f" {usual:.2g} s apart; export more decimals, or give --sample-rate.",
            where=where,
        )


FIRST_S, LAST_S = 978_307_200, 4_102_444_800
"""Seconds from 1970 to 2001 and to 2100; every log was recorded between these years (chosen)."""

FILETIME = "100ns"
"""Unit of FILETIME stamps: 100 nanoseconds since 1601."""


EPOCHS = {
    "s": (1, 0, "seconds since 1970"),
    "ms": (1_000, 0, "milliseconds since 1970"),
    "us": (1_000_000, 0, "microseconds since 1970"),
    "ns": (1_000_000_000, 0, "nanoseconds since 1970"),
    FILETIME: (10_000_000, 11_644_473_600, "100 ns since 1601 (FILETIME)"),
}
"""Unit of stamps → units per second, seconds from the epoch to 1970, and both as a text for notes.
The number ranges of the units for 2001 to 2100 do not overlap."""


def epoch_unit(stamps: Real[np.ndarray, " n"]) -> str | None:
    """Return the unit of `EPOCHS` with which all stamps lie between 2001 and 2100, or None."""
    low, high = stamps.min().item(), stamps.max().item()
    for unit, (per_second, offset_s, _) in EPOCHS.items():
        if (FIRST_S + offset_s) * per_second <= low <= high <= (LAST_S + offset_s) * per_second:
            return unit
    return None
