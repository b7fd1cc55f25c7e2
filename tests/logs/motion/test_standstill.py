"""Tables of readings at standstill: which logs are one, and on which flank every reading lies."""

from pathlib import Path

import numpy as np
import pytest

from tests.logs.profiles import counts, drive, geared, of_degrees, spec, trapezoid
from tests.logs.profiles import flanks as states
from vttig_jax import read_log
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments

CORPUS = Path(__file__).parents[2] / "corpus"
PLACES = np.arange(0.0, 360.0, 15.0)


def table(angle, interval=None, **columns):
    """A log of a 1:1 shaft that was read at places, by default at unequal times."""
    count = len(angle)
    took = np.random.default_rng(0).uniform(8.0, 15.0, count) if interval is None else interval
    time = np.cumsum(np.broadcast_to(took, count))
    return of_degrees(time, angle, angle + np.sin(np.radians(angle)), drive("1"), **columns)


def flanks(log):
    """The flank of every reading, as one letter each."""
    found = assigned_segments(log)
    assert found.still
    return "".join("-AB"[one] for one in states(found))


BACK, AGAIN = np.append(PLACES, PLACES[-2::-1]), np.append(PLACES, PLACES[::-1])


@pytest.mark.parametrize(
    ("angle", "up", "down"),
    [
        (PLACES, 24, 0),
        (PLACES[::-1], 0, 24),
        (BACK, 24, 23),
        (AGAIN, 24, 24),
        (np.repeat(BACK, 3), 72, 69),
        (np.repeat(AGAIN, 3), 72, 72),
        (np.tile(PLACES, 3), 72, 0),
        (np.tile(np.repeat(PLACES, 2), 2), 96, 0),
    ],
)
def test_the_flank_is_that_of_the_approach(angle, up, down):
    """Up, down, both ways, places read three times, and ways back to the start."""
    assert flanks(table(angle)) == "A" * up + "B" * down


def test_a_column_of_directions_says_the_approach():
    direction = np.tile([1, -1, 0], 8)
    assert flanks(table(PLACES, direction=direction)) == "AB-" * 8


def test_words_decide_and_what_they_contradict_is_said():
    """Words decide the flank also against the order of the rows, and the sentence has a cure."""
    options = {"ratio": "1:1", "sample_rate_hz": 1.0}
    options["columns"] = {"driving": "position_deg", "driven": "measured_deg"}
    log = read_log(CORPUS / "still_words_against_the_order.csv", **options)
    assert flanks(log) == "B" * 12 + "A" * 12
    assert "--invert driving" in assigned_segments(log).notes[0]


def test_a_shaft_that_turns_is_no_table():
    time, angle, _ = trapezoid(rate=100.0)
    log = of_degrees(time, angle, geared(angle)[0])
    assert not assigned_segments(log).still
    assert assigned_segments(log, still=True).still


def test_counts_that_are_read_many_times_each_are_no_table():
    """A slow shaft with coarse counts rests behind every count, for far less than a reading."""
    time, angle, _ = trapezoid(rate=2000.0)
    readings = [np.rint(one / 0.36).astype(int) for one in (angle, angle * 9 / 16)]
    assert np.mean(np.diff(readings[0]) == 0) > 0.5
    encoder = {"counts_per_rev": 1000}
    pair = spec(driving_encoder=encoder, driven_encoder=encoder)
    assert not assigned_segments(EncoderLog.from_arrays(time, *readings, pair=pair)).still
    assert not assigned_segments(table(3.0 * np.arange(400.0), interval=1.0)).still


@pytest.mark.parametrize("modulus", [2**16, 2**32])
def test_a_counter_that_wraps_and_a_wild_reading_are_no_table(modulus):
    time, angle, _ = trapezoid(rate=100.0)
    driven, _ = geared(angle)
    reading = counts(angle)
    wild = np.where(np.arange(len(time)) == 70, 2**33, reading)
    for channel in ((reading - 7000) % modulus, wild):
        log = EncoderLog.from_arrays(time, channel, counts(driven), pair=spec())
        assert not assigned_segments(log).still
