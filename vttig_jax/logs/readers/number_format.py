"""Conversion of written numbers with a decimal point or comma and thousands marks.

Thousands marks are the mark that is not the decimal mark, apostrophes and no-break spaces: 1,234.5,
1'234.5 and 1 234.5. `1,234` can mean 1.234 or 1234. If tabs or semicolons delimit the fields, the
comma is a decimal comma. Otherwise the argument `decimal` is required, unless another number in the
log resolves the ambiguity.
"""

import re
from collections.abc import Iterable

from ...base.errors import LogError

_PLAIN = r"[+-]?(?:\d+{0}?\d*|{0}\d+)(?:[eE][+-]?\d+)?"
_NUMBER = {mark: re.compile(_PLAIN.format(re.escape(mark))) for mark in ".,"}
_GROUPED = {
    mark: re.compile(rf"[+-]?\d{{1,3}}(?:{re.escape(mark)}\d{{3}})+(?!\d)") for mark in ".,"
}
_BLANKS = re.compile("['\u2019\u00a0\u2009\u202f]")
_BLANK_GROUPED = re.compile(rf"[+-]?\d{{1,3}}(?:{_BLANKS.pattern}\d{{3}})+(?!\d)")
_OTHER = re.compile("[^\\d.,+\\-eE'\u2019\u00a0\u2009\u202f]")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)

CURE = 'give --decimal "." or --decimal ","'


def looks_like_number(field: str) -> bool:
    """Return whether a field is a number with a decimal point or comma, or nan or inf."""
    try:  # most fields of a table are plain numbers, and most others have other characters
        float(field)
        return "_" not in field
    except ValueError:
        if _OTHER.search(field.strip()):
            return False
    text = _without_thousands_blanks(field)
    plain = any(number.fullmatch(text) for number in _NUMBER.values())
    return plain or any(_thousands(text, mark) is not None for mark in ".,")


def to_number(field: str, decimal: str) -> float | None:
    """Return the value of a field with a known decimal mark, or None if it is not a number.

    With a decimal point, commas may group thousands (`1,234.5`), and vice versa.
    """
    text = _without_thousands_blanks(field)
    if _NOT_FINITE.fullmatch(text):
        return float(text)
    if not _NUMBER[decimal].fullmatch(text):
        grouped = _thousands(text, "," if decimal == "." else ".")
        if grouped is None:
            return None
        text = grouped
    return float(text.replace(decimal, "."))


def choose_decimal(fields: Iterable[str], delimiter: str | None, where: str) -> str:
    """Return the decimal mark "." or "," of number fields, some of which may contain a comma.

    **Raises** `LogError` if the mark is ambiguous.
    """
    with_comma = [_without_thousands_blanks(field) for field in fields if "," in field]
    with_point = any("." in field for field in fields)
    if not with_comma:
        return "."
    example = with_comma[0]
    if any("." in field for field in with_comma) or with_point:
        raise LogError(
            f"the log has numbers with commas (`{example}`) and numbers with points; {CURE}.",
            where=where,
        )
    if delimiter in (";", "\t"):
        return ","
    if all(_GROUPED[","].fullmatch(field) for field in with_comma):
        raise LogError(
            f"`{example}` means {example.replace(',', '.')} or {example.replace(',', '')}; {CURE}.",
            where=where,
        )
    return ","


def _without_thousands_blanks(field: str) -> str:
    """Return the field without the apostrophes and no-break spaces that separate thousands."""
    text = field.strip()
    head = _BLANK_GROUPED.match(text)
    if head is None:
        return text
    return _BLANKS.sub("", head[0]) + text[head.end() :]


def _thousands(text: str, mark: str) -> str | None:
    """Return `text` without its thousands marks, or None if their positions are wrong."""
    head = _GROUPED[mark].match(text)
    if head is None or mark in text[head.end() :]:
        return None
    rest = text.replace(mark, "")
    return rest if _NUMBER["." if mark == "," else ","].fullmatch(rest) else None
