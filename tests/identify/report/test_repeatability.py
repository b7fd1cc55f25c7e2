"""Comparison of the halves of a log, and where it says nothing."""

import numpy as np
from msgspec.structs import replace

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.check_sentences import check_sentences
from vttig_jax.identify.report.checks import Wander

PAIR = drive("1/20")


def fitted(driven_turns: float) -> Fit:
    """A fit of a log that goes this many turns of the driven shaft forth and back."""

    def error(angle, _):
        return 300 * np.sin(angle + 0.3) + 900 * np.sin(angle / 20)

    motion = there_and_back([60.0, 90.0], driven_turns * 20)
    log = drive_log(PAIR, motion, gap=level(600.0), error=error, noise_arcsec=30.0, rate_hz=40.0)
    return fit(log, PAIR, delay="off", drift_order=0)


def test_a_shaft_that_makes_less_than_a_turn_in_half_a_log_is_not_compared():
    short = fitted(1.2)
    assert {one.shaft for one in short.checks.halves} == {"driving"}
    assert "from the first half" not in str(short)


def test_a_shaft_that_makes_a_turn_in_half_a_log_is_compared():
    found = fitted(2.3).checks.halves
    assert {(one.shaft, one.flank) for one in found} == {
        (shaft, flank) for shaft in ("driving", "driven") for flank in "AB"
    }
    assert all(one.difference_arcsec < 5 * one.std_arcsec < 1000 for one in found)


def test_a_step_far_beyond_the_residual_has_no_size():
    short = fitted(1.2)
    checks = told(short, Wander(9.4e4, 0.75, 420.0, 20.5))
    assert "wanders by" not in checks and "the log does not tell by how much" in checks
    checks = told(short, Wander(7.1, 0.42, 19.0, 1.0))
    assert "wanders by 7.1″ in 0.42 s" in checks


def told(result: Fit, wander: Wander) -> str:
    checks = replace(result.checks, wander=wander)
    return " ".join(
        check_sentences(checks, several_logs=False, has_noise=True, gap_determined=True)
    )
