"""Logs that start anywhere share their orders: amplitudes of all, phases of the first."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, near, there_and_back
from vttig_jax.base import LogError
from vttig_jax.base.angles import difference_deg
from vttig_jax.identify import Fit, fit
from vttig_jax.logs import EncoderLog

PAIR = drive("9/16", orders=(1, 2))
STARTS = (0.0, 0.3, 5.7)
"""Driving turns before the zero of each log."""

SIZES = ("driving_amplitude_arcsec", "driven_amplitude_arcsec")
TRUE = dict(zip(SIZES, (40.0, 25.0), strict=True))
TRUE |= {"driving_phase_deg": np.degrees(0.3), "driven_phase_deg": np.degrees(1.0)}
TRUE["constant_backlash_deg"] = 300 / 3600


def log_of(
    start_turns: float,
    seed: int = 0,
    size: float = 40.0,
    line: float = 0.0,
    motion=there_and_back((30.0, 75.0), 12.0),
    **options,
) -> EncoderLog:
    def error(angle, speed):
        driven = 25 * np.sin(9 / 16 * angle + 1.0)
        driving = size * np.sin(angle + 0.3) + 15 * np.sin(2 * angle)
        return driving + driven + line * np.sin(1.37 * angle)

    made = {"gap": level(300.0), "delay_s": level(1e-3), "noise_arcsec": 20.0} | options
    return drive_log(PAIR, motion, error=error, start_turns=start_turns, seed=seed, **made)


@cache
def three(seed: int) -> tuple[EncoderLog, ...]:
    return tuple(log_of(turns, 3 * seed + k) for k, turns in enumerate(STARTS))


@cache
def joined(seed: int = 0) -> Fit:
    return fit(three(seed), PAIR)


def slugs(result: Fit) -> set[str]:
    return {one.slug for one in result.findings}


SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
def test_amplitudes_are_those_of_all_logs_and_phases_and_gap_hold(seed):
    found, alone = joined(seed).parameters, fit(three(seed)[0], PAIR).parameters
    for name, truth in TRUE.items():
        assert near(found[name], truth), name
    for name in SIZES:
        std = known(alone[name].std) / np.sqrt(3)
        assert known(found[name].std) == pytest.approx(std, rel=0.15)


def test_start_angles_hold_and_are_as_uncertain_as_they_say():
    off = []
    for seed in SEEDS:
        for turns, log in list(zip(STARTS, joined(seed).logs, strict=True))[1:]:
            for shaft, truth in (("driving", 360 * turns), ("driven", 360 * turns * 9 / 16)):
                value, std = (getattr(log.start, f"{shaft}_{k}deg") for k in ("", "std_"))
                off.append(float(difference_deg(value, truth)) / std)
    assert np.max(np.abs(off)) < 4 and 0.6 < np.sqrt(np.mean(np.square(off))) < 1.4


def test_the_order_of_the_logs_moves_no_amplitude():
    result, other = joined(), fit(three(0)[::-1], PAIR)
    for name in (*SIZES, "constant_backlash_deg", "delay_s"):
        one, two = result.parameters[name], other.parameters[name]
        assert known(two.value) == pytest.approx(known(one.value), abs=0.1 * known(one.std))
        assert known(two.std) == pytest.approx(known(one.std), rel=0.05)


def test_a_start_that_nothing_tells_leaves_the_log_its_own_orders():
    """The third log is a quarter of a turn, and the first two know as much without it."""
    short = log_of(STARTS[2], 9, motion=there_and_back((5.0,), 3.0))
    result, two = fit([*three(0)[:2], short], PAIR), fit(three(0)[:2], PAIR)
    assert "start-unknown" in slugs(result) and result.logs[2].start.driven_deg is None
    assert result.logs[1].start.driven_deg is not None and "start-unknown" not in slugs(two)
    for name in SIZES:
        one, other = result.parameters[name], two.parameters[name]
        assert near(one, TRUE[name]) and known(one.std) == pytest.approx(known(other.std), rel=0.1)


def test_a_line_has_a_phase_of_its_own_in_every_log():
    motion = there_and_back((60.0,), 60.0)
    options: dict[str, Any] = {"line": 20.0, "motion": motion, "noise_arcsec": 5.0}
    result = fit([log_of(turns, k, **options) for k, turns in enumerate(STARTS)], PAIR)
    (line,) = result.checks.lines
    assert abs(line.cycles_per_rev - 1.37) < 4 * line.cycles_std
    own = [one for one in result.orders if not float(one.order).is_integer()]
    assert own and all(abs(one.amplitude_arcsec - 20.0) < 4 * one.std_arcsec for one in own)


@pytest.mark.parametrize("turns", [0.0, 0.3])
def test_a_log_of_another_rig_is_refused_and_a_rig_that_changed_is_named(turns):
    logs = [log_of(0.0), log_of(turns, 1, size=80.0)]
    with pytest.raises(LogError, match="driving shaft has a first order of"):
        fit(logs, PAIR, same_zero=not turns)
    with pytest.raises(LogError, match="not with the same zero"):
        fit(three(0)[:2], PAIR, same_zero=True)
    logs = [log_of(0.0, noise_arcsec=5.0), log_of(turns, 1, size=44.0, noise_arcsec=5.0)]
    result = fit(logs, PAIR, same_zero=not turns)
    assert "rigs-differ" in slugs(result)
    if turns:  # each log keeps its own orders
        assert near(result.parameters["driving_amplitude_arcsec"], 40.0)


@pytest.mark.parametrize("noise_arcsec", [0.0, 0.5, 20.0])
def test_logs_of_one_rig_are_not_named(noise_arcsec):
    for turns, same_zero in ((0.0, False), (0.3, False), (0.0, True)):
        logs = [log_of(t, k, noise_arcsec=noise_arcsec) for k, t in enumerate((0.0, turns))]
        assert "rigs-differ" not in slugs(fit(logs, PAIR, same_zero=same_zero))
