"""Words of a report on the noise of a fit."""

import numpy as np
import pytest

from vttig_jax.identify.noise.noise_model import NoiseModel
from vttig_jax.identify.noise.noise_text import noise_rows


def remembering(seconds: float, block_s: float = 0.1) -> NoiseModel:
    """Noise of the first order with the correlation exp(−t/`seconds`)."""
    a = np.exp(-block_s / seconds)
    return NoiseModel(np.array([a]), np.sqrt(1 - a**2), 1.0, block_s)


@pytest.mark.parametrize(
    ("memory_s", "log_s", "words"),
    [
        (174.0, 2.0, "correlated over longer than the log (2 s)"),
        (174.0, 0.5, "correlated over longer than the log (500 ms)"),
        (174.0, 400.0, "correlation time 174 s"),
        (0.02, 2.0, "correlated over less than a block"),
    ],
)
def test_a_memory_is_told_up_to_the_length_of_the_log(memory_s, log_s, words):
    ((label, text),) = noise_rows(remembering(memory_s), log_s)
    assert label == "noise" and text.endswith(words)
    assert ("174 s" in text) == (words == "correlation time 174 s")
