from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.logs.profiles import counts, geared, late, trapezoid
from vttig_jax.base.errors import LogError
from vttig_jax.logs.channel.channel import make_channel, without_shared_spikes
from vttig_jax.logs.source import Source
from vttig_jax.pair.schema import Encoder, LogLayout

TIME, ANGLE, _ = trapezoid(rate=500.0, reversal=1440.0, dwell=0.3)
READINGS = counts(geared(ANGLE, noise=0.001)[0])


def made(readings, modulus=None, time=TIME) -> Any:
    source = Source("log.csv", {"driven": "b"}, lambda row: row + 2)
    encoder = Encoder(counts_per_rev=90_000, modulus=modulus)
    return make_channel("driven", readings, "counts", encoder, time, LogLayout(), source)


@given(
    st.sampled_from([2**12, 2**16, 90_000, 2**32]),
    st.integers(0, 2**32),
    st.sampled_from([0.0, 0.05, 0.1]),
    st.booleans(),
    st.booleans(),
)
def test_wraps_survive_spikes(modulus, start, share, wild, given_modulus):
    late_counts = counts(late(TIME, geared(ANGLE)[0], seed=start % 7, share=share)[0])
    true = late_counts + start % modulus
    wrapped = true % modulus
    if wild:
        wrapped[1234] = 1_000_000 if modulus < 10**6 else -1
    if given_modulus and np.ptp(wrapped) >= modulus:
        wrapped[1234] = true[1234] % modulus
        wild = False
    found, _ = made(wrapped, modulus if given_modulus else None)
    off = found.reading - true
    rows = np.arange(len(TIME)) != 1234 if wild else slice(None)
    if found.wraps:
        assert found.modulus == modulus
    assert np.ptp(off[rows]) == 0
    assert not wild or found.spikes[1234]


def test_the_modulus_may_be_given_beside_a_wild_reading():
    wrapped = READINGS % 36_000
    wrapped[50] = 10**6
    assert np.flatnonzero(made(wrapped, 36_000)[0].spikes).tolist() == [50]
    wrapped[60:90] = 40_000
    with pytest.raises(LogError, match="more than the modulus 36000"):
        made(wrapped, 36_000)


def test_a_counter_that_dithers_at_its_wrap():
    reading = np.concatenate([READINGS + 1, np.tile([0, -1, 0, 0, -1], 200), READINGS])
    time = np.arange(len(reading)) / 500.0
    found, _ = made(reading % 65_536, time=time)
    np.testing.assert_array_equal(np.diff(found.reading), np.diff(reading))
    assert found.modulus == 65_536


def test_spikes_are_noted_and_kept():
    disturbed = READINGS.copy()
    disturbed[[700, 900, 901]] -= 1000
    found, _ = made(disturbed)
    np.testing.assert_array_equal(found.reading, disturbed)
    _, (note,) = without_shared_spikes({"driven": found}, TIME, 0.5)
    assert f"driven: 3 of {len(TIME)} readings" in note and "up to 4°" in note


def test_both_shafts_deviate_alike_at_a_start_within_a_sample():
    both = READINGS.copy()
    both[[700, 900]] -= 1000
    driven, driving = made(both)[0], made(2 * both)[0]
    alone = both.copy()
    alone[300] -= 1000
    for one, left in ((driven, []), (made(alone)[0], [300])):
        found, notes = without_shared_spikes({"driving": driving, "driven": one}, TIME, 0.5)
        assert len(notes) == len(left) and found["driving"].spikes is None
        assert left == ([] if found["driven"].spikes is None else [300])


@pytest.mark.parametrize("size", [-40_000, 5_000, 2_000])
def test_a_step_is_refused_with_and_without_spikes(size):
    for share in (0.0, 0.1):
        stepped = counts(late(TIME, geared(ANGLE)[0], share=share)[0])
        stepped[1200:] += size
        with pytest.raises(LogError) as caught:
            made(stepped)
        text = str(caught.value)
        assert "line 1202, column `b`" in text and "stays" in text and "at 2.4 s" in text, text
        assert "--from 2.4" in text and "modulus" in text


def test_an_index_reload_is_refused():
    reloaded = np.where(READINGS >= 90_000, READINGS - 90_000 + 7_777, READINGS)
    with pytest.raises(LogError, match="a jump of -"):
        made(reloaded)


def test_a_stall_that_is_made_up_for_is_no_step():
    stalled = READINGS.copy()
    stalled[1000:1012] = stalled[1000]
    found, (note,) = made(stalled)
    assert np.flatnonzero(found.spikes).tolist() == list(range(1001, 1012))
    assert "stands still once" in note and "disturbed" not in note
    stalled[1012:] -= 2500
    with pytest.raises(LogError, match="stays"):
        made(stalled)


@pytest.mark.parametrize("times", [2, 3, 5])
def test_a_slower_channel_is_noted(times):
    held = READINGS[np.arange(len(TIME)) // times * times]
    _, (note,) = made(held)
    assert f"sampled at 1/{times} of the rate" in note
    assert f"by {(times - 1) / 2:g} samples" in note and f"({(times - 1):g} ms)" in note


def test_slow_motion_is_no_slower_channel():
    slow = np.arange(5000) // 2
    assert made(slow, time=np.arange(5000) / 500.0)[1] == ()


def test_a_channel_that_freezes_and_goes_on_is_called_frozen():
    frozen = READINGS.copy()
    start = len(frozen) // 3
    frozen[start : start + len(frozen) // 4] = frozen[start]
    with pytest.raises(LogError, match=r"stands still for \d+ samples .* it froze"):
        made(frozen)
