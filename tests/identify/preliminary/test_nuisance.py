"""Coefficients of the own columns against least squares on whitened rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular

from tests.identify.summaries import TERMS, made_log, random_log
from tests.oracles.stationary_noise import covariance
from vttig_jax.identify.compress.block_rows import LogRows
from vttig_jax.identify.compress.harmonic_summary import summarise
from vttig_jax.identify.model.column_layout import ColumnLayout, own_parameters
from vttig_jax.identify.preliminary.nuisance import NuisanceRegression, own_terms

pytestmark = pytest.mark.smoke

FILTER = np.array([1.0, -0.4])
FREE = 2 * len(TERMS.free)
OWN = ("offset", "drift_1", "delay")


def _logs(kind: str) -> list[LogRows]:
    one = random_log(0, OWN, "AB")
    return {
        "one log": [one],
        "one flank": [random_log(1, OWN, "BB")],
        "two logs": [one, random_log(2, OWN, "ABA")],
        "two kinds": [one, random_log(3, ("offset", "delay"), "AB")],
        "a flank each": [random_log(4, OWN, "A"), random_log(5, OWN, "B")],
    }[kind]


KINDS = ("one log", "one flank", "two logs", "two kinds", "a flank each")


class Dense:
    """The same model written out row by row: fixed columns, named columns and y, whitened."""

    def __init__(self, logs: list[LogRows]):
        present = sorted({run.segment.flank for log in logs for run in log.runs})
        several = len(logs) > 1
        fixed, named, y = [], [], []
        self.names: list[str] = []
        for number, log in enumerate(logs):
            for name in log.columns.own[0][1:]:
                label = name if name == "delay" or not several else f"{name}_of_{number + 1}"
                if label not in self.names:
                    self.names.append(label)
        for number, log in enumerate(logs):
            own = log.columns.own[0]
            for run in log.runs:
                kept = solve_triangular(
                    cholesky(covariance(FILTER, len(run.rows)), lower=True), run.rows, lower=True
                )
                harmonics = np.delete(kept[:, :-1], range(FREE, FREE + len(own)), axis=1)
                side = present.index(run.segment.flank)
                places = np.zeros((len(kept), len(present), harmonics.shape[1]))
                places[:, side] = harmonics
                offsets = np.zeros((len(kept), len(logs)))
                offsets[:, number] = kept[:, FREE]
                gap = kept[:, [FREE]] * side if len(present) == 2 else np.zeros((len(kept), 0))
                fixed.append(np.hstack([places.reshape(len(kept), -1), offsets, gap]))
                columns = np.zeros((len(kept), len(self.names)))
                for place, name in enumerate(own[1:], FREE + 1):
                    label = name if name in self.names else f"{name}_of_{number + 1}"
                    columns[:, self.names.index(label)] = kept[:, place]
                named.append(columns)
                y.append(kept[:, -1])
        self.fixed, self.named, self.y = (np.concatenate(part) for part in (fixed, named, y))
        self.rows = len(self.y) - self.fixed.shape[1]

    def of(self, names) -> np.ndarray:
        return np.hstack([self.fixed, self.named[:, [self.names.index(n) for n in names]]])

    def misfit(self, names) -> float:
        x = self.of(names)
        left = self.y - x @ np.linalg.lstsq(x, self.y, rcond=None)[0]
        return float(left @ left)

    def estimate(self, name, names) -> tuple[float, float]:
        x = self.of(names)
        place = self.fixed.shape[1] + list(names).index(name)
        # Two logs with a flank each: offsets and gap are one too many, no named column suffers.
        inverse = np.linalg.pinv(x.T @ x)
        variance = self.misfit(names) / (len(self.y) - x.shape[1])
        value = (inverse @ x.T @ self.y)[place]
        return float(value), float(np.sqrt(inverse[place, place] * variance))

    def left(self, name) -> float:
        column = self.named[:, self.names.index(name)]
        rest = column - self.fixed @ np.linalg.lstsq(self.fixed, column, rcond=None)[0]
        return float(rest @ rest) / float(column @ column)


def _both(kind: str) -> tuple[NuisanceRegression, Dense]:
    logs = _logs(kind)
    return own_terms(summarise(logs, TERMS), FILTER), Dense(logs)


@pytest.mark.parametrize("kind", KINDS)
def test_estimates_are_those_of_least_squares_on_the_rows(kind):
    own, dense = _both(kind)
    assert sorted(own.names) == sorted(dense.names)
    assert own.rows == dense.rows
    for among in (own.names, ("delay",), own.names[:1]):
        for name in among:
            value, std = dense.estimate(name, among)
            assert own.estimate(name, among) == pytest.approx((value, std), rel=1e-6)
            # In ordinary rows the estimate would be another one.
            assert abs(value) < 6 * std


@pytest.mark.parametrize("kind", KINDS)
def test_misfits_shares_and_criteria(kind):
    own, dense = _both(kind)
    for names in ((), ("delay",), own.names):
        left = dense.misfit(names)
        assert own.misfit(names) == pytest.approx(left, rel=1e-9)
        bic = dense.rows * np.log(left) + len(names) * np.log(dense.rows)
        assert own.bic(names) == pytest.approx(bic, rel=1e-9)
    for name in own.names:
        assert own.left(name) == pytest.approx(dense.left(name), rel=1e-8)
    assert not own.is_exact


def test_a_filter_matters():
    """The same numbers without it are others: the comparison above sees the filter."""
    logs = _logs("two logs")
    summary = summarise(logs, TERMS)
    filtered, plain = own_terms(summary, FILTER), own_terms(summary, np.ones(1))
    value, _ = filtered.estimate("delay", filtered.names)
    assert plain.estimate("delay", plain.names)[0] != pytest.approx(value, rel=1e-3)


def test_a_planted_coefficient_is_found_once_for_all_logs():
    logs = _logs("two logs")
    for number, log in enumerate(logs):
        place, slow = log.columns.index("delay"), log.columns.index("drift_1")
        for run in log.runs:
            run.rows[:, -1] *= 0.1
            run.rows[:, -1] += 3.0 * run.rows[:, place] + (number + 1) * run.rows[:, slow]
    own = own_terms(summarise(logs, TERMS), FILTER)
    assert own.names == ("drift_1_of_1", "delay", "drift_1_of_2")
    for name, value in (("delay", 3.0), ("drift_1_of_1", 1.0), ("drift_1_of_2", 2.0)):
        found, std = own.estimate(name, own.names)
        assert abs(found - value) < 4 * std < 0.05


def test_what_harmonics_explain_is_not_left():
    """A column that is a harmonic plus a level says nothing of its own."""
    rows = random_log(6, ("offset", "delay"), "AB").runs
    for run in rows:
        run.rows[:, 3] = 0.7 * run.rows[:, 0] - 2.0
    own = own_terms(
        summarise([made_log([r.rows for r in rows], ("offset", "delay"), "AB")], TERMS), FILTER
    )
    assert own.left("delay") < 1e-9
    value, std = own.estimate("delay", ("delay",))
    assert np.isfinite([value, std]).all()


def test_one_level_a_flank_is_the_gap():
    """± on the two flanks is what offset and gap explain, as a delay at one speed is."""
    log = random_log(7, ("offset", "delay"), "AB")
    for run in log.runs:
        run.rows[:, 3] = 5.0 if run.segment.flank == "A" else -5.0
    assert own_terms(summarise([log], TERMS), FILTER).left("delay") < 1e-9
    log.runs[0].rows[100:, 3] = 4.0
    assert own_terms(summarise([log], TERMS), FILTER).left("delay") > 1e-4


def test_a_column_of_zeros_is_not_left():
    log = random_log(8, ("offset", "delay"), "AB")
    for run in log.runs:
        run.rows[:, 3] = 0.0
    assert own_terms(summarise([log], TERMS), FILTER).left("delay") == 0.0


def test_exact_is_where_only_rounding_is_left():
    own, _ = _both("one log")
    for share, exact in ((1e-7, True), (1e-5, False)):
        triangle = own.triangle.copy()
        triangle[-1, -1] = share * np.sqrt(own.total)
        assert replace(own, triangle=triangle).is_exact is exact


def test_labels_tell_logs_apart_where_they_have_their_own():
    columns = ColumnLayout((), (), (("offset", "drift_1", "delay"), ("offset", "drift_1", "delay")))
    names, matrix = own_parameters(columns)
    assert names == ("drift_1_of_1", "delay", "drift_1_of_2")
    np.testing.assert_array_equal(matrix, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0]])
    alone, matrix = own_parameters(columns.of_log(0))
    assert alone == ("drift_1", "delay")
    np.testing.assert_array_equal(matrix, np.eye(2))
