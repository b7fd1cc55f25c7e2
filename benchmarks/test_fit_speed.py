"""How long it takes from 10⁶ samples to the parameters, in units of four NumPy columns."""

import os
import statistics
import time

import numpy as np
import pytest

from . import peers
from .environment import write
from .problem import FIRST, FULL, Problem, make_problem

CASES = {
    "first orders": (FIRST, True),
    "first orders, perfect encoders": (FIRST, False),
    "orders 1-8 and mesh": (FULL, True),
}
FROM_COUNTS = "vttig_jax from counts: angles, TE, look, whiten, solve"
ROWS = {
    peers.numpy_gram: "NumPy columns, Gram, solve",
    peers.vttig: "vttig_jax look, whiten, solve",
    peers.scipy_cartesian: "SciPy, precomputed columns, exact Jacobian",
    peers.scipy_polar: "SciPy, amplitude and phase, defaults",
    peers.lmfit_polar: "lmfit, amplitude and phase, defaults",
}
_LARGEST_Z = 4.5


@pytest.fixture(scope="module", params=CASES)
def case(request) -> tuple[str, Problem]:
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        pytest.exit("Set OPENBLAS_NUM_THREADS=1: peers are compared on one BLAS thread.", 2)
    orders, encoders = CASES[request.param]
    problem = make_problem(orders, encoders=encoders)
    _ = problem.angles, problem.error
    return request.param, problem


@pytest.fixture(scope="module")
def table():
    """Case → row → seconds and ratio to the unit; written as JSON when the module is through."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    yield found
    if found:
        write(f"fit_speed_{len(os.sched_getaffinity(0))}_core.json", {"cases": found})


@pytest.fixture
def timed(benchmark, table, case):
    """Time a function of the problem after it has passed the gate.

    The unit is timed right before every round, so that both meet the machine in the same state.
    """
    name, problem = case

    def run(row, function, rounds):
        _require_truth(problem, function)
        units = []

        def before():
            start = time.perf_counter()
            peers.four_columns(problem)
            units.append(time.perf_counter() - start)
            return (problem,), {}

        benchmark.pedantic(function, rounds=rounds, setup=before)
        if benchmark.stats is None:  # --benchmark-disable
            return
        times = benchmark.stats.stats.data
        table.setdefault(name, {})[row] = {
            "median_s": round(statistics.median(times), 5),
            "least_s": round(min(times), 5),
            "unit_s": round(statistics.median(units), 5),
            "ratio": round(statistics.median(np.divide(times, units[-rounds:])), 3),
            "rounds": rounds,
        }

    return run


def _require_truth(problem: Problem, function) -> None:
    """The gate before any time is taken: every parameter within its error of the truth."""
    _, std = peers.parameters(problem, peers.vttig_solution(problem))
    z = (function(problem) - problem.truth) / std
    assert np.abs(z).max() < _LARGEST_Z, f"off by {z.round(1)} std"


def test_gate_refuses_wrong_parameters(case):
    with pytest.raises(AssertionError, match="off by"):
        _require_truth(case[1], lambda problem: 0.98 * problem.truth)


@pytest.mark.parametrize("function", [peers.numpy_gram, peers.vttig], ids=lambda f: f.__name__)
def test_one_pass(timed, function):
    timed(ROWS[function], function, 21)


def test_vttig_from_counts(timed):
    timed(FROM_COUNTS, lambda problem: peers.vttig(problem, problem.without_caches()), 21)


def test_scipy_cartesian(timed, case):
    rounds = 1 if case[1].free else 5
    timed(ROWS[peers.scipy_cartesian], peers.scipy_cartesian, rounds)


@pytest.mark.parametrize(
    "function", [peers.scipy_polar, peers.lmfit_polar], ids=lambda f: f.__name__
)
def test_amplitude_and_phase(timed, case, function):
    if case[1].free:
        pytest.skip("70 parameters with a numeric Jacobian on 10⁶ samples take many minutes")
    timed(ROWS[function], function, 3)
