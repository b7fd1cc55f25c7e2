"""When a page shows what a command prints, up to its times and its last digits.

Words and their order are equal. A number differs by at most two units of its last shown digit, or
by the share of it that the caller allows. Numbers with a unit of run time are not compared.
"""

import re
from decimal import Decimal

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_RUN_TIMES = re.compile(
    r"\b(?:in|busy for) [\d.e+-]+ s\b|\b[\d.e+-]+ ns each\b|\bcompiled in [\d.e+-]+ s\b"
    r"|\b\d+ devices?\b"
)
UNITS_OF_LAST_DIGIT = 2
"""Units of the last shown digit by which a number may differ: one of rounding and one of
processors; chosen value."""


def differences(shown: str, printed: str, share: float = 0.0) -> list[str]:
    """Return the lines of `shown` that `printed` does not have in the same place.

    `share` is the share of a number by which it may differ, for results of drawn numbers.
    """
    rows, seen = shown.strip("\n").splitlines(), printed.splitlines()
    seen += [""] * (len(rows) - len(seen))
    return [
        f"shown: {row.strip()}\nprinted: {other.strip()}"
        for row, other in zip(rows, seen, strict=False)
        if not _same(row, other, share)
    ]


def _same(shown: str, printed: str, share: float) -> bool:
    shown, printed = (_RUN_TIMES.sub("TIME", line) for line in (shown, printed))
    if _words(shown) != _words(printed):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(printed), strict=True)
    return all(_near(one, other, share) for one, other in pairs)


def _words(line: str) -> list[str]:
    """Return the words of a line with a mark for every number; columns may shift by a digit."""
    return _NUMBER.sub("#", line).split()


def _near(shown: str, printed: str, share: float) -> bool:
    one, other = Decimal(shown), Decimal(printed)
    exponent = one.as_tuple().exponent
    assert isinstance(exponent, int)  # true for a finite number
    whole = exponent >= 0 and "e" not in shown
    step = Decimal(0) if whole else UNITS_OF_LAST_DIGIT * Decimal(1).scaleb(exponent)
    return abs(one - other) <= max(step, abs(one) * Decimal(str(share)))
