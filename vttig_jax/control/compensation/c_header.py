"""C header of a backlash map. Its code has no state, library call or loop of variable length."""

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from string import Template
from textwrap import wrap
from typing import Literal

from ...base.errors import UsageError
from ...base.units import ARCSEC, DEG, REV
from ...pair.encoder_reading import ShaftReading
from .compensation import Compensation, require_closing

COMMENT = """\
#ifndef ${NAME}_COMPENSATION_H
#define ${NAME}_COMPENSATION_H

/*
$about
 */

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math removes the tests for NaN and infinite readings; compile without it"
#endif
"""

FUNCTION_NOTES = {
    "backlash": (
        "{name}_backlash(phi1, phi2): backlash in rad of the driven gear and its derivative by"
        " phi1. A negative backlash means that the pair binds according to the map.",
    ),
    "shift": (
        "{name}_shift(phi1, phi2, margin_mm): axial displacement of the driven gear towards the"
        " thick end of the driving gear that leaves margin_mm of displacement open, mm, and its"
        " derivative by phi1 in mm/rad. Never below 0: if the gap is smaller than the margin, both"
        " are 0. A negative or NaN margin gives {NAME}_UNKNOWN.",
        "The derivative times the driving speed in rad/s is the speed of the actuator in mm/s.",
    ),
}

ARITHMETIC = """\
enum { ${NAME}_KNOWN = 0, ${NAME}_UNKNOWN = 1 };

/* Nearest whole number, for less than 2^31. */
static inline double ${name}_nearest_(double x)
{
    return (double)(long)(x < 0.0 ? x - 0.5 : x + 0.5);
}

/* Sine and cosine, for angles up to 1e5 rad, within 1e-15. */
static inline void ${name}_sincos_(double x, double *sine, double *cosine)
{
    const double quarters = ${name}_nearest_(x * 0.6366197723675814);
    const double r = x - quarters * 1.5707963267923333 - quarters * 2.563344151594519e-12;
    const double t = r * r;
    const double s = r + r * t * (-0.16666666666666666 + t * (0.008333333333330948
        + t * (-0.00019841269836758574 + t * (2.755731610255244e-06
        + t * (-2.5051131845003624e-08 + t * 1.5918129294866608e-10)))));
    const double c = 1.0 - 0.5 * t + t * t * (0.041666666666666664
        + t * (-0.0013888888888887398 + t * (2.480158729876569e-05
        + t * (-2.7557317271729793e-07 + t * (2.08761462684032e-09
        + t * -1.1382632425521717e-11)))));
    switch ((int)((long)quarters & 3)) {
    case 0: *sine = s; *cosine = c; break;
    case 1: *sine = c; *cosine = -s; break;
    case 2: *sine = -s; *cosine = -c; break;
    default: *sine = -c; *cosine = s; break;
    }
}

/* Angle minus its whole turns; 2 pi is split in three parts, of which two have few digits. */
static inline double ${name}_within_turn_(double x)
{
    const double turns = ${name}_nearest_(x * 0.15915494309189535);
    return x - turns * $turn_0 - turns * $turn_1 - turns * $turn_2;
}
"""

BACKLASH = """\
struct ${name}_gap {
    double backlash_rad;
    double slope;
    int status;
};

static inline struct ${name}_gap ${name}_backlash(double driving_rad, double driven_rad)
{
    static const double driving_orders[$driving_count] = {
$driving_orders
    };
    static const double driven_orders[$driven_count] = {
$driven_orders
    };
    /* For every harmonic: indices of its orders above; then its cosine and sine in rad. */
    static const $place_type places[$terms][2] = {
$places
    };
    static const double waves[$terms][2] = {
$waves
    };
    struct ${name}_gap result = { 0.0, 0.0, ${NAME}_UNKNOWN };
    double sine1[$driving_count], cosine1[$driving_count];
    double sine2[$driven_count], cosine2[$driven_count];
    double phi1, turn, distance, ideal, value, slope;
    int k;

    if (!(driving_rad >= -1e9 && driving_rad <= 1e9 && driven_rad >= -1e9 && driven_rad <= 1e9))
        return result;
    /* Driven angle without its transmission error: the nearest one that the pair can have. */
    phi1 = ${name}_within_turn_(driving_rad);
    distance = ${name}_within_turn_(driven_rad) - $ratio * phi1 - ($offset);
    turn = ${name}_nearest_(distance / $spacing);
    distance -= turn * $spacing;
    if (!(distance >= -$tolerance && distance <= $tolerance))
        return result;
    ideal = ${name}_within_turn_($ratio * phi1 + turn * $spacing);

    for (k = 0; k < $driving_count; ++k)
        ${name}_sincos_(driving_orders[k] * phi1, &sine1[k], &cosine1[k]);
    for (k = 0; k < $driven_count; ++k)
        ${name}_sincos_(driven_orders[k] * ideal, &sine2[k], &cosine2[k]);
    value = $constant;
    slope = 0.0;
    for (k = 0; k < $terms; ++k) {
        const int p = places[k][0], q = places[k][1];
        const double sine = sine1[p] * cosine2[q] + cosine1[p] * sine2[q];
        const double cosine = cosine1[p] * cosine2[q] - sine1[p] * sine2[q];
        value += waves[k][0] * cosine + waves[k][1] * sine;
        slope += (driving_orders[p] + $ratio * driven_orders[q])
            * (waves[k][1] * cosine - waves[k][0] * sine);
    }
    result.backlash_rad = value;
    result.slope = slope;
    result.status = ${NAME}_KNOWN;
    return result;
}
"""

SHIFT = """\
struct ${name}_displacement {
    double shift_mm;
    double slope_mm_per_rad;
    int status;
};

static inline struct ${name}_displacement ${name}_shift(
    double driving_rad, double driven_rad, double margin_mm)
{
    const struct ${name}_gap gap = ${name}_backlash(driving_rad, driven_rad);
    struct ${name}_displacement result = { 0.0, 0.0, ${NAME}_UNKNOWN };

    if (gap.status != ${NAME}_KNOWN || !(margin_mm >= 0.0 && margin_mm <= 1e9))
        return result;
    result.status = ${NAME}_KNOWN;
    if (gap.backlash_rad > margin_mm * $closing) {
        result.shift_mm = gap.backlash_rad / $closing - margin_mm;
        result.slope_mm_per_rad = gap.slope / $closing;
    }
    return result;
}
"""

READING = """\
/* Angle of the $shaft shaft in rad from a reading of its encoder in $unit. */
static inline double ${name}_${shaft}_rad(double reading)
{
    return $size * (reading - ($origin));
}
"""


Quantity = Literal["shift", "backlash"]

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST = 31
"""Longest prefix, characters: C99 compilers need to compare only 63 characters of a whole name."""

_WIDTH = 88
"""Characters of a line of comments and tables: a chosen value."""

_JOINED = "\x1f"
"""Placeholder for a space at which a line must not be broken."""

_TURN = (6.283185005187988, 3.0199157663446385e-07, 2.1561211432632476e-14)
"""2π in three parts; the products of the first two with whole numbers below 2²⁸ are exact."""


@dataclass(frozen=True)
class HeaderOrigin:
    """Origin of a header, for its comment.

    **Arguments**
    - `pair`: name of the pair. - `version`: version of this package.
    - `zero`: zero of both angles, "start" (first sample of the log) or "reading".
    - `conditional_on`: assumptions of the fit. - `sha256`: digest of the logs, "" for none.
    - `readings`: units and origins of both encoder readings; None where they are not known.
    - `backlash_deg`: 95 % interval of the fitted constant backlash, degrees; None for none.
    - `lowered_deg`: edge of a band, and by how much the mean gap is lowered for it, degrees.
    """

    pair: str
    version: str
    zero: str
    conditional_on: tuple[str, ...] = ()
    sha256: str = ""
    readings: tuple[ShaftReading, ShaftReading] | None = None
    backlash_deg: tuple[float, float] | None = None
    lowered_deg: tuple[str, float] | None = None


def identifier_of(name: str) -> str:
    """Return a prefix for C names from the name of a pair: lower-case ASCII, 31 characters at most.

    **Example**
    ```python
    >>> from vttig_jax.control.compensation.c_header import identifier_of
    >>> identifier_of("VTTIG rig (Prüfstand 2)"), identifier_of("2:1"), identifier_of("")
    ('vttig_rig_prufstand_2', 'pair_2_1', 'pair')

    ```
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    prefix = re.sub(r"[^a-z0-9]+", "_", plain.lower()).strip("_")
    if not prefix or not prefix[0].isalpha():
        prefix = f"pair_{prefix}".strip("_")
    return prefix[:_LONGEST].strip("_")


def check_identifier(name: str) -> str:
    """Return the prefix `name`; **raises** `UsageError` if C names cannot begin with it."""
    if not _IDENTIFIER.fullmatch(name) or len(name) > _LONGEST:
        raise UsageError(
            f"{name!r} cannot begin the names of a C header; give a letter, then letters, digits"
            f" and _, {_LONGEST} characters at most.",
            where="--name",
        )
    return name


def c_header(
    compensation: Compensation, origin: HeaderOrigin, *, name: str, quantity: Quantity = "shift"
) -> str:
    """Return the text of a C99 header that evaluates a compensation at single-turn readings.

    It defines `NAME_backlash` and, for a `quantity` of "shift", `NAME_shift`. If the origin has
    `readings`, `NAME_driving_rad` and `NAME_driven_rad` convert encoder readings to angles. The
    text is ASCII and also valid C++; the same compensation and origin give the same text.

    **Arguments**
    - `name`: prefix of all C names; see `identifier_of`.

    **Raises** `UsageError` for a name that C does not allow and for a shift where no displacement
    closes the gap, `NoAnswerError` where single-turn readings do not identify the turn.

    **Example**
    ```python
    >>> import numpy as np
    >>> from fractions import Fraction
    >>> from vttig_jax.control.compensation.c_header import HeaderOrigin
    >>> from vttig_jax.control import Compensation, c_header
    >>> wave = np.array([1e-4])
    >>> compensation = Compensation(
    ...     Fraction(9, 16), 7e-4, ((1, 0),), wave, wave, 1.3e-3, 0.0, 1e-3, 0.0
    ... )
    >>> text = c_header(compensation, HeaderOrigin("rig", "0.1.0", "start"), name="rig")
    >>> text.splitlines()[0], text.isascii(), "rig_shift(" in text
    ('#ifndef RIG_COMPENSATION_H', True, True)

    ```
    """
    check_identifier(name)
    compensation.require_locating()
    if quantity == "shift":
        require_closing(compensation.closing_rad_per_mm)
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
    """Return the text of each constant and table of the C code by its placeholder."""
    # C has no empty arrays: without harmonics, one with the amplitude zero is written.
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
    """Return a C constant of type double with exactly this value."""
    text = repr(float(value))
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def _rows(items: Iterable[str]) -> str:
    """Return C initialisers on lines of limited width; no line breaks within an initialiser."""
    text = ", ".join(item.replace(" ", _JOINED) for item in items)
    lines = wrap(text, _WIDTH, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines).replace(_JOINED, " ")


def _about(compensation: Compensation, origin: HeaderOrigin, name: str, quantity: Quantity) -> str:
    """Return the text of the comment at the beginning of the header file."""
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
        " allocation, no included file.",
        f"The status is {upper}_UNKNOWN if an angle is not finite or if the readings fit no turn of"
        " the hunting period: phi2 - ratio phi1 is then more than"
        f" {compensation.tolerance_rad / DEG:.6f} deg away from each of the {turns} angles,"
        f" {compensation.spacing_rad / DEG:.6g} deg apart, that the pair can have. Value and"
        " derivative are then 0, which closes nothing.",
    ]
    paragraphs += [note.format(NAME=upper, name=name) for note in FUNCTION_NOTES["backlash"]]
    if quantity == "shift":
        paragraphs += [note.format(NAME=upper, name=name) for note in FUNCTION_NOTES["shift"]]
    if origin.backlash_deg:
        low, high = origin.backlash_deg
        paragraphs.append(
            f"The constant backlash of the fit lies between {low:.6g} and {high:.6g} deg (95 %)."
        )
    if origin.lowered_deg:
        edge, less = origin.lowered_deg
        paragraphs.append(
            f"The gap is the mean of the posterior less {less:.6f} deg, so that it is nowhere above"
            f" the edge {edge} of its band."
        )
    if origin.conditional_on:
        assumed = ", ".join(map(_plain, origin.conditional_on))
        paragraphs.append(f"Holds under the assumptions of the fit: {assumed}.")
    if origin.sha256:
        paragraphs.append(f"SHA-256 of the logs: {_plain(origin.sha256)}.")
    return "\n *\n".join(map(_paragraph, paragraphs))


def _paragraph(text: str) -> str:
    lines: Sequence[str] = wrap(text, _WIDTH, break_long_words=False, break_on_hyphens=False)
    return "\n".join(f" * {line}" for line in lines)


def _plain(text: str) -> str:
    """Return a text as one line of printable ASCII that neither opens nor ends a C comment."""
    folded = unicodedata.normalize("NFKD", " ".join(text.split()))
    letters = "".join(letter for letter in folded if not unicodedata.combining(letter))
    return re.sub(r"[^ -~]", "_", letters).replace("*/", "*|").replace("/*", "|*")
