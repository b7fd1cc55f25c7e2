"""Result of the calibration for one scenario with one length of run."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from .coverage import (
    BANDS,
    LEVELS,
    SAMPLED_BANDS,
    Cell,
    coverage,
    coverage_p_value,
    histogram,
    histogram_p_value,
    uniformity,
)
from .scenarios import Scenario

Ranks = Float[np.ndarray, "rigs p"]


@dataclass(frozen=True)
class Sampled:
    """Ranks of the true values of some rigs among draws from their sampled posteriors.

    **Arguments**
    - `ranks`: for each rig and judged parameter, the share of draws below the true value.
    - `steps`, `burn_in`, `walkers`: size of the ensemble of every rig. An ensemble whose start
      points are draws from the posterior has no burn-in. `steps` is the smallest number of all
      rigs: where half of the proposals are made around the fit, fewer steps are enough.
    - `tau`: longest integrated autocorrelation time of every rig, steps.
    """

    ranks: Ranks
    steps: int
    burn_in: int
    walkers: int
    tau: Float[np.ndarray, " rigs"]


@dataclass(frozen=True, eq=False)
class CaseResult:
    """Ranks of the true values of all rigs of one scenario.

    A rank is the estimated probability of values below the true value, 0 … 1.

    **Arguments**
    - `names`: names of the judged parameters.
    - `rows`, `row_s`: number of rows of all flanks together, and duration of one row, s.
    - `ranks`: ranks in the Laplace approximation of the fit; `white_rows`, `white_samples`: the
      same for a fit that takes the noise of the rows, or of single samples, as white.
    - `amplitudes`: name of a vector (x, y), such as an eccentricity → for each rig, the rank of the
      true length of this vector.
    - `orders`: order of the autoregression of every rig.
    - `std`: standard error of each parameter, mean over the rigs, mm and rad.
    - `seconds`: computing time of the case, s. - `sampled`: sampled rigs; None without sampling.
    """

    scenario: Scenario
    names: tuple[str, ...]
    rows: int
    row_s: float
    ranks: Ranks
    white_rows: Ranks
    white_samples: Ranks
    amplitudes: dict[str, Float[np.ndarray, " rigs"]]
    orders: Int[np.ndarray, " rigs"]
    std: Float[np.ndarray, " p"]
    seconds: float
    sampled: Sampled | None = field(default=None)

    @property
    def samples(self) -> int:
        """Number of samples of a log, all flanks together."""
        return self.scenario.samples * len(self.scenario.flanks)

    def range_of(self, ranks: Ranks, level: float) -> tuple[float, float]:
        """Return the lowest and the highest coverage among the parameters."""
        shares = [coverage(column, level).share for column in ranks.T]
        return min(shares), max(shares)

    def cells(self) -> list[Cell]:
        """Return one `Cell` per parameter and level for the Laplace approximation of the fit.

        It holds the p-value of the coverage; `coverage_p_value` computes it with `BANDS`.
        """
        return self._cells(self.ranks, BANDS, "Laplace")

    def sampled_cells(self) -> list[Cell]:
        """Return one `Cell` per parameter and level for the sampled rigs; empty without them.

        It holds the p-value of the coverage; `coverage_p_value` computes it with `SAMPLED_BANDS`.
        """
        if self.sampled is None:
            return []
        return self._cells(self.sampled.ranks, SAMPLED_BANDS, "sampled")

    def amplitude_cells(self) -> list[Cell]:
        """Return for each of `amplitudes` a `Cell` with the p-value of its rank histogram.

        It is the p-value of a χ² test for uniformly distributed ranks; see `histogram_p_value`. The
        test tolerates standard errors that are slightly too small, as much as the band of the
        coverage of 95 % intervals does.
        """
        return [
            Cell(self.scenario.case, name, "rank histogram", histogram_p_value(ranks))
            for name, ranks in self.amplitudes.items()
        ]

    def _cells(self, ranks: Ranks, bands: dict, route: str) -> list[Cell]:
        return [
            Cell(
                self.scenario.case,
                name,
                f"{route}, {100 * level:g} %",
                coverage_p_value(coverage(column, level), band),
            )
            for name, column in zip(self.names, ranks.T, strict=True)
            for level, band in bands.items()
        ]

    def to_json(self) -> dict:
        """Return the JSON object of the case in the schema `vttig.calibrate/1`."""
        s = self.scenario
        record = {
            "scenario": s.name,
            "length": s.length,
            "words": s.words,
            "holds": s.holds,
            "rate_hz": s.rate_hz,
            "speed_rpm": s.speed_rpm,
            "driving_turns": s.turns,
            "flanks": list(s.flanks),
            "noise_std_deg": s.noise_std_deg,
            "correlation_s": s.correlation_s,
            "counts_per_rev": s.counts_per_rev,
            "samples": self.samples,
            "rows": self.rows,
            "row_s": self.row_s,
            "rigs": len(self.ranks),
            "seconds": self.seconds,
            "noise_orders": np.bincount(self.orders).tolist(),
            "parameters": {
                name: {
                    "mean_std": float(self.std[k]),
                    "unit": "rad" if "encoder" in name or "backlash" in name else "mm",
                    "coverage": _coverages(self.ranks[:, k]),
                    "white_samples": _coverages(self.white_samples[:, k]),
                    "white_rows": _coverages(self.white_rows[:, k]),
                    **_histogram(self.ranks[:, k]),
                }
                for k, name in enumerate(self.names)
            },
            "amplitudes": {name: _histogram(ranks) for name, ranks in self.amplitudes.items()},
        }
        if self.sampled is not None:
            record["sampled"] = _sampled(self.sampled, self.names)
        return record


def _coverages(ranks: Float[np.ndarray, " rigs"]) -> list[dict]:
    return [coverage(ranks, level).to_json() for level in LEVELS]


def _histogram(ranks: Float[np.ndarray, " rigs"]) -> dict:
    return {"rank_histogram": histogram(ranks), "uniformity": uniformity(ranks)}


def _sampled(sampled: Sampled, names: tuple[str, ...]) -> dict:
    return {
        "rigs": len(sampled.ranks),
        "walkers": sampled.walkers,
        "burn_in": sampled.burn_in,
        "steps": sampled.steps,
        "longest_tau": float(np.max(sampled.tau)),
        "parameters": {
            name: {"coverage": _coverages(ranks), **_histogram(ranks)}
            for name, ranks in zip(names, sampled.ranks.T, strict=True)
        },
    }
