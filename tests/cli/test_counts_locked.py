"""Counts locked to the clock: their rounding does not average out, and `fit` does not hide it."""

import numpy as np
import pytest

pytestmark = pytest.mark.slow

COUNTS, RATE_HZ = 5000, 200.0
"""Counts a turn, and samples a second."""

LEAST = {26: 10.0, 25 / 2: 4.0, 38 / 3: 4.0, 51 / 4: 2.0}
"""Counts of the driving shaft per sample → least standard error in arcsec that contains the
rounding, of which one count is 259″."""


@pytest.fixture
def log(tmp_path):
    def write(step):
        turns = step / COUNTS * np.append(np.arange(2000), np.arange(2000)[::-1])
        driven = turns / 2 + np.repeat([0.0, 180.0], 2000) / 1296000
        driven += 60 * (np.sin(2 * np.pi * turns) + np.sin(np.pi * turns + 0.4)) / 1296000
        counts = np.floor(COUNTS * np.stack([turns, driven + 0.3 / COUNTS]) + 0.5).astype(int)
        path = tmp_path / "log.csv"
        rows = np.column_stack([np.arange(4000) / RATE_HZ, *counts])
        head = "time_s,motor_counts,load_counts"
        np.savetxt(path, rows, ["%.3f", "%d", "%d"], ",", header=head, comments="")
        return "fit", path, "--ratio", "2:1", "--counts", f"{COUNTS},{COUNTS}", "--delay", "off"

    return write


@pytest.mark.parametrize("step", LEAST)
def test_an_interval_holds_the_truth_or_there_is_none(log, vttig_json, step):
    code, found = vttig_json(*log(step))
    assert code in (0, 4)
    said = [one for one in found["findings"] if one["slug"] == "counts-locked"]
    assert said and all(one["severity"] == "warning" and one["cure"] for one in said)
    for name in ("driving_amplitude_arcsec", "driven_amplitude_arcsec"):
        one = found["parameters"][name]
        low, high = one.get("low95") or 0.0, one.get("upper95") or one.get("high95")
        assert high is None or (low <= 60 <= high and one["std"] > LEAST[step])


def test_counts_that_stray_are_not_locked(log, vttig_json):
    code, found = vttig_json(*log(25.37))
    assert code == 0 and "counts-locked" not in {one["slug"] for one in found["findings"]}
    for name in ("driving_amplitude_arcsec", "driven_amplitude_arcsec"):
        assert found["parameters"][name]["std"] < 2
