import numpy as np
import pytest

from tests.logs.profiles import DEG
from vttig_jax.base.errors import LogError
from vttig_jax.logs.channel.channel import make_channel
from vttig_jax.logs.source import Source
from vttig_jax.pair.schema import Encoder, LogLayout

pytestmark = pytest.mark.smoke

ENCODER = Encoder(counts_per_rev=90_000)
SOURCE = Source("log.csv", {"driving": "a_counts"}, lambda row: row + 2)


def channel(values, unit="counts", encoder=ENCODER, layout=LogLayout(), time=None):
    time = np.arange(len(values)) / 1000.0 if time is None else time
    return make_channel("driving", values, unit, encoder, time, layout, SOURCE)


RAMP = np.arange(0, 1_000_000, 45)


def test_what_a_channel_of_counts_knows():
    made, notes = channel(RAMP)
    assert made.reading.dtype == np.int64 and made.per_turn == 90_000 and notes == ()
    assert made.resolution == pytest.approx(14.4 / 3600 * DEG)
    assert made.turns == pytest.approx(RAMP[-1] / 90_000)


def test_counts_beyond_2_to_the_40_lose_nothing():
    far, _ = channel(RAMP + 2**50)
    near, _ = channel(RAMP)
    np.testing.assert_array_equal(far.angle, near.angle)
    np.testing.assert_array_equal(far.reading - 2**50, RAMP)
    zero, _ = channel(RAMP + 2**42, layout=LogLayout(zero="reading"))
    turns, rest = zero.turns_and_rest()
    np.testing.assert_array_equal(turns, (RAMP + 2**42) // 90_000)
    np.testing.assert_allclose(rest, (RAMP + 2**42) % 90_000 * (2 * np.pi / 90_000), rtol=1e-15)


UNITS = {"deg": DEG, "rad": 1.0, "rev": 2 * np.pi, "arcsec": DEG / 3600, "urad": 1e-6}
UNITS |= {"arcmin": DEG / 60, "mdeg": DEG / 1000, "mrad": 1e-3, "gon": np.pi / 200}


@pytest.mark.parametrize("unit", UNITS)
def test_units(unit):
    values = np.linspace(0, 100, 50) ** 1.1
    made, _ = channel(values, unit=unit, encoder=Encoder())
    np.testing.assert_allclose(made.angle, values * UNITS[unit], rtol=1e-14)


def test_modulus_given_and_detected():
    wrapped = RAMP % 36_000
    given, notes = channel(wrapped, encoder=Encoder(counts_per_rev=90_000, modulus=36_000))
    np.testing.assert_array_equal(given.reading, RAMP)
    assert given.modulus == 36_000 and given.wraps == RAMP[-1] // 36_000
    assert "as given" in notes[0]
    found, notes = channel(RAMP % 65_536)
    np.testing.assert_array_equal(found.reading, RAMP)
    assert found.modulus == 65_536 and "65536" in notes[0] and "detected" in notes[0]


@pytest.mark.parametrize(
    ("values", "options", "words"),
    [
        (RAMP % 36_000, {}, ["-35955 counts", "line 802", "`a_counts`", "modulus"]),
        (RAMP, {"encoder": Encoder(counts_per_rev=90_000, modulus=65_536)}, ["65536", "span"]),
        (RAMP, {"encoder": Encoder()}, ["counts_per_rev", "[driving]"]),
        (np.full(50, 7), {}, ["constant at 7"]),
        (np.where(np.arange(90) == 40, 100, 7), {}, ["apart from 1 single", "--column driving"]),
        (np.arange(90.0) + 217 * (np.arange(90) >= 44), {"unit": "deg"}, ["line 46", "218"]),
        (RAMP + 2.0**53, {}, ["2^53"]),
        (np.where(RAMP == 900, 2**62, RAMP), {}, ["line 22", "4611686018427387904", "more than"]),
    ],
)
def test_refused(values, options, words):
    with pytest.raises(LogError) as caught:
        channel(values, **options)
    assert all(word in str(caught.value) for word in words), caught.value


def test_a_pause_hides_wraps():
    time = np.arange(len(RAMP)) / 1000.0
    time[10_000:] += 0.3
    values = (45_000 * time).astype(np.int64)
    made, _ = channel(values % 65_536, time=time)
    np.testing.assert_array_equal(made.reading, values)
    time[10_000:] += 2.0
    values = (45_000 * time).astype(np.int64)
    with pytest.raises(LogError, match=r"pauses for 2\.301 s"):
        channel(values % 65_536, time=time)
    assert channel(values, time=time)[0].wraps == 0


def test_interpolated_counts_are_read_and_noted():
    made, notes = channel(RAMP[:1000] + 0.25)
    assert made.reading.dtype == np.float64 and made.per_turn is None
    assert "interpolated" in notes[0]
    np.testing.assert_allclose(made.angle, RAMP[:1000] * (2 * np.pi / 90_000), atol=1e-9)
