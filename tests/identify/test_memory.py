"""Arrays of the length of a log that reading and a fit hold at a time."""

import tracemalloc

import numpy as np

from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.load import pair_from_spec
from vttig_jax.pair.pair_file import parse_pair_spec

SAMPLES = 400_000
BYTES = 24  # of a sample: time and both angles


def _columns() -> tuple[np.ndarray, ...]:
    """Ten turns forth and back in counts, with some noise."""
    time = np.arange(SAMPLES) / 20_000.0
    turns = np.concatenate([np.linspace(0, 10, SAMPLES // 2), np.linspace(10, 0, SAMPLES // 2)])
    noise = np.random.default_rng(0).normal(size=(2, SAMPLES))
    error = 40 * np.cos(2 * np.pi * turns) + np.where(np.arange(SAMPLES) < SAMPLES // 2, 0, 100)
    driving = np.rint(1e6 * turns + noise[0])
    driven = np.rint(1e6 * (0.5 * turns + error / 1_296_000) + noise[1])
    return time, driving.astype(np.int64), driven.astype(np.int64)


def test_a_fit_holds_few_arrays_of_the_length_of_the_log():
    """The log itself is one, its angles, speed and error 1.3, and 0.5 a chunk of the block rows."""
    time, driving, driven = _columns()
    counts = {"encoder": {"counts_per_rev": 1_000_000}}
    spec = parse_pair_spec({"drive": {"ratio": "1/2"}, "driving": counts, "driven": counts})
    pair = pair_from_spec(spec)
    fit(EncoderLog.from_arrays(time[::100], driving[::100], driven[::100], pair=spec), pair)
    tracemalloc.start()
    try:
        log = EncoderLog.from_arrays(time, driving, driven, pair=spec)
        read = tracemalloc.get_traced_memory()[1] / (BYTES * SAMPLES)
        fit(log, pair).checks.to_json()
        peak = tracemalloc.get_traced_memory()[1] / (BYTES * SAMPLES)
    finally:
        tracemalloc.stop()
    assert 1.5 < read < 2.2
    assert 2.0 < peak < 4.8
