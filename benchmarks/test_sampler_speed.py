"""What an evaluation of the sampled density costs, and a step of the sampler around it."""

import os
import statistics
import time
from functools import cache

import emcee
import equinox as eqx
import jax
import numpy as np
import pytest
from vttig_jax.posterior.density.density import FitTarget, fit_target
from vttig_jax.posterior.density.likelihood import Likelihood
from vttig_jax.posterior.sampling.ensembles import run_ensembles
from vttig_jax.posterior.sampling.joint_moves import MOVES

from vttig_jax.base.runtime import enable_x64
from vttig_jax.identify.identification import fit
from vttig_jax.rig.paper import paper_rig

from .environment import write
from .sampled_rows import PARTIAL, STD, TRUTH, OverSamples, SampledRows, sampled_rows

enable_x64()

WALKERS = 64
COUNTS = (10_000, 1_000_000, 10_000_000)
STEPS = 2500
"""Of each of four ensembles: 64 walkers × 10 000 steps together."""
ROUNDS = 60
_LARGEST_Z = 4.5


@pytest.fixture(scope="module")
def table():
    """Everything found, written as JSON when the module is through."""
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        pytest.exit("Set OPENBLAS_NUM_THREADS=1: rivals are compared on one BLAS thread.", 2)
    found: dict = {}
    yield found
    if found:
        write("sampler_speed.json", found)


@cache
def rows_of(count: int) -> SampledRows:
    return sampled_rows(count, keep=count == COUNTS[1])


@cache
def target() -> FitTarget:
    rig = paper_rig()
    return fit_target(fit(rig.log(), rig.pair))


@eqx.filter_jit
def evaluated(likelihood: Likelihood, points):
    asked = len(likelihood.sampled_indices)
    return jax.vmap(lambda p: likelihood(p[:asked], p[asked + 1 :], p[asked]))(points)


def points_of(count: int) -> np.ndarray:
    """Points about as far apart as the posterior of so many rows is wide."""
    generator = np.random.default_rng(1)
    width = 10 * STD / np.sqrt(count)
    size = np.array([1.0, *[400.0] * 4, 1e5, 1e5, 1e5]) * width
    centre = np.concatenate([TRUTH, [np.log(STD)], PARTIAL])
    return centre + size * generator.standard_normal((WALKERS, len(centre)))


def paired(benchmark, function, rival, rounds: int, *, warm: bool = False) -> dict[str, float]:
    """Time both in turn, so that they meet the machine in the same state."""
    units = []

    def before():
        start = time.perf_counter()
        rival()
        units.append(time.perf_counter() - start)

    if not warm:
        function()
        rival()
    benchmark.pedantic(function, rounds=rounds, setup=before)
    if benchmark.stats is None:  # --benchmark-disable
        return {}
    times = benchmark.stats.stats.data
    return {
        "median_s": statistics.median(times),
        "least_s": min(times),
        "rival_median_s": statistics.median(units),
        "rival_least_s": min(units),
        "ratio": round(statistics.median(np.divide(times, units[-rounds:])), 3),
        "ratio_of_least": round(min(times) / min(units), 3),
        "rounds": rounds,
    }


def require_same_density(rows: SampledRows, likelihood: Likelihood) -> None:
    """The gate: differences of the log-density are those of the sum over all samples."""
    over = OverSamples(rows)
    points = points_of(rows.count)[:2]
    points[:, len(TRUTH) :] = points[0, len(TRUTH) :]
    values = []
    for point in points:
        asked, log_std, partial = point[:5], float(point[5]), point[6:]
        values.append(over(asked, over.best_others(asked, partial), partial, log_std))
    found = np.asarray(evaluated(likelihood, points))
    # The initial samples, which only the exact likelihood has, are two of each run.
    assert abs((values[1] - values[0]) / (found[1] - found[0]) - 1) < 0.02


def test_gate_refuses_another_density():
    rows = rows_of(COUNTS[1])
    wrong = eqx.tree_at(lambda one: one.products, rows.likelihood, 1.1 * rows.likelihood.products)
    require_same_density(rows, rows.likelihood)
    with pytest.raises(AssertionError):
        require_same_density(rows, wrong)


def test_beside_numpy_over_all_samples(benchmark, table):
    """One evaluation of each; both know the same columns beforehand."""
    rows = rows_of(COUNTS[1])
    require_same_density(rows, rows.likelihood)
    over, points = OverSamples(rows), points_of(rows.count)
    others = over.best_others(TRUTH, PARTIAL)
    found = paired(
        benchmark,
        lambda: evaluated(rows.likelihood, points).block_until_ready(),
        lambda: over(points[0, :5], others, points[0, 6:], float(points[0, 5])),
        9,
    )
    if found:
        faster = WALKERS * found["rival_median_s"] / found["median_s"]
        table["numpy_over_samples"] = found | {"times_faster": round(faster)}


def test_density_of_the_paper(benchmark, table):
    """Two flanks of 40 columns each, 12 coordinates."""
    points = target().starts(WALKERS, np.random.default_rng(0))
    function = lambda: target().log_density(points)  # noqa: E731
    found = paired(benchmark, function, lambda: np.linalg.cholesky(_matrices()), ROUNDS)
    columns = int(target().density.likelihood.products.shape[-1])
    table["paper"] = found | _per_walker(found) | {"columns_a_flank": columns}


@pytest.mark.parametrize("checkpoint", [False, True], ids=["in memory", "checkpoint"])
def test_steps_beside_emcee_on_a_gaussian(benchmark, table, checkpoint, tmp_path):
    """Four ensembles each; the rival has the same moves, walkers, coordinates and backend."""
    name = "with_checkpoint" if checkpoint else "in_memory"
    numbers = iter(range(1000))

    def ours():
        place = tmp_path / f"{next(numbers)}.h5" if checkpoint else None
        return run_ensembles(target(), steps=STEPS, walkers=WALKERS, checkpoint=place)

    _require_laplace(ours())
    found = paired(benchmark, ours, _gaussian, 3, warm=True)
    table.setdefault("steps", {})[name] = found


@pytest.mark.parametrize("count", COUNTS)
def test_cost_does_not_depend_on_the_samples(benchmark, table, count):
    """Every count beside the smallest one."""
    rows, least = rows_of(count), rows_of(COUNTS[0])
    points, rival = points_of(count), points_of(COUNTS[0])
    z = (TRUTH - rows.likelihood.fixed[list(rows.likelihood.sampled_indices)]) / STD
    assert np.abs(z).max() < _LARGEST_Z
    found = paired(
        benchmark,
        lambda: evaluated(rows.likelihood, points).block_until_ready(),
        lambda: evaluated(least.likelihood, rival).block_until_ready(),
        ROUNDS,
    )
    table.setdefault("evaluation", {})[str(count)] = found | _per_walker(found)


def _require_laplace(chains) -> None:
    """The gate: where the residual is white, draws spread as the fit says."""
    width = chains.flat().std(axis=0) / np.sqrt(np.diag(target().covariance))
    assert np.abs(np.log(width)).max() < 0.2, width


def _gaussian() -> None:
    generator, d = np.random.default_rng(0), len(target().names)
    for _ in range(4):
        sampler = emcee.EnsembleSampler(
            WALKERS, d, lambda x: -0.5 * (x**2).sum(axis=1), moves=list(MOVES), vectorize=True
        )
        sampler.run_mcmc(generator.standard_normal((WALKERS, d)), STEPS)


@cache
def _matrices() -> np.ndarray:
    """As many matrices as one evaluation factors: the least that it can cost with LAPACK."""
    shape = target().density.likelihood.products.shape
    made = np.random.default_rng(0).standard_normal((2 * WALKERS, shape[-1], 2 * shape[-1]))
    return made @ made.swapaxes(1, 2)


def _per_walker(found: dict[str, float]) -> dict[str, float]:
    if not found:
        return {}
    return {
        "us_a_walker": round(1e6 * found["median_s"] / WALKERS, 2),
        "least_us_a_walker": round(1e6 * found["least_s"] / WALKERS, 2),
    }
