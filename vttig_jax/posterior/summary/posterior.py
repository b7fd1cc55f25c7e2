"""The posterior of a fit: its draws, its report, and the draws as an arviz object."""

import importlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import NoAnswerError, UsageError
from ...base.files.text_tables import key_values, text_table
from ...base.numerics.partial_autocorrelation import filter_of
from ...base.runtime import require_x64
from ...identify.fit_result import Fit
from .draws import PosteriorParameter, Share, SmallestGap, batches, border, parameters_of_draws
from .gap_draws import GapDraws

NOISE = ("log_innovation_std", "partial_")
"""How the names of noise parameters begin."""


@dataclass(frozen=True)
class Posterior:
    """Draws from the posterior of a fit.

    **Arguments**
    - `fit`: the fit it belongs to.
    - `names`, `units`: Cartesian coordinates in internal units (mm, rad, s), then noise parameters
      `log_innovation_std`, `partial_1` …
    - `draws`: after burn-in, shape (ensembles, steps, walkers, d).
    - `log_density`: of every draw, shape (ensembles, steps, walkers).
    - `offset`, `cosine`, `sine`: m joint draws of the order-complete flank model, rad, shapes
      (m, 2), (m, 2, terms), (m, 2, terms), with the terms of `fit.model`; NaN for a flank that was
      not measured.
    - `chosen`: which flat draw each of the m belongs to, counted in the order of `draws`.
    - `diagnosis`: whether the sampler can be trusted: `converged`, `to_json()` and `str()`.
    - `prior`: sentences that state the priors.
    - `seed`: of the sampler.
    - `delay_offset_s`: what the fit had taken out before; the `delay` coordinate is what remains.
    """

    fit: Fit
    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: Float[np.ndarray, "ensembles steps walkers d"]
    log_density: Float[np.ndarray, "ensembles steps walkers"]
    offset: Float[np.ndarray, "m 2"]
    cosine: Float[np.ndarray, "m 2 terms"]
    sine: Float[np.ndarray, "m 2 terms"]
    chosen: Int[np.ndarray, " m"]
    diagnosis: Any
    prior: tuple[str, ...]
    seed: int
    delay_offset_s: float = 0.0

    @property
    def flat(self) -> Float[np.ndarray, "n d"]:
        """All draws as rows: ensemble by ensemble, step by step, walker by walker."""
        return self.draws.reshape(-1, self.draws.shape[-1])

    @property
    def physical(self) -> tuple[str, ...]:
        """Coordinates that are no noise parameters."""
        return tuple(name for name in self.names if not name.startswith(NOISE))

    @cached_property
    def parameters(self) -> dict[str, PosteriorParameter]:
        """Every name of the contract → parameter with median and equal-tailed interval."""
        return parameters_of_draws(self.fit, self.names, self.flat, self.delay_offset_s)

    def place(self, name: str) -> int:
        """Position of a coordinate in `names`."""
        if name not in self.names:
            raise ValueError(
                f"Argument `name` must be one of {', '.join(self.names)}, but is {name!r}."
            )
        return self.names.index(name)

    def values(self, name: str) -> Float[np.ndarray, " n"]:
        """Flat draws of one coordinate, internal unit."""
        return self.flat[:, self.place(name)]

    @cached_property
    def mean(self) -> Float[np.ndarray, " d"]:
        """Mean of every coordinate, internal units."""
        return self.flat.mean(axis=0)

    @cached_property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Covariance of all coordinates, internal units."""
        return np.atleast_2d(np.cov(self.flat.T))

    @property
    def correlation(self) -> Float[np.ndarray, "p p"]:
        """Correlation of the physical coordinates, in the order of `physical`."""
        place = [self.names.index(name) for name in self.physical]
        covariance = self.covariance[np.ix_(place, place)]
        size = np.sqrt(np.diag(covariance))
        size = np.where(size > 0, size, 1.0)
        return covariance / np.outer(size, size)

    @property
    def centred_fit(self) -> Fit:
        """The fit with the mean of the draws in place of its values."""
        values = self.fit.values.copy()
        for place, name in enumerate(self.fit.covariance_names):
            if name in self.names:
                values[place] = self.mean[self.names.index(name)]
        return replace(self.fit, values=values)

    @cached_property
    def smallest_gap(self) -> SmallestGap:
        """Distribution of the smallest gap over the hunting period and of the safe closing.

        **Raises** `NoAnswerError` where the gap is not known.
        """

        return gap_draws(self).smallest

    def noise(
        self, rows: Int[np.ndarray, " r"]
    ) -> tuple[list[Float[np.ndarray, " taps"]], Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
        """Whitening filter, std of the innovations and std of the noise, rad, of some flat draws.

        From `log_innovation_std` and the partial autocorrelations; the noise of the fit where there
        are no noise parameters.
        """
        fitted = self.fit.noise
        if "log_innovation_std" not in self.names:
            count = len(rows)
            innovation, std = (np.full(count, x) for x in (fitted.innovation_std, fitted.std))
            return [fitted.filter] * count, innovation, std
        order = sum(name.startswith("partial_") for name in self.names)
        places = [self.names.index(f"partial_{k}") for k in range(1, order + 1)]
        partial = self.flat[rows][:, places]
        largest = float(np.abs(partial).max(initial=0.0))
        if largest >= 1:
            raise ValueError(
                "Argument `draws` must have partial autocorrelations between −1 and 1, but one is"
                f" {largest:.3g} in size."
            )
        innovation = np.exp(self.values("log_innovation_std")[rows])
        std = innovation / np.sqrt(np.prod(1 - partial**2, axis=1))
        return [np.asarray(filter_of(one)) for one in partial], innovation, std

    def probability_of_binding(self, closing_mm: float) -> Share:
        """Share of the draws in which an axial closing, mm, binds anywhere, and its error."""
        return self.smallest_gap.probability_of_binding(closing_mm)

    def to_arviz(self) -> Any:
        """The draws for arviz: `InferenceData` before arviz 1, a `DataTree` from then on."""
        return to_arviz(self)

    def to_json(self) -> dict:
        """The object of schema `vttig.posterior/1`: the fit's, with what the draws add."""
        record = self.fit.to_json()
        gap, reason = None, None
        try:
            gap = self.smallest_gap.to_json()
        except NoAnswerError as error:
            reason = error.message
        ensembles, steps, walkers = self.draws.shape[:3]
        return record | {
            "schema": "vttig.posterior/1",
            "parameters": {name: p.to_json() for name, p in self.parameters.items()},
            "coordinates": [self._coordinate(name) for name in self.names],
            "correlation": {"names": list(self.physical), "matrix": self.correlation.tolist()},
            "smallest_gap": gap,
            "smallest_gap_reason": reason,
            "diagnosis": self.diagnosis.to_json(),
            "converged": bool(self.diagnosis.converged),
            "prior": list(self.prior),
            "draws": {"ensembles": ensembles, "steps": steps, "walkers": walkers},
            "seed": self.seed,
        }

    def _coordinate(self, name: str) -> dict:
        unit, scale = border(name, self.units[self.place(name)])
        draws = self.values(name) / scale
        return {
            "name": name,
            "unit": unit,
            "mean": float(draws.mean()),
            "std": float(draws.std(ddof=1)),
        }

    def __str__(self) -> str:
        return posterior_text(self)


def posterior_text(posterior: Posterior) -> str:
    """What the draws say: parameters, the smallest gap, priors, and whether to trust them."""
    ensembles, steps, walkers = posterior.draws.shape[:3]
    counted = f"{ensembles} ensembles × {steps} steps × {walkers} walkers"
    head = key_values(
        [
            ("log", posterior.fit.source),
            ("draws", f"{counted}, seed {posterior.seed}"),
            *_gap(posterior),
        ],
        title=f"posterior of {posterior.fit.pair.name or 'fit'}",
    )
    parameters = list(posterior.parameters.values())
    rows = [_row(p) for p in parameters if p.determined]
    table = text_table(
        rows, ["parameter", "mean", "median", "std", "95 % interval", "unit"], align="lrrrrr"
    )
    parts = [head, table]
    parts += _listed("undetermined", _reasons(parameters))
    parts += _listed("priors", list(posterior.prior))
    if posterior.fit.conditional_on:
        conditions = ", ".join(posterior.fit.conditional_on).replace("_", " ")
        parts.append(f"conditional on: {conditions}")
    parts.append(str(posterior.diagnosis))
    return "\n\n".join(parts)


def _gap(posterior: Posterior) -> list[tuple[str, str]]:
    try:
        return posterior.smallest_gap.rows()
    except NoAnswerError as error:
        return [("smallest gap", f"not known: {error.message}")]


def _reasons(parameters: list[PosteriorParameter]) -> list[str]:
    """Undetermined parameters, those of one reason together."""
    together: dict[str, list[str]] = {}
    for parameter in parameters:
        if not parameter.determined:
            together.setdefault(parameter.reason or "", []).append(parameter.name)
    return [f"{', '.join(names)}: {reason}" for reason, names in together.items()]


def _listed(title: str, lines: list[str]) -> list[str]:
    return ["\n".join([f"{title}:", *(f"  {line}" for line in lines)])] if lines else []


def _row(parameter: PosteriorParameter) -> list[str]:
    p = parameter
    if p.value is None:
        return [p.name, "—", "", "", "", p.unit]
    places = decimals(p.std or 0.0, p.value)
    number = lambda x: "" if x is None else f"{x:.{places}f}"  # noqa: E731
    if p.upper95 is not None:
        shown = [f"< {number(p.upper95)}", number(p.median), number(p.std), "upper limit"]
        return [p.name, *shown, p.unit]
    mark = "" if p.significant else " (not significant)"
    span = f"{number(p.low95)} … {number(p.high95)}"
    return [p.name, number(p.value) + mark, number(p.median), number(p.std), span, p.unit]


def decimals(std: float, value: float) -> int:
    """Decimals that show two digits of a standard deviation."""
    import math

    size = std if std > 0 else abs(value) * 1e-6
    return 3 if size == 0 else min(max(1 - math.floor(math.log10(size)), 0), 12)


def to_arviz(posterior: Posterior) -> Any:
    """Draws and log density: an `InferenceData` before arviz 1, an xarray `DataTree` from then on.

    A chain is an ensemble; a draw is a (step, walker), step by step. Walkers of one ensemble step
    together, so chains are independent but neighbouring draws are not a time series: effective
    sample sizes by arviz count walkers as if they were steps, the diagnosis of the posterior does
    not. Variables are the coordinates in internal units, which stand in their `attrs`.

    arviz 1 shows 89 % intervals unless told otherwise: give `ci_prob=0.95` (before: `hdi_prob`).

    **Raises** `UsageError` where arviz is not installed.
    """
    try:
        arviz: Any = importlib.import_module("arviz")
    except ImportError:
        raise UsageError(
            "handing draws to arviz needs the package arviz: pip install `vttig-jax[arviz]`."
        ) from None
    ensembles, steps, walkers, size = posterior.draws.shape
    chains = posterior.draws.reshape(ensembles, steps * walkers, size)
    groups = {
        "posterior": {name: chains[:, :, k] for k, name in enumerate(posterior.names)},
        "sample_stats": {"lp": posterior.log_density.reshape(ensembles, -1)},
    }
    # The groups were keyword arguments; from arviz 1 on they are one nested mapping.
    nested = int(arviz.__version__.partition(".")[0]) >= 1
    found = arviz.from_dict(groups) if nested else arviz.from_dict(**groups)
    for name, unit in zip(posterior.names, posterior.units, strict=True):
        found["posterior"][name].attrs["units"] = unit
    found["posterior"].attrs.update(
        {
            "source": posterior.fit.source,
            "seed": np.int64(posterior.seed),
            "walkers": np.int64(walkers),
            "converged": str(bool(posterior.diagnosis.converged)),
        }
    )
    return found


def gap_draws(posterior: Posterior) -> "GapDraws":
    """Draws of the backlash map of a posterior.

    **Raises** `NoAnswerError` where one flank was not measured or the constant backlash is
    undetermined.
    """
    require_x64("gap_draws")
    fit = posterior.fit
    gap = fit.parameters["constant_backlash_deg"]
    if len(fit.flanks) < 2:
        raise NoAnswerError(
            f"only flank {''.join(fit.flanks)} was measured, and draws of one flank say nothing"
            " about the gap to the other; record both directions.",
            where=fit.source,
        )
    if not gap.determined:
        raise NoAnswerError(
            f"the constant backlash is undetermined ({gap.reason}); record more turns.",
            where=fit.source,
        )
    return flank_draws(posterior)


def flank_draws(posterior: Posterior) -> "GapDraws":
    """Draws of the flanks, measured or not: of a flank that was not, everything is NaN."""
    fit = posterior.fit
    return GapDraws(
        fit.pair,
        tuple(fit.model.terms),
        posterior.offset,
        posterior.cosine,
        posterior.sine,
        batches(posterior.chosen, posterior.draws.shape[:3]),
    )
