"""The whole step against the same formulas in C: state and metrics after a whole reversal."""

import numpy as np
import pytest

from benchmarks.simulation_cases import BASE, cases_of, periods_for
from benchmarks.step_in_c import CC, FAST, FIELDS, NEVER, StepInC, difference, scanned
from vttig_jax.base.runtime import enable_x64
from vttig_jax.control.simulation.case import Case

enable_x64()

LANES = 256
CLOSE = 1e-9
SHORT = {
    **BASE,
    "motion.dwell_s": 0.05,
    "motion.ramp_s": 0.2,
    "judgement.margin_mm": 0.05,  # some lanes close too far, others bounce in what is left open
}

pytestmark = pytest.mark.skipif(CC is None, reason="no C compiler (`cc`) on this machine")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> StepInC:
    return StepInC(tmp_path_factory.mktemp("step"), FAST)


@pytest.fixture(scope="module")
def periods() -> int:
    return periods_for(_cases())


@pytest.fixture(scope="module")
def expected(periods: int) -> np.ndarray:
    return scanned(_cases(), periods)


def _cases(**values: float | str) -> list[Case]:
    return cases_of(LANES, {**SHORT, **values}, turns=(120.0, 240.0))


def test_the_scan_is_what_c_makes_of_the_same_formulas(program, periods, expected):
    differs = difference(program.run(program.prepared(_cases()), periods), expected)
    assert max(differs.values()) <= CLOSE, differs


def test_the_program_in_c_leaves_subnormal_numbers_in_the_process(program, periods):
    program.run(program.prepared(_cases()), periods)
    smallest = np.finfo(np.float64).tiny
    assert float(smallest) / 2 > 0 and (np.full(8, smallest) / 2 > 0).all()


def test_every_metric_is_at_work(expected):
    """None of the compared numbers is trivial: lanes differ, and everything has happened."""
    rows = dict(zip(FIELDS, expected, strict=True))
    names = ("gap", "crossing", "detection", "residual_gap", "travel", "farthest", "opened")
    for name in ("total", *names):
        assert (np.abs(rows[name]) != NEVER).all() and (rows[name] != 0).all(), name
    assert 0.1 < (rows["interference"] > 0).mean() < 0.9 and np.ptp(rows["gap"]) > 1e-5


@pytest.mark.parametrize(
    ("key", "value", "seen"),
    [("judgement.threshold_rad_s2", 1.7, "detection"), ("mesh.restitution", 0.4, "total")],
)
def test_another_number_is_seen(program, periods, expected, key, value, seen):
    differs = difference(program.run(program.prepared(_cases(**{key: value})), periods), expected)
    assert differs[seen] > 1e3 * CLOSE, differs
