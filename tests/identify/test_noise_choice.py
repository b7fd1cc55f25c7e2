"""What is assumed of the noise: each choice on logs that ask for it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from vttig_jax.base.units import REV
from vttig_jax.identify.compress.harmonic_summary import plateau_speeds
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.settings import NoiseSettings
from vttig_jax.identify.store import fit_arrays, read_fit
from vttig_jax.rig.imperfections import Noise
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig


@pytest.fixture(scope="module")
def two_speeds():
    """Noise of 0.004° at 30 rpm and of 0.001° at 60 rpm: (pair, logs)."""
    logs, pair = [], paper_rig().pair
    for seed, (speed, std, memory) in enumerate([(30.0, 0.004, 0.02), (60.0, 0.001, 0.005)]):
        rig = paper_rig(motion=PassMotion(speed_rpm=speed, reversal_deg=1440.0))
        logs.append(replace(rig, noise=Noise(std, memory)).log(seed))
    return pair, logs


@pytest.fixture(scope="module")
def shared(two_speeds):
    pair, logs = two_speeds
    return fit(logs, pair, same_zero=True, delay="off")


@pytest.fixture(scope="module")
def by_plateau(two_speeds):
    pair, logs = two_speeds
    return fit(logs, pair, same_zero=True, noise_of="plateau", delay="off")


def test_every_speed_has_its_noise(by_plateau, shared):
    assert shared.noise.plateaus == ()
    speeds = [speed * 60 / REV for speed, _ in by_plateau.noise.plateaus]
    np.testing.assert_allclose(speeds, [30.0, 60.0], rtol=0.01)
    slow, fast = (own for _, own in by_plateau.noise.plateaus)
    assert slow.std > 2.5 * fast.std
    assert by_plateau.noise.at(-30 * REV / 60) is slow
    assert "noise at 30 rpm" in str(by_plateau) and "noise at 60 rpm" in str(by_plateau)
    assert [p["speed_rpm"] for p in by_plateau.to_json()["noise"]["plateaus"]] == pytest.approx(
        speeds
    )


def test_the_better_log_counts_for_more(by_plateau, shared):
    """One noise for both gives the noisy log the weight of the good one."""
    name = "constant_backlash_deg"
    assert by_plateau.parameters[name].std < 0.8 * shared.parameters[name].std
    off = by_plateau.parameters[name].value - 0.038
    assert abs(off) < 4 * by_plateau.parameters[name].std


def test_it_is_kept_on_disk(by_plateau, tmp_path):
    (tmp_path / "fit.json").write_text(json.dumps(by_plateau.to_json()))
    np.savez(tmp_path / "summary.npz", allow_pickle=False, **fit_arrays(by_plateau))
    again = read_fit(tmp_path, by_plateau.pair)
    assert again.noise.choice == NoiseSettings("ar", "time", "plateau")
    for (speed, own), (known, model) in zip(
        again.noise.plateaus, by_plateau.noise.plateaus, strict=True
    ):
        assert speed == known and own.std == model.std
        np.testing.assert_array_equal(own.coefficients, model.coefficients)


def test_rows_of_equal_angle(two_speeds):
    pair, logs = two_speeds
    in_angle = fit(logs, pair, same_zero=True, noise_in="angle")
    steps = [np.median(np.abs(np.diff(c.driving_angle))) for c in in_angle.curves]
    assert max(steps) / min(steps) < 1.02
    durations = [np.median(np.diff(c.time)) for c in in_angle.curves]
    assert max(durations) / min(durations) == pytest.approx(2.0, rel=0.02)
    assert "stationary in angle" in str(in_angle)


def test_white_noise_remembers_nothing(two_speeds):
    pair, logs = two_speeds
    white = fit(logs[0], pair, noise="white")
    assert len(white.noise.coefficients) == 0
    assert white.noise.name == white.to_json()["noise"]["model"] == "white"
    assert white.checks.whiteness is not None
    assert white.checks.whiteness.probability < 1e-6 < 1e-3


@pytest.mark.parametrize(
    "wrong", [{"noise": "pink"}, {"noise_in": "space"}, {"noise_of": "everything"}]
)
def test_unknown_words(two_speeds, wrong, unchecked):
    pair, logs = two_speeds
    with pytest.raises(ValueError, match="must be"):
        fit(logs[0], pair, **wrong)


def test_speeds_within_a_twentieth_are_one():
    assert plateau_speeds([6.0, -6.1, 3.0, -3.05, 6.2]) == pytest.approx((3.025, 6.1))
    assert plateau_speeds([]) == ()
