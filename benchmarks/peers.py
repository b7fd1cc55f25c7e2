"""Ways from the same arrays to the same parameters: NumPy, vttig_jax, SciPy and lmfit.

Each function takes a `Problem` and returns its physical parameters (see there); the free harmonics
are fitted along where the problem has any. Residuals are in arcsec, lengths in mm, angles in rad:
every peer works with numbers near one.
"""

import lmfit
import numpy as np
from scipy.optimize import least_squares

from vttig_jax.base.units import ARCSEC
from vttig_jax.identify.compress.regressors import Drift
from vttig_jax.identify.model.forward_model import pair_relation
from vttig_jax.identify.noise.noise_model import whiten
from vttig_jax.identify.preliminary.linear_fit import Input, Model, linear_fit
from vttig_jax.identify.solve.least_squares import Solution, solve
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.segments import Segments

from .problem import HALVES, PER_FLANK, Problem, polar_geometry

_CHUNK = 16_384


def four_columns(problem: Problem) -> tuple[np.ndarray, ...]:
    """The unit of time: cosine and sine of both angles, one NumPy pass."""
    driving, driven = problem.angles
    return np.cos(driving), np.sin(driving), np.cos(driven), np.sin(driven)


def numpy_gram(problem: Problem) -> np.ndarray:
    """Columns, Gram matrix and normal equations in NumPy, in chunks that stay in cache."""
    free, physical = 2 * len(problem.free), len(problem.truth)
    size = physical + 2 * free
    normal, right = np.zeros((size, size)), np.zeros(size)
    for side, half in enumerate(HALVES):
        gram = _gram(problem, half)
        design = np.zeros((5 + free, size))
        design[:5, :physical] = problem.first_order(side)
        first = physical + side * free
        design[5:, first : first + free] = np.eye(free)
        normal += design.T @ gram[:-1, :-1] @ design
        right += design.T @ gram[:-1, -1]
    scale = np.sqrt(np.diag(normal))
    return (np.linalg.solve(normal / np.outer(scale, scale), right / scale) / scale)[:physical]


def _gram(problem: Problem, half: slice) -> np.ndarray:
    driving, driven = (angle[half] for angle in problem.angles)
    error = problem.error[half]
    width = 6 + 2 * len(problem.free)
    total = np.zeros((width, width))
    table = np.ones((width, _CHUNK))
    for start in range(0, len(error), _CHUNK):
        part = slice(start, start + _CHUNK)
        first, second = driving[part], driven[part]
        table = table[:, : len(first)]
        table[0], table[1] = np.cos(first), np.sin(first)
        table[2], table[3] = np.cos(second), np.sin(second)
        for place, (n1, n2) in enumerate(problem.free):
            phase = n1 * first + n2 * second
            table[5 + 2 * place], table[6 + 2 * place] = np.cos(phase), np.sin(phase)
        table[-1] = error[part]
        total += table @ table.T
    return total


def vttig(problem: Problem, log: EncoderLog | None = None) -> np.ndarray:
    """Fit linearly, whiten, solve: what `vttig_jax.fit` does, with exact relation and AR noise."""
    return parameters(problem, vttig_solution(problem, log))[0]


def vttig_solution(problem: Problem, log: EncoderLog | None = None) -> Solution:
    """The same with everything the solver says; `log` takes the place of the problem's own."""
    log = problem.log if log is None else log
    model = Model(problem.pair, problem.terms, (), Drift())
    summary = linear_fit([Input(log, Segments((), (), len(log)), problem.segments)], model).summary
    _, whitened = whiten(summary)
    flanks = ("A", "B")
    relation = pair_relation(
        problem.pair, problem.terms, summary.columns, flanks, encoder_terms=problem.encoders
    )
    return solve(relation, whitened)


def parameters(problem: Problem, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """The parameters of `Problem` and their standard errors from those of vttig_jax."""
    names = ["driving_x", "driving_y", "driven_x", "driven_y", "offset", "offset"]
    if problem.encoders:
        names += [f"{shaft}_encoder_{axis}" for shaft in ("driving", "driven") for axis in "xy"]
    pick = np.zeros((len(names), len(solution.names)))
    for row, name in enumerate(names):
        pick[row, solution.names.index(name)] = 1.0 if row < 4 else 1 / ARCSEC
    pick[5, solution.names.index("constant_backlash")] = 1 / ARCSEC
    return pick @ solution.values, np.sqrt(np.diag(pick @ solution.covariance @ pick.T))


def _guess(problem: Problem) -> np.ndarray:
    """Amplitudes and phases 20 to 30 % off in turn, o_A 3″ and o_B 20 % off."""
    truth = _polar(problem.truth)
    guess = truth * np.resize([1.25, 0.8, 0.75, 1.2], len(truth))
    guess[4:6] = truth[4:6] * 0.8 + [3.0, 0.0]
    return guess


def _polar(values: np.ndarray) -> np.ndarray:
    result = values.copy()
    for place in range(0, len(values), 2):
        if place != 4:
            x, y = values[place : place + 2]
            result[place : place + 2] = np.hypot(x, y), np.arctan2(y, x)
    return result


def _cartesian(values: np.ndarray) -> np.ndarray:
    result = values.copy()
    for place in range(0, len(values), 2):
        if place != 4:
            size, phase = values[place : place + 2]
            result[place : place + 2] = size * np.cos(phase), size * np.sin(phase)
    return result


def _polar_residual(problem: Problem, values: np.ndarray) -> np.ndarray:
    """Residuals of the model as people write it down: amplitudes and phases."""
    e1, t1, e2, t2, *offsets = values[:6]
    driving, driven = problem.angles
    model = np.empty_like(problem.error)
    for side, half in enumerate(HALVES):
        gain, alpha = polar_geometry(problem.pair, side)
        model[half] = offsets[side] + gain * (
            e1 * np.sin(driving[half] + (t1 + alpha)) + e2 * np.sin(driven[half] + (t2 - alpha))
        )
    if problem.encoders:
        f1, p1, f2, p2 = values[6:]
        ratio = float(problem.pair.ratio)
        model += f2 * np.sin(driven + p2) - ratio * f1 * np.sin(driving + p1)
    return model - problem.error


def scipy_polar(problem: Problem) -> np.ndarray:
    """`scipy.optimize.least_squares` with its defaults: numeric Jacobian, trf."""
    found = least_squares(lambda values: _polar_residual(problem, values), _guess(problem))
    return _cartesian(found.x)


def lmfit_polar(problem: Problem) -> np.ndarray:
    """`lmfit.minimize` with its defaults: leastsq, numeric Jacobian."""
    start = lmfit.Parameters()
    for place, value in enumerate(_guess(problem)):
        start.add(f"p{place}", value=value)

    def residual(found):
        return _polar_residual(problem, np.array([found[name].value for name in start]))

    found = lmfit.minimize(residual, start)
    best = found.params  # pyright: ignore[reportAttributeAccessIssue]
    return _cartesian(np.array([best[name].value for name in start]))


def scipy_cartesian(problem: Problem) -> np.ndarray:
    """`least_squares` on the linear model: columns computed once, exact Jacobian."""
    jacobian = cartesian_columns(problem)
    physical = len(problem.truth)
    start = np.zeros(jacobian.shape[1])
    start[:physical] = _cartesian(_guess(problem))
    found = least_squares(
        lambda values: jacobian @ values - problem.error,
        start,
        jac=lambda values: jacobian,  # pyright: ignore[reportArgumentType]
    )
    return found.x[:physical]


def cartesian_columns(problem: Problem) -> np.ndarray:
    """Derivative of the model by every parameter, arcsec per unit."""
    free, physical = 2 * len(problem.free), len(problem.truth)
    columns = np.zeros((2 * PER_FLANK, physical + 2 * free))
    driving, driven = problem.angles
    for side, half in enumerate(HALVES):
        first, second = driving[half], driven[half]
        four = [np.cos(first), np.sin(first), np.cos(second), np.sin(second), np.ones_like(first)]
        columns[half, :physical] = np.stack(four, axis=1) @ problem.first_order(side)
        for place, (n1, n2) in enumerate(problem.free):
            phase, column = n1 * first + n2 * second, physical + side * free + 2 * place
            columns[half, column], columns[half, column + 1] = np.cos(phase), np.sin(phase)
    return columns
