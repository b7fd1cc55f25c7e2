"""Guide log of PHD2: transmission error of a telescope mount, from star distances and guide pulses.

The mount turns at sidereal rate, so that the time gives the angle of the worm. In every session
"Guiding Begins" the transmission error is RARawDistance × pixel scale / cos(declination), plus the
sum of all previous pulses × guide rate; this is the distance that the star would have without the
pulses. A pulse to the west counts positive, because it makes RARawDistance smaller. Dithering and a
new lock position move the zero of the distances; these moves are removed. Rows `DROP` have no star.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...base.errors import LogError
from ...base.units import DEG
from .delimited import split, to_number
from .layouts import SPARE, Found
from .table import Table
from .text import Lines, printable

NAMES = ("time_s", "transmission_error_arcsec")
"""Names of the two columns of a session."""

HEADER = "Frame,Time,mount,"
"""Beginning of the line with the column names."""

FEWEST_ROWS = 8
"""Least number of rows of a session that is used (chosen)."""

APART = 1.2
"""A note reports the calibrated guide rate if it differs from the reported guide rate by at least
this factor (chosen)."""

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
_NEEDED = {
    "scale": "`Pixel scale = 2.00 arc-sec/px`",
    "declination": "`Dec = 20.0 deg`",
}


@dataclass
class Session:
    """One session of guiding with the values of the file.

    **Arguments**
    - `start`: date and time of the beginning. - `line`: number of the line where it begins.
    - `facts`: key of `_FACTS` → number in the heading.
    - `lock`: lock position in px. - `time`: stamps in s.
    - `distance`: RARawDistance corrected for the moves of the lock position, in px.
    - `pulses`: sum of the pulses before each row in ms, positive to the west.
    - `dropped`: number of rows without a star. - `unusable`: why the session is not used, or "".
    """

    start: str
    line: int
    facts: dict[str, float] = field(default_factory=dict)
    lock: tuple[float, float] | None = None
    time: list[float] = field(default_factory=list)
    distance: list[float] = field(default_factory=list)
    pulses: list[float] = field(default_factory=list)
    dropped: int = 0
    unusable: str = ""
    _names: list[str] = field(default_factory=list)
    _moved: float = 0.0
    _pulsed: float = 0.0

    def add_line(self, line: str, following: str, place: str) -> None:
        """Store the content of one line; `following` is the next line, `place` is for messages.

        **Raises** `LogError` for a row of another form.
        """
        if line.startswith(HEADER):
            self._names = split(line, ",")
        elif line.startswith("INFO:"):
            self._event(line, following)
        elif not self._names:
            self._heading(line)
        elif not self.unusable:
            self._row(split(line, ","), place)

    def _heading(self, line: str) -> None:
        for key, pattern in _FACTS.items():
            match = pattern.search(line)
            if match is not None:
                self.facts.setdefault(key, float(match[1]))
        match = _LOCK.match(line)
        if match is not None:
            self.lock = float(match[1]), float(match[2])

    def _event(self, line: str, following: str) -> None:
        """Store a move of the lock position or a manual guide pulse from a line INFO."""
        dither, lock, hand = _DITHER.match(line), _NEW_LOCK.match(line), _BY_HAND.match(line)
        if dither is not None:
            self._moved += float(dither[1])
        elif lock is not None and not _DITHER.match(following):  # a dither is logged twice
            self._relock(float(lock[1]), float(lock[2]))
        elif hand is not None:
            self._pulsed += float(hand[2]) * (1 if hand[1] == "West" else -1)
        elif _MOVING.match(line):
            self.unusable = "the lock position was shifted all the time"
        if lock is not None:
            self.lock = float(lock[1]), float(lock[2])

    def _relock(self, x: float, y: float) -> None:
        """Store the move (px) to a new lock position (x, y) along the axis of right ascension."""
        if self.lock is None or "angle" not in self.facts:
            self.unusable = "the lock position was moved, and the heading states no xAngle"
            return
        across, up = x - self.lock[0], y - self.lock[1]
        angle = self.facts["angle"] * DEG
        self._moved += float(across * np.cos(angle) + up * np.sin(angle))

    def _row(self, fields: list[str], place: str) -> None:
        row = dict(zip(self._names, fields, strict=False))
        kind = row.get("mount", "").strip('"')
        if kind == "DROP":
            self.dropped += 1
            return
        if kind == "AO":
            self.unusable = "an adaptive optics unit was guided, not the mount"
            return
        texts = row.get("Time", ""), row.get("RARawDistance", ""), row.get("RADuration") or "0"
        time, raw, duration = (to_number(text, ".") for text in texts)
        if time is None or raw is None or duration is None or len(fields) < len(self._names) - 1:
            raise LogError(
                "this row is no row of a guide log (Frame, Time, mount, …); remove it.", where=place
            )
        self.time.append(time)
        self.distance.append(raw + self._moved)
        self.pulses.append(self._pulsed)
        self._pulsed += duration * {"W": 1, "E": -1}.get(row.get("RADirection", "")[:1], 0)

    @property
    def reason(self) -> str:
        """Reason why the session is not used, or ""."""
        lacking = [text for key, text in _NEEDED.items() if key not in self.facts]
        if self.unusable:
            return self.unusable
        if len(self.time) < FEWEST_ROWS:
            return f"it has {len(self.time)} rows"
        if lacking:
            return f"the heading lacks {' and '.join(lacking)}"
        if any(self.pulses) and not {"speed", "rate"} & set(self.facts):
            return "the heading states neither RA Guide Speed nor xRate"
        return ""

    @property
    def _arcsec_per_px(self) -> float:
        return self.facts["scale"] / float(np.cos(self.facts["declination"] * DEG))

    @property
    def _calibrated(self) -> float | None:
        """Guide rate that the calibration of the camera measured, in arcsec/s."""
        return self.facts["rate"] * self._arcsec_per_px if "rate" in self.facts else None

    @property
    def error_arcsec(self) -> Float[np.ndarray, " n"]:
        """Transmission error of the mount in arcsec."""
        rate = self.facts.get("speed") or self._calibrated or 0.0
        pulses = np.array(self.pulses) / 1000 * rate
        return np.array(self.distance) * self._arcsec_per_px + pulses

    @property
    def note(self) -> str:
        """Start, length and guide rate in one sentence."""
        dropped = f", {self.dropped} more without a star" if self.dropped else ""
        text = f"{len(self.time)} rows over {self.time[-1] - self.time[0]:.0f} s{dropped}"
        speed, calibrated = self.facts.get("speed"), self._calibrated
        if speed is not None:
            text += f", guide rate {speed:.4g}″/s as the mount reports"
            if calibrated and not 1 / APART < calibrated / speed < APART:
                text += f" (the calibration measured {calibrated:.4g}″/s)"
        elif calibrated is not None:
            text += f", guide rate {calibrated:.4g}″/s from xRate"
        return text


def read_guide_log(text: Lines, source: str) -> Found | None:
    """Return time and transmission error of every session, and notes on the sessions.

    The result is None unless the first lines and a line of names are those of a guide log.

    **Raises** `LogError` if no session can be used; an incomplete last row is left out.
    """
    if not any(map(_FIRST.match, text[:SPARE])):
        return None
    if not any(line.startswith(HEADER) for line in text):
        return None
    sessions = dict(enumerate(_sessions(list(text), source), 1))
    kept = {number: one for number, one in sessions.items() if not one.reason}
    reasons = [f"session {n}, {one.reason}" for n, one in sessions.items() if one.reason]
    left_out = "; ".join(reasons)
    if not kept:
        raise LogError(f"no session of guiding can be used: {left_out}.", where=source)
    columns: dict[str, np.ndarray] = {}
    notes = [
        "PHD2 guide log: transmission error = RARawDistance × pixel scale / cos(declination) + sum"
        " of the pulses × guide rate, positive where the mount lags"
    ]
    for number, one in kept.items():
        names = [f"{number}/{name}" if len(kept) > 1 else name for name in NAMES]
        columns |= dict(zip(names, (np.array(one.time), one.error_arcsec), strict=True))
        notes.append(f"session {number}, {printable(one.start)}: {one.note}")
    if left_out:
        notes.append(f"left out: {left_out}")
    return Table(tuple(columns), tuple(columns.values()), source), tuple(notes)


def _sessions(lines: Sequence[str], source: str) -> Iterator[Session]:
    """Yield all sessions of guiding in the order of the file."""
    current: Session | None = None
    last = next((k for k in range(len(lines) - 1, -1, -1) if lines[k].strip()), 0)
    for k, line in enumerate(lines):
        begin = _BEGIN.match(line)
        if begin is not None or _END.match(line):
            if current is not None:
                yield current
            current = None if begin is None else Session(begin[1].strip(), k + 1)
        elif current is not None and line.strip():
            following = lines[k + 1] if k + 1 < len(lines) else ""
            try:
                current.add_line(line, following, f"{source}: line {k + 1}")
            except LogError:
                if k < last:
                    raise
    if current is not None:
        yield current
