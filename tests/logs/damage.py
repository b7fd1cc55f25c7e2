"""Small logs as text, and what can happen to them: hypothesis strategies of damaged logs.

A log is a header and rows of time, driving and driven counts; a damage changes its columns before
they are written, its lines, or the bytes of the file. `damaged_logs()` draws one to three of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from random import Random

import numpy as np
from hypothesis import strategies as st

from .mutations import damaged_bytes, damaged_text
from .profiles import counts, geared, trapezoid

RATE = 250.0
PER_TURN = 90_000

PAIR = """
[pair]
module_mm = 2.0
pressure_angle_deg = 20.0
centre_distance_mm = 125.12
[driving]
teeth = 45
encoder = { counts_per_rev = 90000 }
[driven]
teeth = 80
encoder = { counts_per_rev = 90000 }
[fit]
driving_orders = [1, 2]
driven_orders = [1, 2]
mesh_orders = 0
"""


@dataclass(frozen=True, eq=False)
class Text:
    """A log on its way to the disk: columns, then lines, then bytes."""

    time: np.ndarray
    driving: np.ndarray
    driven: np.ndarray
    names: tuple[str, ...] = ("time_s", "driving_counts", "driven_counts")
    order: tuple[int, ...] = (0, 1, 2)
    delimiter: str = ","
    decimal: str = "."
    texts: tuple[Callable[[str], str], ...] = ()
    encoding: str = "utf-8"
    mutated: tuple[Callable[..., bytes], int] | None = None

    def to_bytes(self) -> bytes:
        """The file."""
        columns = [
            np.char.mod("%.6f", self.time),
            *(np.char.mod("%d", np.asarray(c, np.int64)) for c in (self.driving, self.driven)),
        ]
        header = self.delimiter.join(self.names[k] for k in self.order)
        rows = zip(*(columns[k].tolist() for k in self.order), strict=True)
        body = [self.delimiter.join(row).replace(".", self.decimal) for row in rows]
        content = "\n".join([header, *body, ""])
        for change in self.texts:
            content = change(content)
        if self.mutated is None:
            return content.encode(self.encoding, "replace")
        change, seed = self.mutated
        if change is damaged_text:
            return damaged_text(content, Random(seed))
        return damaged_bytes(content.encode(self.encoding, "replace"), Random(seed))


@dataclass(frozen=True, eq=False)
class Damaged:
    """A file and the names of what happened to it."""

    damages: tuple[str, ...]
    content: bytes = field(repr=False)


@cache
def clean_log() -> Text:
    """Five driving turns and back at 60 rpm, with play and eccentricities."""
    time, angle, _ = trapezoid(rate=RATE, reversal=1800.0, ramp=0.2, dwell=0.3)
    driven, _ = geared(angle, noise=0.001)
    return Text(time, counts(angle), counts(driven))


def _row(draw: st.DrawFn, text: Text) -> int:
    middle = len(text.time) // 2
    return draw(st.integers(min(30, middle), max(len(text.time) - 30, middle)))


def _role(draw: st.DrawFn) -> str:
    return draw(st.sampled_from(["driving", "driven"]))


def _with(text: Text, role: str, values: np.ndarray) -> Text:
    return replace(text, **{role: values})


def _keep(text: Text, rows: np.ndarray) -> Text:
    return replace(text, time=text.time[rows], driving=text.driving[rows], driven=text.driven[rows])


# What happens to the readings.


def wraps(draw: st.DrawFn, text: Text) -> Text:
    role = _role(draw)
    modulus = draw(st.sampled_from([2**12, 2**14, 2**16, 2**24, 2**32, PER_TURN]))
    start = draw(st.integers(0, modulus - 1))
    values = (getattr(text, role).astype(np.int64) + start) % modulus
    return _with(text, role, values - modulus // 2 if draw(st.booleans()) else values)


def reset(draw: st.DrawFn, text: Text) -> Text:
    role, row = _role(draw), _row(draw, text)
    values = getattr(text, role).astype(np.int64).copy()
    values[row:] -= values[row]
    return _with(text, role, values)


def index_reload(draw: st.DrawFn, text: Text) -> Text:
    """At each index pulse the counter takes up a fixed value."""
    role = _role(draw)
    values = getattr(text, role).astype(np.int64)
    off = draw(st.integers(-5000, 5000))
    return _with(text, role, values + off * (values // PER_TURN))


def gap(draw: st.DrawFn, text: Text) -> Text:
    row, length = _row(draw, text), draw(st.integers(1, 800))
    return _keep(text, np.r_[0:row, min(row + length, len(text.time) - 5) : len(text.time)])


def duplicated_rows(draw: st.DrawFn, text: Text) -> Text:
    row, length = _row(draw, text), draw(st.integers(1, 20))
    return _keep(text, np.r_[0 : row + length, row : len(text.time)].clip(0, len(text.time) - 1))


def removed_rows(draw: st.DrawFn, text: Text) -> Text:
    share, seed = draw(st.floats(0.001, 0.99)), draw(st.integers(0, 99))
    return _keep(text, np.random.default_rng(seed).random(len(text.time)) >= share)


def shuffled_rows(draw: st.DrawFn, text: Text) -> Text:
    row, length = _row(draw, text), draw(st.integers(2, 20))
    rows = np.arange(len(text.time))
    np.random.default_rng(row).shuffle(rows[row : row + length])
    return _keep(text, rows)


def jitter(draw: st.DrawFn, text: Text) -> Text:
    size = draw(st.floats(0.0, 0.9)) / RATE
    noise = np.random.default_rng(1).uniform(-0.5, 0.5, len(text.time)) * size
    return replace(text, time=text.time + noise)


def coarse_time(draw: st.DrawFn, text: Text) -> Text:
    return replace(text, time=np.round(text.time, draw(st.integers(0, 3))))


def half_rate(draw: st.DrawFn, text: Text) -> Text:
    role, n = _role(draw), draw(st.integers(2, 5))
    values = getattr(text, role)
    return _with(text, role, values[np.arange(len(values)) // n * n])


def saturation(draw: st.DrawFn, text: Text) -> Text:
    role = _role(draw)
    values = getattr(text, role)
    limit = draw(st.floats(0.05, 1.0)) * float(values.max())
    return _with(text, role, np.minimum(values, int(limit)))


def slip(draw: st.DrawFn, text: Text) -> Text:
    role, row = _role(draw), _row(draw, text)
    size, length = draw(st.integers(-500, 500)), draw(st.integers(1, 20))
    ramp = np.clip((np.arange(len(text.time)) - row) / length, 0, 1)
    return _with(text, role, getattr(text, role) + np.rint(size * ramp).astype(np.int64))


def late_readings(draw: st.DrawFn, text: Text) -> Text:
    role, share = _role(draw), draw(st.floats(0.0005, 0.3))
    generator = np.random.default_rng(draw(st.integers(0, 99)))
    late = text.time - generator.uniform(0.003, 0.011, len(text.time))
    values = getattr(text, role)
    which = generator.random(len(text.time)) < share
    back = np.interp(late, np.sort(text.time), values)
    return _with(text, role, np.where(which, back, values).astype(np.int64))


def wild_reading(draw: st.DrawFn, text: Text) -> Text:
    role, row = _role(draw), draw(st.integers(0, len(text.time) - 1))
    values = getattr(text, role).astype(np.int64).copy()
    values[row] = draw(st.sampled_from([0, -1, 2**31 - 1, -(2**31), 2**53, 2**62, 10**6]))
    return _with(text, role, values)


def wrong_ratio(draw: st.DrawFn, text: Text) -> Text:
    factor = draw(st.sampled_from([0.97, 1.03, 0.5, 2.0, -1.0, 1 / 57.3, 1e-6]))
    return replace(text, driven=np.rint(factor * text.driven).astype(np.int64))


def few_rows(draw: st.DrawFn, text: Text) -> Text:
    return _keep(text, np.arange(draw(st.integers(0, 300))).clip(0, len(text.time) - 1))


def swapped_columns(draw: st.DrawFn, text: Text) -> Text:
    return replace(text, order=draw(st.permutations([0, 1, 2]).map(tuple)))


def swapped_names(draw: st.DrawFn, text: Text) -> Text:
    first, second = draw(st.sampled_from([(1, 2), (0, 1), (0, 2)]))
    names = list(text.names)
    names[first], names[second] = names[second], names[first]
    return replace(text, names=tuple(names))


# What happens to the text.


def thousands(draw: st.DrawFn, text: Text) -> Text:
    mark = draw(st.sampled_from([",", ".", "'", " ", "\u00a0"]))

    def grouped(field: str) -> str:
        return f"{int(field):,}".replace(",", mark) if field.lstrip("-").isdigit() else field

    def change(content: str) -> str:
        lines = content.split("\n")
        return "\n".join(text.delimiter.join(map(grouped, x.split(text.delimiter))) for x in lines)

    return replace(text, texts=(*text.texts, change))


def repeated_header(draw: st.DrawFn, text: Text) -> Text:
    row = _row(draw, text)

    def change(content: str) -> str:
        lines = content.split("\n")
        return "\n".join([*lines[:row], lines[0], *lines[row:]])

    return replace(text, texts=(*text.texts, change))


def preamble(draw: st.DrawFn, text: Text) -> Text:
    above = draw(st.lists(st.text(max_size=20), max_size=3))
    return replace(text, texts=(*text.texts, lambda content: "\n".join([*above, content])))


def degree_header(draw: st.DrawFn, text: Text) -> Text:
    names = ("time_s", "driving [°]", "driven [°]")
    encoding = draw(st.sampled_from(["cp1252", "utf-8", "utf-16", "utf-16-le", "utf-32"]))
    return replace(text, names=names, encoding=encoding)


def decimal_commas(draw: st.DrawFn, text: Text) -> Text:
    return replace(text, decimal=",", delimiter=draw(st.sampled_from([";", "\t", ",", "|"])))


def any_text(draw: st.DrawFn, text: Text) -> Text:
    return replace(text, mutated=(damaged_text, draw(st.integers(0, 2**32))))


def any_bytes(draw: st.DrawFn, text: Text) -> Text:
    return replace(text, mutated=(damaged_bytes, draw(st.integers(0, 2**32))))


READINGS = (
    wraps,
    reset,
    index_reload,
    gap,
    duplicated_rows,
    removed_rows,
    shuffled_rows,
    jitter,
    coarse_time,
    half_rate,
    saturation,
    slip,
    late_readings,
    wild_reading,
    wrong_ratio,
    few_rows,
    swapped_columns,
    swapped_names,
)
TEXTS = (thousands, repeated_header, preamble, degree_header, decimal_commas, any_text, any_bytes)


@st.composite
def damaged_logs(draw: st.DrawFn) -> Damaged:
    """A log with one to three damages."""
    text = clean_log()
    # Readings before the text, so that each damage finds what it changes.
    kinds = [*READINGS, *TEXTS]
    chosen = draw(st.lists(st.sampled_from(kinds), min_size=1, max_size=3, unique=True))
    for damage in sorted(chosen, key=kinds.index):
        if len(text.time) > 60 or damage not in READINGS:
            text = damage(draw, text)
    return Damaged(tuple(damage.__name__ for damage in chosen), text.to_bytes())
