"""A backlash map as a C header: no library, no loop of varying length, no state."""

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from string import Template
from textwrap import wrap
from typing import Literal

from ..base.errors import UsageError
from ..base.units import ARCSEC, DEG, REV
from ..pair.reading import ShaftReading
from .c_header_text import ARITHMETIC, BACKLASH, COMMENT, FUNCTION_NOTES, READING, SHIFT
from .compensation import Compensation

Quantity = Literal["shift", "backlash"]

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST = 31
"""Characters of a prefix; names longer than 63 need not differ for a C99 compiler."""

_WIDTH = 88

_JOINED = "\x1f"
"""Stands for a blank at which no line is broken."""

_TURN = (6.283185005187988, 3.0199157663446385e-07, 2.1561211432632476e-14)
"""2π in three parts, of which the first two times a whole number below 2²⁸ are exact."""


@dataclass(frozen=True)
class Origin:
    """What a header says about where it comes from.

    **Arguments**
    - `pair`: its name. - `version`: of this package.
    - `zero`: where both angles are zero, "start" (first sample of the log) or "reading".
    - `conditional_on`: assumptions of the fit. - `sha256`: of the logs, "" for none.
    - `readings`: how the encoders' readings become angles; None where that is not known.
    """

    pair: str
    version: str
    zero: str
    conditional_on: tuple[str, ...] = ()
    sha256: str = ""
    readings: tuple[ShaftReading, ShaftReading] | None = None


def identifier_of(name: str) -> str:
    """A prefix for C names from the name of a pair: ASCII, small letters, at most 31 characters.

    **Example**
    ```python
    >>> from vttig_jax.control.c_header import identifier_of
    >>> identifier_of("VTTIG rig (Prüfstand 2)"), identifier_of("2:1"), identifier_of("")
    ('vttig_rig_prufstand_2', 'pair_2_1', 'pair')

    ```
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    found = re.sub(r"[^a-z0-9]+", "_", plain.lower()).strip("_")
    if not found or not found[0].isalpha():
        found = f"pair_{found}".strip("_")
    return found[:_LONGEST].strip("_")


def check_identifier(name: str) -> str:
    """The prefix itself.

    **Raises** `UsageError` where C names cannot begin with it.
    """
    if not _IDENTIFIER.fullmatch(name) or len(name) > _LONGEST:
        raise UsageError(
            f"{name!r} cannot begin the names of a C header; give a letter, then letters, digits"
            f" and _, {_LONGEST} characters at most.",
            where="--name",
        )
    return name


def c_header(
    compensation: Compensation, origin: Origin, *, name: str, quantity: Quantity = "shift"
) -> str:
    """The text of a C99 header that evaluates a compensation at single-turn readings.

    It defines `NAME_backlash` and, for a `quantity` of "shift", `NAME_shift`; where the readings of
    the encoders are known, `NAME_driving_rad` and `NAME_driven_rad` make angles of them. It is
    plain ASCII, valid C++ too, and the same for the same compensation and origin.

    **Arguments**
    - `name`: what all names begin with; see `identifier_of`.

    **Raises** `UsageError` for a name C does not have and for a shift where no displacement closes
    the gap, `NoAnswerError` where single-turn readings leave the turn open.

    **Example**
    ```python
    >>> import numpy as np
    >>> from fractions import Fraction
    >>> from vttig_jax.control.c_header import Origin, c_header
    >>> from vttig_jax.control.compensation import Compensation
    >>> one = np.array([1e-4])
    >>> compensation = Compensation(
    ...     Fraction(9, 16), 7e-4, ((1, 0),), one, one, 1.3e-3, 0.0, 1e-3, 0.0
    ... )
    >>> text = c_header(compensation, Origin("rig", "0.1.0", "start"), name="rig")
    >>> text.splitlines()[0], text.isascii(), "rig_shift(" in text
    ('#ifndef RIG_COMPENSATION_H', True, True)

    ```
    """
    check_identifier(name)
    compensation.require_locating()
    if quantity == "shift":
        compensation.require_closing()
    parts = [COMMENT, ARITHMETIC, BACKLASH]
    if quantity == "shift":
        parts.append(SHIFT)
    values = {
        "name": name,
        "NAME": name.upper(),
        "about": _about(compensation, origin, name, quantity),
        **_numbers(compensation),
    }
    text = "\n".join(Template(part).substitute(values) for part in parts)
    if origin.readings is not None:
        for shaft, reading in zip(("driving", "driven"), origin.readings, strict=True):
            text += "\n" + Template(READING).substitute(
                name=name,
                shaft=shaft,
                unit=reading.unit,
                size=_number(reading.radians_per_unit),
                origin=_number(reading.origin),
            )
    return f"{text}\n#endif /* {name.upper()}_COMPENSATION_H */\n"


def _numbers(compensation: Compensation) -> dict[str, str]:
    """Constants and tables of the code."""
    # A table of no rows is no C.
    terms = compensation.terms or ((1, 0),)
    cosine, sine = (
        list(map(float, values)) if compensation.terms else [0.0]
        for values in (compensation.cosine_rad, compensation.sine_rad)
    )
    driving, driven = (sorted({term[side] for term in terms}) for side in (0, 1))
    places = [f"{{{driving.index(first)}, {driven.index(second)}}}" for first, second in terms]
    waves = [f"{{{_number(c)}, {_number(s)}}}" for c, s in zip(cosine, sine, strict=True)]
    return {
        "terms": str(len(terms)),
        "driving_count": str(len(driving)),
        "driven_count": str(len(driven)),
        "driving_orders": _rows(map(_number, driving)),
        "driven_orders": _rows(map(_number, driven)),
        "places": _rows(places),
        "waves": _rows(waves),
        "place_type": _place_type(max(len(driving), len(driven))),
        "ratio": _number(float(compensation.ratio)),
        "spacing": _number(compensation.spacing_rad),
        "offset": _number(math.remainder(compensation.offset_rad, REV)),
        "tolerance": _number(compensation.tolerance_rad),
        "constant": _number(compensation.constant_rad),
        "closing": _number(compensation.closing_rad_per_mm),
        **{f"turn_{place}": _number(part) for place, part in enumerate(_TURN)},
    }


def _place_type(count: int) -> str:
    return "unsigned char" if count <= 256 else "unsigned short"


def _number(value: float | int) -> str:
    """A double constant of C that is the same number."""
    text = repr(float(value))
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def _rows(items: Iterable[str]) -> str:
    """Initialisers on lines of fixed width, none of them broken."""
    text = ", ".join(item.replace(" ", _JOINED) for item in items)
    lines = wrap(text, _WIDTH, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines).replace(_JOINED, " ")


def _about(compensation: Compensation, origin: Origin, name: str, quantity: Quantity) -> str:
    """The comment at the head of the file."""
    zero = {
        "start": "where the encoders stood at the first sample of the log",
        "reading": "where the encoders read zero",
    }[origin.zero]
    ratio, turns = compensation.ratio, compensation.hunting_turns
    upper = name.upper()
    paragraphs = [
        f"Backlash of: {_plain(origin.pair) or 'a gear pair without a name'}. Made by vttig-jax"
        f" {_plain(origin.version)}; do not edit.",
        f"It holds {len(compensation.terms)} harmonics of the driving angle phi1 and the driven"
        f" angle phi2 of a fitted backlash map; ratio {ratio} (driven over driving speed), hunting"
        f" period {turns} driving turns. They are within {compensation.error_rad / ARCSEC:.1e}"
        " arcsec of the map. Mean backlash"
        f" {compensation.constant_rad / DEG:.6f} deg of the driven gear.",
        f"Angles: rad of each shaft, wrapped or not, up to 1e9; zero {zero}; both positive for"
        " positive motion of the log.",
        "Cost of a call: sines and cosines of"
        f" {len({t[0] for t in compensation.terms})} + {len({t[1] for t in compensation.terms})}"
        " angles and two products a harmonic, the same for every argument; no state, no"
        " allocation, nothing included.",
        f"Unknown ({upper}_UNKNOWN): an angle that is no finite number, or readings that fit no"
        " turn of the hunting period: phi2 - ratio phi1 farther than"
        f" {compensation.tolerance_rad / DEG:.6f} deg from the {turns} angles"
        f" {compensation.spacing_rad / DEG:.6g} deg apart that the pair can have. Then value and"
        " slope are 0, which closes nothing.",
    ]
    paragraphs += [one.format(NAME=upper, name=name) for one in FUNCTION_NOTES["backlash"]]
    if quantity == "shift":
        paragraphs += [one.format(NAME=upper, name=name) for one in FUNCTION_NOTES["shift"]]
    if origin.conditional_on:
        assumed = ", ".join(_plain(one) for one in origin.conditional_on)
        paragraphs.append(f"Holds under the assumptions of the fit: {assumed}.")
    if origin.sha256:
        paragraphs.append(f"SHA-256 of the logs: {_plain(origin.sha256)}.")
    return "\n *\n".join(_paragraph(one) for one in paragraphs)


def _paragraph(text: str) -> str:
    lines: Sequence[str] = wrap(text, _WIDTH, break_long_words=False, break_on_hyphens=False)
    return "\n".join(f" * {line}" for line in lines)


def _plain(text: str) -> str:
    """Printable ASCII on one line that neither opens nor ends a comment."""
    folded = unicodedata.normalize("NFKD", " ".join(text.split()))
    letters = "".join(one for one in folded if not unicodedata.combining(one))
    return re.sub(r"[^ -~]", "_", letters).replace("*/", "*|").replace("/*", "|*")
