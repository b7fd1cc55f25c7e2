"""Importance sampling from a Student t distribution around the Laplace approximation."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from .checkpoint import Header
from .convergence import Diagnosis, r_hat
from .ensemble_blocks import Record
from .pareto import LARGEST_K, smoothed_log_weights
from .stop_rule import Until
from .target import Target

POOL = 4096  # draws of one ensemble by default (chosen)
_PER_WALKER = 16  # weighted draws that are made for the start of one walker (chosen)
_FEWEST_EFFECTIVE = 400.0  # effective draws that each ensemble needs (chosen)

FREEDOM = 8.0
"""Degrees of freedom of the Student t distribution (chosen): its tails are wider than normal."""


@runtime_checkable
class LaplaceTarget(Target, Protocol):
    """Log density with its Laplace approximation, a normal distribution around its maximum."""

    @property
    def centre(self) -> Float[np.ndarray, " d"]:
        """Maximum of the density."""
        ...

    @property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Covariance of the Laplace approximation."""
        ...


@dataclass(frozen=True)
class WeightedDraws:
    """Draws of the Student t distribution with weights that make them draws of the target.

    **Arguments**
    - `points`, `log_density`: draws, and the log density of the target.
    - `weights`: normalised, Pareto-smoothed weights.
    - `k_hat`: shape of the tail of the weights, see `smoothed_log_weights`.
    """

    points: Float[np.ndarray, "n d"]
    log_density: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, " n"]
    k_hat: float

    @property
    def reliable(self) -> bool:
        """Whether the weights can be trusted, because k̂ is at most `LARGEST_K`."""
        return self.k_hat <= LARGEST_K

    @property
    def effective(self) -> float:
        """Effective number of draws, 1 / Σ w²."""
        return float(1 / np.sum(self.weights**2))

    def resampled(
        self, count: int, generator: np.random.Generator, *, replace: bool
    ) -> Int[np.ndarray, " count"]:
        """Choose `count` draws with a probability proportional to their weight.

        **Returns** the indices of the chosen draws, which then have equal weight. If `replace` is
        False, no index occurs twice.
        """
        if replace:  # systematic resampling has the least variance
            places = (np.arange(count) + generator.random()) / count
            found = np.searchsorted(np.cumsum(self.weights), places)
            return generator.permutation(np.minimum(found, len(self.weights) - 1))
        return generator.choice(len(self.weights), count, replace=False, p=self.weights)


def weighted_draws(
    target: LaplaceTarget, count: int, generator: np.random.Generator
) -> WeightedDraws:
    """Draw from a Student t distribution and weight the draws with the density p of the target.

    A draw is x = μ + L z √(ν/χ²_ν) with z standard normal, μ and LLᵀ the mean and covariance of the
    Laplace approximation, and ν = `FREEDOM`. Its weight is p(x) (1 + |z|²/χ²_ν)^((ν + d)/2).
    """
    normal = generator.standard_normal((count, len(target.centre)))
    normal *= np.sqrt(FREEDOM / generator.chisquare(FREEDOM, (count, 1)))
    points = target.centre + normal @ np.linalg.cholesky(target.covariance).T
    values = np.asarray(target.log_density(points), np.float64)
    log_weights, k_hat = smoothed_log_weights(values - log_student(normal, FREEDOM))
    return WeightedDraws(points, values, np.exp(log_weights), k_hat)


def log_student(scaled: Float[np.ndarray, "n d"], freedom: float) -> Float[np.ndarray, " n"]:
    """Return the log density of a Student t distribution at n points, up to a constant.

    `scaled` are L⁻¹ (x − μ), see `weighted_draws`, and `freedom` is ν.
    """
    square = np.sum(scaled**2, axis=1)
    return -0.5 * (freedom + scaled.shape[1]) * np.log1p(square / freedom)


@dataclass(frozen=True)
class PosteriorStarts:
    """Target whose walkers start from draws of the density itself, so that no burn-in is needed.

    Every call of `starts` makes new draws. Ensembles with different generators are therefore
    independent.
    """

    target: LaplaceTarget

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.target.names

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each coordinate."""
        return self.target.units

    @property
    def identity(self) -> dict[str, Any]:
        """JSON values that identify the density."""
        return self.target.identity

    @property
    def centre(self) -> Float[np.ndarray, " d"]:
        """Maximum of the density."""
        return self.target.centre

    @property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Covariance of the Laplace approximation."""
        return self.target.covariance

    def log_density(self, points: Float[np.ndarray, "walkers d"]) -> Float[np.ndarray, " walkers"]:
        """Return the log density of each point."""
        return self.target.log_density(points)

    def starts(self, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count d"]:
        """Return `count` different starting points, drawn from the density of the target.

        Sixteen weighted draws are made for every start. The starts are chosen from them without
        replacement, with a probability proportional to the weight. If fewer than `count` draws have
        a weight above zero, the starts of `target` are returned instead.
        """
        draws = weighted_draws(self.target, _PER_WALKER * count, generator)
        if np.count_nonzero(draws.weights) < count:
            return self.target.starts(count, generator)
        return draws.points[draws.resampled(count, generator, replace=False)]


@dataclass(frozen=True)
class ImportanceDiagnosis(Diagnosis):
    """Quality of importance sampling, in which each ensemble is an independent set of draws.

    `tau` is the number of draws per effective draw, `shortest` the smallest number of effective
    draws of an ensemble, and `pareto_k` the largest shape k̂ of the weights of an ensemble.
    """

    pareto_k: float = np.inf

    @property
    def long_enough(self) -> bool:
        """Whether every ensemble has 400 effective draws."""
        return self.shortest >= _FEWEST_EFFECTIVE

    @property
    def converged(self) -> bool:
        """Whether the weights can be trusted, the draws suffice and the ensembles agree."""
        return self.pareto_k <= LARGEST_K and super().converged

    def __str__(self) -> str:
        text = (
            f"converged: {'yes' if self.converged else 'no'}; importance sampling,"
            f" {self.effective.min():.0f} effective draws; Pareto k̂ {self.pareto_k:.2f};"
            f" R-hat {np.max(self.r_hat):.3f}"
        )
        return text if self.converged else f"{text}; {self._cure()}"

    def _cure(self) -> str:
        if self.pareto_k <= LARGEST_K:
            return f"draw more, about --steps {4 * self.steps}"
        return "the posterior is too far from normal for its weights: sample with --method emcee"

    def to_json(self) -> dict[str, Any]:
        """Return the record of a `Diagnosis` with two more keys, `pareto_k` and `sampler`."""
        shape = self.pareto_k if np.isfinite(self.pareto_k) else None
        return super().to_json() | {"pareto_k": shape, "sampler": "importance"}


def importance_diagnosis(
    header: Header, draws: Float[np.ndarray, "ensembles n one d"], until: Until
) -> ImportanceDiagnosis:
    """Return the diagnosis of equally weighted draws of importance sampling.

    The effective numbers of draws and the shapes k̂ of the original weights are in `header`.
    """
    count = draws.shape[1]
    effective = np.maximum(header.effective, 1e-300)
    every = np.ones(len(header.names))
    return ImportanceDiagnosis(
        names=header.names,
        tau=count / np.mean(effective) * every,
        shortest=float(np.min(effective)),
        r_hat=r_hat(draws),
        acceptance=float(np.mean(effective) / count),
        effective=np.sum(effective) * every,
        steps=count,
        until=until,
        burn_in=0.0,
        pareto_k=float(np.max(header.pareto_k)),
    )


def importance_record(
    target: LaplaceTarget, ensembles: int, count: int, seed: int
) -> tuple[Header, Record]:
    """Return independent sets of equally weighted draws, in the form of a checkpoint.

    `ensembles` is the number of sets, and `count` is the number of draws in each.
    """
    generators = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(ensembles)]
    samples = [weighted_draws(target, count, generator) for generator in generators]
    chosen = [
        own.resampled(count, generator, replace=True)
        for own, generator in zip(samples, generators, strict=True)
    ]
    pairs = list(zip(samples, chosen, strict=True))
    points = np.stack([own.points[places] for own, places in pairs])[:, :, None]
    values = np.stack([own.log_density[places] for own, places in pairs])[:, :, None]
    header = Header(
        names=target.names,
        units=target.units,
        identity=target.identity,
        seed=seed,
        ensembles=ensembles,
        walkers=1,
        thin=1,
        burn_in=0.0,
        method="importance",
        pareto_k=tuple(float(np.nan_to_num(own.k_hat, neginf=-1e300)) for own in samples),
        effective=tuple(own.effective for own in samples),
    )
    record = Record(
        steps=count,
        thin=1,
        draws=points,
        log_density=values,
        accepted=np.zeros(ensembles, np.int64),
        points=points[:, -1],
        point_log_density=values[:, -1],
        keys=np.zeros((ensembles, 624), np.uint32),
        rest=np.zeros((ensembles, 3)),
    )
    return header, record
