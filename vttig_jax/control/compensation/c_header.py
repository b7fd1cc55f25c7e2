"""C headers of a backlash map and of an error table.

Their code has no state, no library call and no loop of variable length.
"""

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from textwrap import wrap
from typing import Any, Literal

import numpy as np

from ...base.errors import UsageError
from ...base.units import ARCSEC, DEG, REV
from ...pair.gear_pair import ShaftReading
from .compensation import Compensation, require_closing
from .correction import CorrectionTable
from .table_formats import WIDTH, plain, rows_of

_TEMPLATE = Path(__file__).with_name("compensation.h.in")
"""Text of the header in parts that begin with `@@ name`; `$` marks what `c_header` fills in."""

Quantity = Literal["shift", "backlash"]

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST = 31
"""Longest prefix, characters: C99 compilers need to compare only 63 characters of a whole name."""

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
    values = {"about": _about(compensation, origin, name, quantity), **_numbers(compensation)}
    names = ("comment", "arithmetic", "backlash", "shift")[: 4 if quantity == "shift" else 3]
    parts = [(part, values) for part in names]
    for shaft, of in zip(("driving", "driven"), origin.readings or (), strict=False):
        scale = {"size": _number(of.radians_per_unit), "origin": _number(of.origin)}
        parts.append(("reading", {"shaft": shaft, "unit": of.unit, **scale}))
    return _filled(parts, name)


def table_header(table: CorrectionTable, provenance: Sequence[str], *, name: str) -> str:
    """Return the text of a C99 header with the error table of an axis, in degrees.

    It defines `NAME_forward_deg(position_deg)` and `NAME_reverse_deg(position_deg)`, for the
    directions of the table: what to add to the command. It is linear between the positions, held
    beyond the ends, and 0 for a position that is no number.

    **Raises** `UsageError` for a name that C does not allow.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.control.compensation.c_header import table_header
    >>> from vttig_jax.control.compensation.correction import CorrectionTable
    >>> table = CorrectionTable(np.radians([0.0, 90.0]), {"forward": np.radians([0.01, 0.02])})
    >>> text = table_header(table, ("rig",), name="axis")
    >>> "axis_forward_deg(" in text, "axis_reverse_deg(" in text
    (True, False)

    ```
    """
    check_identifier(name)
    start, stop = (float(end) for end in np.degrees(table.positions[[0, -1]]))
    last = len(table.positions) - 1
    about = _comment(map(plain, provenance))
    grid = {"start": _number(start), "step": _number((stop - start) / last), "last": str(last)}
    parts = [("comment", {"about": about}), ("between", grid)]
    for direction, values in table.values.items():
        rows = rows_of(map(_number, np.degrees(values).tolist()))
        parts.append(("direction", {"direction": direction, "size": str(last + 1), "rows": rows}))
    return _filled(parts, name)


def _filled(parts: Iterable[tuple[str, dict[str, Any]]], name: str) -> str:
    """Return the named parts of the template, each with its values, as one header."""
    return "\n".join([*_texts(parts, name), f"#endif /* {name.upper()}_COMPENSATION_H */\n"])


def _texts(parts: Iterable[tuple[str, dict[str, Any]]], name: str) -> list[str]:
    """Return the named parts of the template, each with its values."""
    sections = _TEMPLATE.read_text("ascii").split("@@ ")[1:]
    texts = dict(section.split("\n", 1) for section in sections)
    names = {"name": name, "NAME": name.upper()}
    return [Template(texts[part]).substitute(values, **names) for part, values in parts]


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
        "driving_orders": rows_of(map(_number, driving)),
        "driven_orders": rows_of(map(_number, driven)),
        "places": rows_of(places),
        "waves": rows_of(waves),
        "place_type": f"unsigned {'char' if max(len(driving), len(driven)) <= 256 else 'short'}",
        "ratio": _number(float(compensation.ratio)),
        "spacing": _number(compensation.spacing_rad),
        "offset": _number(math.remainder(compensation.offset_rad, REV)),
        "tolerance": _number(compensation.tolerance_rad),
        "constant": _number(compensation.constant_rad),
        "closing": _number(compensation.closing_rad_per_mm),
        **{f"turn_{place}": _number(part) for place, part in enumerate(_TURN)},
    }


def _number(value: float | int) -> str:
    """Return a C constant of type double with exactly this value."""
    text = repr(float(value))
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def _about(compensation: Compensation, origin: HeaderOrigin, name: str, quantity: Quantity) -> str:
    """Return the text of the comment at the beginning of the header file."""
    zero = {
        "start": "where the encoders stood at the first sample of the log",
        "reading": "where the encoders read zero",
    }[origin.zero]
    orders = [{term[side] for term in compensation.terms} for side in (0, 1)]
    values: dict[str, Any] = {
        "pair": plain(origin.pair) or "a gear pair without a name",
        "version": plain(origin.version),
        "terms": len(compensation.terms),
        "ratio": compensation.ratio,
        "turns": compensation.hunting_turns,
        "error": f"{compensation.error_rad / ARCSEC:.1e}",
        "mean": f"{compensation.constant_rad / DEG:.6f}",
        "zero": zero,
        "driving_count": len(orders[0]),
        "driven_count": len(orders[1]),
        "tolerance": f"{compensation.tolerance_rad / DEG:.6f}",
        "spacing": f"{compensation.spacing_rad / DEG:.6g}",
    }
    parts = ["about"]
    if quantity == "shift":
        parts.append("about shift")
    if origin.backlash_deg:
        parts.append("about interval")
        values["low"], values["high"] = (f"{edge:.6g}" for edge in origin.backlash_deg)
    if origin.lowered_deg:
        parts.append("about lowered")
        values |= {"edge": origin.lowered_deg[0], "less": f"{origin.lowered_deg[1]:.6f}"}
    if origin.conditional_on:
        parts.append("about assumptions")
        values["assumed"] = ", ".join(map(plain, origin.conditional_on))
    if origin.sha256:
        parts.append("about logs")
        values["sha256"] = plain(origin.sha256)
    texts = _texts([(part, values) for part in parts], name)
    return _comment(paragraph for text in texts for paragraph in text.strip().split("\n\n"))


def _comment(paragraphs: Iterable[str]) -> str:
    """Return the lines of a C comment of some paragraphs."""
    wrapped = (
        wrap(paragraph, WIDTH, break_long_words=False, break_on_hyphens=False)
        for paragraph in paragraphs
    )
    return "\n *\n".join("\n".join(f" * {line}" for line in lines) for lines in wrapped)
