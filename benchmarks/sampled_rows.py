"""Rows of a gear pair, as many as one likes, and what the sampler and its rivals make of them."""

from dataclasses import dataclass
from fractions import Fraction

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter

from vttig_jax.base.numerics.partial_autocorrelation import filter_of
from vttig_jax.identify.compress.harmonic_summary import HarmonicSummary
from vttig_jax.identify.compress.lagged_flank import LaggedFlank
from vttig_jax.identify.compress.orthogonal import ConditionedRuns
from vttig_jax.identify.model.column_layout import OFFSET, ColumnLayout
from vttig_jax.identify.model.forward_model import ForwardModel, pair_relation
from vttig_jax.identify.model.harmonics import Harmonic, TermPlan
from vttig_jax.posterior.density.likelihood import Likelihood, likelihood_of
from vttig_jax.rig.paper import paper_pair

FREE = tuple((n, 0) for n in range(2, 9)) + tuple((0, n) for n in range(2, 9))
TIED = ((1, 0), (0, 1), (1, 1), (1, -1))
ASKED = ("constant_backlash", "driving_x", "driving_y", "driven_x", "driven_y")
TRUTH = np.array([6.6e-4, 0.0147, 0.0172, 0.0051, 0.0268])
PARTIAL = np.array([0.6, -0.2])
STD = 3e-5
PIECE = 250_000
"""Rows of one uninterrupted run."""


def _harmonic(term: tuple[int, int]) -> Harmonic:
    shaft = {True: "driving", False: "driven"}[term[1] == 0] if 0 in term else "both"
    return Harmonic(shaft, sum(map(abs, term)), term)


PAIR = paper_pair()
TERMS = TermPlan(Fraction(PAIR.ratio), tuple(map(_harmonic, FREE)), tuple(map(_harmonic, TIED)), ())
COLUMNS = ColumnLayout(FREE, TIED, ((OFFSET,),))
RELATION: ForwardModel = pair_relation(PAIR, TERMS, COLUMNS, ("A", "B"), encoder_terms=False)


@dataclass(frozen=True)
class SampledRows:
    """`count` rows in all, those of flank A and B in runs of at most `PIECE`, compressed."""

    count: int
    summary: HarmonicSummary
    likelihood: Likelihood
    runs: dict[str, list[np.ndarray]]


def sampled_rows(count: int, *, keep: bool = False) -> SampledRows:
    """Make and compress rows run by run; `keep` holds them for those who need every sample."""
    parameters = np.zeros(len(RELATION.names))
    for name, value in zip(ASKED, TRUTH, strict=True):
        parameters[RELATION.names.index(name)] = value
    tied = np.asarray(eqx.filter_jit(RELATION.coefficients)(jnp.asarray(parameters)))
    generator = np.random.default_rng(0)
    free = 2e-5 * generator.standard_normal((2, 2 * len(FREE)))
    flanks, kept = [], {"A": [], "B": []}
    for side, flank in enumerate(("A", "B")):
        whole = None
        left = count // 2
        while left:
            length = min(left, PIECE)
            rows = _rows(length, np.concatenate([free[side], tied[side]]), generator)
            runs = ConditionedRuns.of([rows], np.empty((0, rows.shape[1])))
            part = LaggedFlank.of_runs("AB"[side], runs, (), 5e-4, len(PARTIAL))
            whole = part if whole is None else whole + part
            left -= length
            if keep:
                kept[flank].append(rows)
        flanks.append(whole)
    summary = HarmonicSummary(tuple(flanks), TERMS, COLUMNS, 5e-4)
    jacobian = np.asarray(jax.jacobian(RELATION.coefficients)(jnp.asarray(parameters)))
    likelihood = likelihood_of(summary, RELATION, jacobian, parameters, ASKED, len(PARTIAL))
    return SampledRows(count, summary, likelihood, kept)


def _rows(length: int, weights: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Columns of `COLUMNS` over random whole turns at constant speed, and y behind them."""
    driving = generator.uniform(0, 6.28) + 2 * np.pi / 1987.0 * np.arange(length)
    driven = float(PAIR.ratio) * driving
    harmonics = [np.exp(1j * (a * driving + b * driven)) for a, b in (*FREE, *TIED)]
    pairs = [part for h in harmonics for part in (h.real, h.imag)]
    pairs.insert(2 * len(FREE), np.ones(length))
    regressors = np.stack(pairs, axis=1)
    shocks = STD * generator.standard_normal(length + 500)
    noise = np.asarray(lfilter([1.0], filter_of(PARTIAL), shocks))[500:]
    return np.column_stack([regressors, regressors @ weights + noise])


class OverSamples:
    """The log-density people write for emcee: precomputed columns, residual, filter, sum.

    Every coefficient that is not asked is an argument too: nothing can be integrated out without
    solving for it, which costs more still.
    """

    def __init__(self, rows: SampledRows):
        self.runs = rows.runs
        self.tied = eqx.filter_jit(RELATION.coefficients)
        self.places = [RELATION.names.index(name) for name in ASKED]

    def __call__(
        self, asked: np.ndarray, others: np.ndarray, partial: np.ndarray, log_std: float
    ) -> float:
        """Log-density given the free coefficients of both flanks and the offset, in `others`."""
        parameters = np.zeros(len(RELATION.names))
        parameters[self.places] = asked
        parameters[RELATION.names.index(OFFSET)] = others[-1]
        tied = np.asarray(self.tied(parameters))
        free = others[:-1].reshape(2, -1)
        filter_, misfit, count = filter_of(partial), 0.0, 0
        for side, runs in enumerate(self.runs.values()):
            weights = np.concatenate([free[side], tied[side]])
            for rows in runs:
                residual = rows[:, -1] - rows[:, :-1] @ weights
                innovation = np.convolve(residual, filter_, "valid")
                misfit += innovation @ innovation
                count += len(innovation)
        return -count * log_std - 0.5 * misfit * float(np.exp(-2 * log_std))

    def best_others(self, asked: np.ndarray, partial: np.ndarray) -> np.ndarray:
        """Coefficients that maximise the log-density for given parameters and noise."""
        others = np.zeros(4 * len(FREE) + 1)
        parameters = np.zeros(len(RELATION.names))
        parameters[self.places] = asked
        tied = np.asarray(self.tied(parameters))
        wide = len(others)
        gram, right = np.zeros((wide, wide)), np.zeros(wide)
        filter_ = filter_of(partial)
        for side, runs in enumerate(self.runs.values()):
            own = [*range(side * 2 * len(FREE), (side + 1) * 2 * len(FREE)), wide - 1]
            for rows in runs:
                left = rows[:, -1] - rows[:, 2 * len(FREE) : -1] @ tied[side]
                some = np.column_stack([rows[:, : 2 * len(FREE) + 1], left])
                white = lfilter(filter_, [1.0], some, axis=0)[len(partial) :]
                gram[np.ix_(own, own)] += white[:, :-1].T @ white[:, :-1]
                right[own] += white[:, :-1].T @ white[:, -1]
        return np.linalg.solve(gram, right)
