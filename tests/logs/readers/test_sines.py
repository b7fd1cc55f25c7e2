"""Counts of analogue encoders: sines of 1 V peak to peak instead of levels."""

import numpy as np
import pytest

from vttig_jax import read_log

PERIODS = 64


@pytest.mark.parametrize("noise_v", [0.0, 0.01])
def test_an_edge_is_at_one_place_in_both_directions(tmp_path, noise_v):
    """The counts less the angle have one mean there and back, a hysteresis would part them."""
    rng = np.random.default_rng(0)
    time = np.arange(40_000) / 10_000
    turned = 2.0 - np.abs(time - 2.0)  # turns of the driving shaft
    waves = [2 * np.pi * PERIODS * part * turned for part in (1.0, 0.5)]
    volts = [0.1 + 0.5 * trace(wave) for wave in waves for trace in (np.cos, np.sin)]
    table = np.stack([time, *(one + noise_v * rng.standard_normal(len(time)) for one in volts)])
    path = tmp_path / "log.csv"
    np.savetxt(path, table.T, "%.6f", ",", header="time_s,a1,b1,a2,b2", comments="")
    columns = {"driving": "quadrature(a1,b1)", "driven": "quadrature(a2,b2)"}
    log = read_log(path, ratio="2:1", columns=columns, counts=(4 * PERIODS, 4 * PERIODS))
    off = log.driving.angle / (2 * np.pi) * 4 * PERIODS - 4 * PERIODS * turned
    there, back = off[2000:18_000].mean(), off[22_000:38_000].mean()
    assert abs(there - back) < 0.05  # of a count; a third of the amplitude parts them by 0.43
