"""Guide logs of PHD2, which give the transmission error of a telescope mount.

The mount turns at sidereal rate, so that the time gives the angle of the worm. In every session
"Guiding Begins" the transmission error is RARawDistance × pixel scale / cos(declination), plus the
sum of all previous pulses × guide rate; this is the distance that the star would have without the
pulses. A pulse to the west counts positive, because it makes RARawDistance smaller. Dithering and a
new lock position move the zero of the distances; these moves are removed. Rows `DROP` have no star.
"""

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ...base.errors import LogError
from ...base.units import DEG
from .delimited import split, to_number
from .table import Table, table_of
from .text import Lines, printable
from .text_rows import SPARE

NAMES = ("time_s", "transmission_error_arcsec")
"""Names of the two columns of a session."""

HEADER = "Frame,Time,mount,"
"""Beginning of the line with the column names."""

FEWEST_ROWS = 8
"""Least number of rows of a session that is used (chosen)."""

_FIRST = re.compile(r".*PHD2? .*[Ll]og version|Guiding Begins at|Calibration Begins at")
_BEGIN = re.compile(r"Guiding Begins at\s*(.*)")
_END = re.compile(r"Guiding Ends at|Calibration Begins at|Log closed at|Log disabled at")
_FACTS = {
    "scale": re.compile(r"(?:Pixel|Image) scale = ([\d.]+) arc-sec/px"),
    "declination": re.compile(r"(?<!Cal )\bDec = (-?[\d.]+) deg"),
    "speed": re.compile(r"RA Guide Speed = ([\d.]+) a-s/s"),
    "rate": re.compile(r"\bxRate = ([\d.]+)"),
    "angle": re.compile(r"\bxAngle = (-?[\d.]+)"),
}
_POINT = r"(-?[\d.]+), (-?[\d.]+)"
_LOCK = re.compile(rf"Lock position = {_POINT}")
_DITHER = re.compile(rf"INFO: DITHER by {_POINT}")
_NEW_LOCK = re.compile(rf"INFO: .*new lock pos = {_POINT}")
_MOVING = re.compile(r"INFO: LOCK SHIFT, enabled = 1")
_BY_HAND = re.compile(r"INFO: Manual guide \(Mount\) (West|East) (\d+) ms")
_NEEDED = {"scale": "`Pixel scale = 2.00 arc-sec/px`", "declination": "`Dec = 20.0 deg`"}


def read_guide_log(text: Lines) -> Table | None:
    """Return time and transmission error of every session, and notes on the sessions.

    The result is None unless the first lines and a line of names are those of a guide log.

    **Raises** `LogError` if no session can be used; an incomplete last row is left out.
    """
    if not any(map(_FIRST.match, text[:SPARE])):
        return None
    if not any(line.startswith(HEADER) for line in text):
        return None
    lines = list(text)
    last = max((number for number, line in enumerate(lines, 1) if line.strip()), default=0)
    marks = [k for k, line in enumerate(lines) if _BEGIN.match(line) or _END.match(line)]
    sessions = [
        (begin[1].strip(), *_session(lines[k + 1 : end], k + 2, last))
        for k, end in pairwise([*marks, len(lines)])
        if (begin := _BEGIN.match(lines[k])) is not None
    ]
    several = sum(arrays is not None for _, arrays, _ in sessions) > 1
    columns: dict[str, np.ndarray] = {}
    reasons: list[str] = []
    notes = [
        "PHD2 guide log: transmission error = RARawDistance × pixel scale / cos(declination) + sum"
        " of the pulses × guide rate, positive where the mount lags"
    ]
    for number, (start, arrays, told) in enumerate(sessions, 1):
        if arrays is None:
            reasons.append(f"session {number}, {told}")
            continue
        names = [f"{number}/{name}" if several else name for name in NAMES]
        columns |= dict(zip(names, arrays, strict=True))
        notes.append(f"session {number}, {printable(start)}: {told}")
    left_out = "; ".join(reasons)
    if not columns:
        raise LogError(f"no session of guiding can be used: {left_out}.")
    if left_out:
        notes.append(f"left out: {left_out}")
    return table_of(columns.items(), notes)


def _session(
    lines: Sequence[str], first: int, last: int
) -> tuple[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None, str]:
    """Return time (s) and transmission error (arcsec) of one session, and a note on it.

    `first` is the number of its first line, and `last` that of the last line of the file, which may
    be incomplete. For a session that is not used the result is None and the reason.

    **Raises** `LogError` for a row of another form.
    """
    facts: dict[str, float] = {}
    lock: tuple[float, float] | None = None
    names: list[str] = []
    rows: list[tuple[float, float, float]] = []  # s, px, and ms of all pulses before the row
    moved_px = pulsed_ms = 0.0
    dropped, unusable = 0, ""
    for number, (line, following) in enumerate(pairwise((*lines, "")), first):
        if line.startswith(HEADER):
            names = split(line, ",")
        elif line.startswith("INFO:"):
            dither, new, hand = _DITHER.match(line), _NEW_LOCK.match(line), _BY_HAND.match(line)
            if dither is not None:
                moved_px += float(dither[1])
            elif new is not None and not _DITHER.match(following):  # a dither is logged twice
                if lock is None or "angle" not in facts:
                    unusable = "the lock position was moved, and the heading states no xAngle"
                else:
                    angle = facts["angle"] * DEG
                    across, up = float(new[1]) - lock[0], float(new[2]) - lock[1]
                    moved_px += float(across * np.cos(angle) + up * np.sin(angle))
            elif hand is not None:
                pulsed_ms += float(hand[2]) * (1 if hand[1] == "West" else -1)
            elif _MOVING.match(line):
                unusable = "the lock position was shifted all the time"
            if new is not None:
                lock = float(new[1]), float(new[2])
        elif not names:
            for key, pattern in _FACTS.items():
                if (match := pattern.search(line)) is not None:
                    facts.setdefault(key, float(match[1]))
            if (match := _LOCK.match(line)) is not None:
                lock = float(match[1]), float(match[2])
        elif line.strip() and not unusable:
            fields = split(line, ",")
            row = dict(zip(names, fields, strict=False))
            kind = row.get("mount", "").strip('"')
            texts = row.get("Time", ""), row.get("RARawDistance", ""), row.get("RADuration") or "0"
            time, raw, duration = (to_number(text, ".") for text in texts)
            if kind == "DROP":
                dropped += 1
            elif kind == "AO":
                unusable = "an adaptive optics unit was guided, not the mount"
            elif time is None or raw is None or duration is None or len(fields) < len(names) - 1:
                if number < last:
                    raise LogError(
                        "this row is no row of a guide log (Frame, Time, mount, …); remove it.",
                        where=f"line {number}",
                    )
            else:
                rows.append((time, raw + moved_px, pulsed_ms))
                pulsed_ms += duration * {"W": 1, "E": -1}.get(row.get("RADirection", "")[:1], 0)
    if unusable:
        return None, unusable
    if len(rows) < FEWEST_ROWS:
        return None, f"it has {len(rows)} rows"
    if lacking := [text for key, text in _NEEDED.items() if key not in facts]:
        return None, f"the heading lacks {' and '.join(lacking)}"
    times, distances_px, pulses_ms = np.array(rows).T.copy()
    speed, rate = facts.get("speed"), facts.get("rate")
    if pulses_ms.any() and speed is None and rate is None:
        return None, "the heading states neither RA Guide Speed nor xRate"
    arcsec_per_px = facts["scale"] / float(np.cos(facts["declination"] * DEG))
    calibrated = None if rate is None else rate * arcsec_per_px
    error = distances_px * arcsec_per_px + pulses_ms / 1000 * (speed or calibrated or 0.0)
    note = f"{len(rows)} rows over {times[-1] - times[0]:.0f} s"
    note += f", {dropped} more without a star" * bool(dropped)
    if speed is not None:
        note += f", guide rate {speed:.4g}″/s as the mount reports"
        note += f" (the calibration measured {calibrated:.4g}″/s)" if calibrated else ""
    elif calibrated is not None:
        note += f", guide rate {calibrated:.4g}″/s from xRate"
    return (times, error), note
