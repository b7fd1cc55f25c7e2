"""Small logs as text, and what can happen to their readings: hypothesis strategies.

A damage changes one channel, the time, which rows there are, or the order of the columns and names.
`damaged_logs()` draws one to three of them. What can happen to the text stands in `mutations.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from hypothesis import strategies as st

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
    """A log on its way to the disk."""

    time: np.ndarray
    driving: np.ndarray
    driven: np.ndarray
    names: tuple[str, ...] = ("time_s", "driving_counts", "driven_counts")
    order: tuple[int, ...] = (0, 1, 2)

    def to_bytes(self) -> bytes:
        """The file."""
        readings = (np.asarray(one, np.int64) for one in (self.driving, self.driven))
        columns = [np.char.mod("%.6f", self.time), *(np.char.mod("%d", one) for one in readings)]
        rows = zip(*(columns[k].tolist() for k in self.order), strict=True)
        return "\n".join(map(",".join, [[self.names[k] for k in self.order], *rows, ""])).encode()


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


def _row(draw: st.DrawFn, count: int) -> int:
    middle = count // 2
    return draw(st.integers(min(30, middle), max(count - 30, middle)))


def _random(draw: st.DrawFn) -> np.random.Generator:
    return np.random.default_rng(draw(st.integers(0, 99)))


# The whole numbers of one channel, at their times.


def wraps(draw: st.DrawFn, values: np.ndarray, _) -> np.ndarray:
    modulus = draw(st.sampled_from([2**12, 2**14, 2**16, 2**24, 2**32, PER_TURN]))
    values = (values + draw(st.integers(0, modulus - 1))) % modulus
    return values - modulus // 2 if draw(st.booleans()) else values


def reset(draw: st.DrawFn, values: np.ndarray, _) -> np.ndarray:
    row = _row(draw, len(values))
    return values - values[row] * (np.arange(len(values)) >= row)


def index_reload(draw: st.DrawFn, values: np.ndarray, _) -> np.ndarray:
    """At each index pulse the counter takes up a fixed value."""
    return values + draw(st.integers(-5000, 5000)) * (values // PER_TURN)


def half_rate(draw: st.DrawFn, values: np.ndarray, _) -> np.ndarray:
    every = draw(st.integers(2, 5))
    return values[np.arange(len(values)) // every * every]


def saturation(draw: st.DrawFn, values: np.ndarray, _) -> np.ndarray:
    return np.minimum(values, int(draw(st.floats(0.05, 1.0)) * float(values.max())))


def slip(draw: st.DrawFn, values: np.ndarray, _) -> np.ndarray:
    since = np.arange(len(values)) - _row(draw, len(values))
    ramp = np.clip(since / draw(st.integers(1, 20)), 0, 1)
    return values + np.rint(draw(st.integers(-500, 500)) * ramp).astype(np.int64)


def late_readings(draw: st.DrawFn, values: np.ndarray, time: np.ndarray) -> np.ndarray:
    share, generator = draw(st.floats(0.0005, 0.3)), _random(draw)
    late = time - generator.uniform(0.003, 0.011, len(time))
    which = generator.random(len(time)) < share
    return np.where(which, np.interp(late, np.sort(time), values), values).astype(np.int64)


def wild_reading(draw: st.DrawFn, values: np.ndarray, _) -> np.ndarray:
    wild = draw(st.sampled_from([0, -1, 2**31 - 1, -(2**31), 2**53, 2**62, 10**6]))
    return np.where(np.arange(len(values)) == draw(st.integers(0, len(values) - 1)), wild, values)


# The rows that the log still has.


def gap(draw: st.DrawFn, count: int) -> np.ndarray:
    row = _row(draw, count)
    return np.r_[0:row, min(row + draw(st.integers(1, 800)), count - 5) : count]


def duplicated_rows(draw: st.DrawFn, count: int) -> np.ndarray:
    row = _row(draw, count)
    return np.r_[0 : row + draw(st.integers(1, 20)), row:count].clip(0, count - 1)


def removed_rows(draw: st.DrawFn, count: int) -> np.ndarray:
    share = draw(st.floats(0.001, 0.99))
    return np.flatnonzero(_random(draw).random(count) >= share)


def shuffled_rows(draw: st.DrawFn, count: int) -> np.ndarray:
    row, rows = _row(draw, count), np.arange(count)
    _random(draw).shuffle(rows[row : row + draw(st.integers(2, 20))])
    return rows


def few_rows(draw: st.DrawFn, count: int) -> np.ndarray:
    return np.arange(draw(st.integers(0, 300))).clip(0, count - 1)


# The time, the ratio, and what the columns are called.


def jitter(draw: st.DrawFn, text: Text) -> Text:
    noise = draw(st.floats(0.0, 0.9)) / RATE * _random(draw).uniform(-0.5, 0.5, len(text.time))
    return replace(text, time=text.time + noise)


def coarse_time(draw: st.DrawFn, text: Text) -> Text:
    return replace(text, time=np.round(text.time, draw(st.integers(0, 3))))


def wrong_ratio(draw: st.DrawFn, text: Text) -> Text:
    factor = draw(st.sampled_from([0.97, 1.03, 0.5, 2.0, -1.0, 1 / 57.3, 1e-6]))
    return replace(text, driven=np.rint(factor * text.driven).astype(np.int64))


def swapped_columns(draw: st.DrawFn, text: Text) -> Text:
    return replace(text, order=draw(st.permutations([0, 1, 2]).map(tuple)))


def swapped_names(draw: st.DrawFn, text: Text) -> Text:
    first, second = draw(st.sampled_from([(1, 2), (0, 1), (0, 2)]))
    names = list(text.names)
    names[first], names[second] = names[second], names[first]
    return replace(text, names=tuple(names))


def _named(*damages: Callable) -> dict[str, Callable]:
    return {damage.__name__: damage for damage in damages}


OF_A_CHANNEL = _named(
    wraps, reset, index_reload, half_rate, saturation, slip, late_readings, wild_reading
)
OF_THE_ROWS = _named(gap, duplicated_rows, removed_rows, shuffled_rows, few_rows)
OF_THE_LOG = _named(jitter, coarse_time, wrong_ratio, swapped_columns, swapped_names)


@st.composite
def damaged_logs(draw: st.DrawFn) -> Damaged:
    """A log with one to three damages."""
    text = clean_log()
    kinds = st.sampled_from([*OF_A_CHANNEL, *OF_THE_ROWS, *OF_THE_LOG])
    chosen = draw(st.lists(kinds, min_size=1, max_size=3, unique=True))
    for name in chosen:
        if len(text.time) <= 60:
            break
        if name in OF_THE_ROWS:
            rows = OF_THE_ROWS[name](draw, len(text.time))
            columns = {"time": text.time, "driving": text.driving, "driven": text.driven}
            text = replace(text, **{role: column[rows] for role, column in columns.items()})
        elif name in OF_A_CHANNEL:
            role = draw(st.sampled_from(["driving", "driven"]))
            values = np.asarray(getattr(text, role), np.int64)
            text = replace(text, **{role: OF_A_CHANNEL[name](draw, values, text.time)})
        else:
            text = OF_THE_LOG[name](draw, text)
    return Damaged(tuple(chosen), text.to_bytes())
