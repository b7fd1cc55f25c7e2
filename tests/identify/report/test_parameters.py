"""Amplitudes, phases, intervals and upper limits from Cartesian parameters."""

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.base.numerics.polar_spread import polar_spread
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report import parameters
from vttig_jax.identify.report.parameters import LARGEST, Parameter, polar, scalar, undetermined
from vttig_jax.identify.solve.least_squares import Solution

pytestmark = pytest.mark.smoke

NAMES = ("amplitude", "phase")


def test_an_interval_of_more_than_a_revolution_withdraws_the_value(monkeypatch):
    """A shorter revolution takes the place of a log that knows so little."""
    pair = drive("9/16", orders=(1, 2))

    def error(angle, _):
        return 30 * np.sin(angle + 0.3)

    def fitted(revolution_arcsec: float) -> Fit:
        monkeypatch.setitem(LARGEST, "arcsec", revolution_arcsec)
        monkeypatch.setitem(LARGEST, "deg", revolution_arcsec / 3600)
        motion = there_and_back([30, 60], 8)
        return fit(drive_log(pair, motion, gap=level(200.0), error=error), pair)

    names = ("driving_amplitude_arcsec", "driving_phase_deg", "constant_backlash_deg")
    known, unknown = fitted(31.0), fitted(1e-4)
    for name in names:
        assert known.parameters[name].determined
        withdrawn = unknown.parameters[name]
        assert withdrawn.value is None and "wider than one revolution" in (withdrawn.reason or "")
    assert known.orders and not unknown.orders
    assert known.checks.gap_over_angles_covered.determined
    assert "one revolution" in (unknown.checks.gap_over_angles_covered.reason or "")
    assert fitted(29.0).parameters["driving_amplitude_arcsec"].value is None


def _solution(values, covariance) -> Solution:
    size = len(values)
    return Solution(
        names=("gap", "shaft_x", "shaft_y")[:size],
        values=np.asarray(values, float),
        covariance=np.asarray(covariance, float),
        determined=np.ones(size, bool),
        tied=np.zeros((1, 1)),
        jacobian=np.zeros((1, 1, size)),
        converged=True,
        steps=3,
    )


SPREAD = np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-4


def test_an_eccentricity_that_may_exceed_the_centre_distance_is_withdrawn():
    cell = np.zeros((3, 3))
    cell[1:, 1:] = np.eye(2) * 30.0**2
    solution = _solution([0.0, 3.0, -4.0], cell)

    def stated(largest_mm: float) -> Parameter:
        return parameters._polar_or_reason(
            solution, "shaft", NAMES, "mm", 1.0, reason=None, largest=largest_mm
        )[0]

    upper = stated(1e3).upper95
    assert upper is not None and 30 < upper < 100
    assert stated(1.01 * upper).determined
    withdrawn = stated(0.99 * upper)
    assert withdrawn.value is None and "wider than the centre distance" in (withdrawn.reason or "")


def test_spread_follows_the_directions_along_and_across():
    amplitude, std, phase_deg, phase_std_deg = polar_spread(np.array([3.0, 4.0]), SPREAD)
    draws = np.random.default_rng(0).multivariate_normal([3.0, 4.0], SPREAD, 200_000)
    assert amplitude == pytest.approx(5.0)
    assert phase_deg == pytest.approx(np.degrees(np.arctan2(4, 3)))
    assert std == pytest.approx(np.hypot(*draws.T).std(), rel=0.01)
    angles = np.degrees(np.arctan2(draws[:, 1], draws[:, 0]))
    assert phase_std_deg == pytest.approx(angles.std(), rel=0.01)
    assert std != pytest.approx(5 * phase_std_deg * DEG, rel=0.1)


def test_no_amplitude_has_no_direction():
    amplitude, std, phase_deg, phase_std_deg = polar_spread(np.zeros(2), SPREAD)
    assert (amplitude, phase_deg, phase_std_deg) == (0.0, 0.0, 180.0)
    assert std == pytest.approx(np.sqrt(np.linalg.eigvalsh(SPREAD).max()))


def test_a_clear_amplitude_has_a_phase_and_intervals():
    cell = np.zeros((3, 3))
    cell[1:, 1:] = SPREAD * 1e-2 * ARCSEC**2
    values = np.array([0.0, 3.0, -4.0]) * ARCSEC
    amplitude, phase = polar(_solution(values, cell), "shaft", NAMES, "arcsec", ARCSEC)
    assert (amplitude.name, phase.name) == NAMES
    assert (amplitude.unit, phase.unit) == ("arcsec", "deg")
    assert amplitude.value == pytest.approx(5.0)
    assert phase.value == pytest.approx(360 - np.degrees(np.arctan2(4, 3)))
    for parameter in (amplitude, phase):
        assert parameter.determined and parameter.significant
        assert parameter.reason is None and parameter.upper95 is None
        assert parameter.value is not None and parameter.std is not None
        margin = 1.959964 * parameter.std
        assert parameter.low95 == pytest.approx(parameter.value - margin)
        assert parameter.high95 == pytest.approx(parameter.value + margin)


def test_the_interval_of_a_phase_may_leave_the_turn():
    cell = np.diag([0.0, 1e-4, 1e-2])
    _, phase = polar(_solution([0.0, 1.0, -0.001], cell), "shaft", NAMES, "mm", 1.0)
    assert phase.value is not None and phase.high95 is not None
    assert 359.9 < phase.value < 360 < phase.high95


@pytest.mark.parametrize("length", [0.0, 0.4, 1.0, 2.5])
def test_below_three_errors_there_is_an_upper_limit_and_no_phase(length):
    """95 % of a plane Gaussian around the estimate lies within the limit."""
    cell = np.diag([0.0, 1.0, 1.0])
    amplitude, phase = polar(_solution([0.0, length, 0.0], cell), "shaft", NAMES, "mm", 1.0)
    draws = np.random.default_rng(1).standard_normal((200_000, 2)) + np.array([length, 0.0])
    quantile = np.quantile(np.hypot(*draws.T), 0.95)
    assert amplitude.upper95 == pytest.approx(quantile, rel=0.01)
    assert (amplitude.low95, amplitude.high95) == (0.0, amplitude.upper95)
    assert amplitude.determined and not amplitude.significant
    assert amplitude.value == pytest.approx(length)
    assert "upper limit" in (amplitude.reason or "")
    assert phase.determined and not phase.significant
    assert phase.value is phase.std is phase.low95 is phase.high95 is None
    assert phase.reason == "amplitude is below three standard errors"


def test_three_standard_errors_are_the_border():
    for length, significant in ((2.99, False), (3.01, True)):
        solution = _solution([0.0, length, 0.0], np.eye(3))
        amplitude, _ = polar(solution, "shaft", NAMES, "mm", 1.0)
        assert amplitude.significant is significant


@pytest.mark.parametrize(("value", "significant"), [(0.04, True), (-0.04, True), (0.002, False)])
def test_scalar_in_its_unit(value, significant):
    solution = _solution([value * DEG, 0, 0], np.diag([(0.001 * DEG) ** 2, 1, 1]))
    gap = scalar(solution, "gap", "backlash", "deg", DEG)
    assert (gap.value, gap.std) == (pytest.approx(value), pytest.approx(0.001))
    assert gap.low95 == pytest.approx(value - 1.959964e-3)
    assert gap.high95 == pytest.approx(value + 1.959964e-3)
    assert gap.determined and gap.significant is significant
    assert (gap.reason is None) is significant


def test_json_has_the_fields_of_the_contract():
    fields = {"value", "std", "low95", "high95", "unit", "determined", "significant", "reason"}
    open_ = undetermined("delay_s", "s", "why").to_json()
    assert set(open_) == fields
    assert open_["determined"] is False and open_["value"] is None and open_["reason"] == "why"
    limited, _ = polar(_solution([0.0, 1.0, 0.0], np.eye(3)), "shaft", NAMES, "mm", 1.0)
    assert set(limited.to_json()) == fields | {"upper95"}
