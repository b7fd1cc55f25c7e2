"""Posterior of a fit: its draws, its report, and its export to arviz."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import NoAnswerError
from ...base.facade import from_front_door
from ...base.files.text_tables import decimals, key_values, listed, text_table
from ...base.numerics.partial_autocorrelation import filter_of
from ...base.results import PlottedResult
from ...base.runtime import require_x64
from ...identify.fit_result import Fit
from ...identify.report.check_sentences import doubt
from ..sampling.ensembles import Chains
from .arviz_export import arviz_data
from .draws import PosteriorParameter, Share, SmallestGap, batches, parameters_of_draws, shown_unit
from .gap_draws import GapDraws

NOISE = ("log_innovation_std", "partial_")
"""The names of all noise parameters begin with one of these."""

_GAP = "constant_backlash"  # the coordinate to which the gap of a delay is added

_WIDTH = 100
"""Characters in a line of the sentence above the report (chosen)."""

_WIDER = 1.05
"""Smallest `widening` that the report mentions (chosen)."""


@dataclass(frozen=True)
class Posterior(PlottedResult):
    """Draws from the posterior of a fit.

    **Arguments**
    - `fit`: fit of the log.
    - `names`, `units`: Cartesian coordinates in internal units (mm, rad, s), then noise parameters
      `log_innovation_std`, `partial_1` …
    - `draws`: draws after burn-in, shape (ensembles, steps, walkers, d).
    - `log_density`: log density of every draw, shape (ensembles, steps, walkers).
    - `offset`, `cosine`, `sine`: m joint draws of the order-complete flank model, rad, shapes
      (m, 2), (m, 2, terms), (m, 2, terms), with the terms of `fit.model`; NaN for an unmeasured
      flank.
    - `chosen`: for each of the m draws of the flank model, the index in `flat` of the draw of the
      parameters from which it was computed.
    - `diagnosis`: convergence of the sampler: `converged`, `to_json()` and `str()`.
    - `prior`: sentences that state the priors.
    - `seed`: seed of the sampler.
    - `delay_offset_s`: delay that the fit removed before, s; it is added to the coordinate `delay`.
    - `chains`: the chains of the sampler, burn-in included.
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
    chains: Chains | None = None

    @property
    def flat(self) -> Float[np.ndarray, "n d"]:
        """All draws as rows: ensemble by ensemble, step by step, walker by walker."""
        return self.draws.reshape(-1, self.draws.shape[-1])

    @property
    def physical(self) -> tuple[str, ...]:
        """Names of the coordinates that are not noise parameters."""
        return tuple(name for name in self.names if not name.startswith(NOISE))

    @cached_property
    def parameters(self) -> dict[str, PosteriorParameter]:
        """Parameters of the fit by name, with median and equal-tailed interval."""
        flat = self.flat
        if self.gap_of_delay is not None:
            flat = flat.copy()
            flat[:, self.place(_GAP)] += self.gap_of_delay
        return parameters_of_draws(self.fit, self.names, flat, self.delay_offset_s)

    @cached_property
    def gap_of_delay(self) -> Float[np.ndarray, " n"] | None:
        """Gap, rad, that a delay may add to the gap of every draw in `flat`; None if there is none.

        The coordinates are conditional on the delay that the fit takes as zero. The parameters, the
        backlash map, the smallest gap and the rigs contain this gap; see `GapOfDelay`.
        """
        of_delay = self.fit.checks.gap_of_delay
        if of_delay is None or _GAP not in self.names:
            return None
        return of_delay.draws(self.values(_GAP), self.seed)

    @property
    def widening(self) -> float:
        """Largest ratio of the final to the noise-model standard error of a sampled parameter.

        The fit records these ratios; 1 without a record.
        """
        evidence = self.fit.evidence
        if evidence is None:
            return 1.0
        factors = dict(zip(self.fit.covariance_names, evidence.widening.tolist(), strict=True))
        return max((factors[name] for name in self.physical), default=1.0)

    def place(self, name: str) -> int:
        """Return the index of a coordinate in `names`."""
        if name not in self.names:
            raise ValueError(
                f"Argument `name` must be one of {', '.join(self.names)}, but is {name!r}."
            )
        return self.names.index(name)

    def values(self, name: str) -> Float[np.ndarray, " n"]:
        """Return the flat draws of one coordinate, internal unit."""
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
        indices = [self.names.index(name) for name in self.physical]
        covariance = self.covariance[np.ix_(indices, indices)]
        std = np.sqrt(np.diag(covariance))
        std = np.where(std > 0, std, 1.0)
        return covariance / np.outer(std, std)

    @property
    def centred_fit(self) -> Fit:
        """Copy of the fit in which the means of the draws replace the values of the parameters."""
        values = self.fit.values.copy()
        for index, name in enumerate(self.fit.covariance_names):
            if name in self.names:
                values[index] = self.mean[self.names.index(name)]
        return replace(self.fit, values=values)

    @cached_property
    def smallest_gap(self) -> SmallestGap:
        """Distribution of the smallest gap over the hunting period and of the safe closing.

        **Raises** `NoAnswerError` if the gap is not known.
        """

        return gap_draws(self).smallest

    def noise(
        self, rows: Int[np.ndarray, " r"]
    ) -> tuple[list[Float[np.ndarray, " taps"]], Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
        """Return whitening filter, innovation std and noise std, rad, of the draws `flat[rows]`.

        They follow from the coordinates `log_innovation_std` and `partial_1` … If the draws do not
        have these coordinates, the noise of the fit is returned for every row.
        """
        fitted = self.fit.noise
        if "log_innovation_std" not in self.names:
            count = len(rows)
            innovation, std = (np.full(count, x) for x in (fitted.innovation_std, fitted.std))
            return [fitted.filter] * count, innovation, std
        order = sum(name.startswith("partial_") for name in self.names)
        indices = [self.names.index(f"partial_{k}") for k in range(1, order + 1)]
        partial = self.flat[rows][:, indices]
        largest = float(np.abs(partial).max(initial=0.0))
        if largest >= 1:
            raise ValueError(
                "Argument `draws` must have partial autocorrelations between −1 and 1, but one is"
                f" {largest:.3g} in size."
            )
        innovation = np.exp(self.values("log_innovation_std")[rows])
        std = innovation / np.sqrt(np.prod(1 - partial**2, axis=1))
        return [np.asarray(filter_of(row)) for row in partial], innovation, std

    def probability_of_binding(self, closing_mm: float) -> Share:
        """Return the share of draws in which an axial closing, mm, binds, with standard error."""
        return self.smallest_gap.probability_of_binding(closing_mm)

    def save(self, folder: str | Path, *, overwrite: bool = False, figures: bool = True) -> None:
        """Write draws, report, map and pictures; see `vttig_jax.runs.save_posterior`."""
        from_front_door("save_posterior")(self, folder, overwrite=overwrite, figures=figures)

    def to_arviz(self) -> Any:
        """Return the draws for arviz: `InferenceData` before arviz 1, a `DataTree` from then on."""
        return arviz_data(
            self.names,
            self.units,
            self.draws,
            self.log_density,
            source=self.fit.source,
            seed=np.int64(self.seed),
            converged=str(bool(self.diagnosis.converged)),
        )

    def to_json(self) -> dict:
        """Return the JSON object of schema `vttig.posterior/1`: that of the fit, with the draws."""
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
        unit, scale = shown_unit(name, self.units[self.place(name)])
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
    """Return the report: parameters, smallest gap, priors and convergence."""
    ensembles, steps, walkers = posterior.draws.shape[:3]
    counted = f"{ensembles} ensembles × {steps} steps × {walkers} walkers"
    head = key_values(
        [
            ("log", posterior.fit.source),
            ("draws", f"{counted}, seed {posterior.seed}"),
            *_gap(posterior),
            *_widened(posterior),
        ],
        title=f"posterior of {posterior.fit.pair.name or 'fit'}",
    )
    parameters = list(posterior.parameters.values())
    rows = [_row(p) for p in parameters if p.determined]
    table = text_table(
        rows, ["parameter", "mean", "median", "std", "95 % interval", "unit"], align="lrrrrr"
    )
    warning = posterior.diagnosis.warning
    parts = [fill(f"{warning}.", _WIDTH), head, table] if warning else [head, table]
    parts += listed("undetermined", _reasons(parameters))
    parts += listed("priors", list(posterior.prior))
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


def _widened(posterior: Posterior) -> list[tuple[str, str]]:
    if posterior.widening < _WIDER:
        return []
    words = "times the width that the noise model alone gives, as the standard errors of the fit"
    return [("intervals", f"up to {posterior.widening:.2g} {words}")]


def _reasons(parameters: list[PosteriorParameter]) -> list[str]:
    """Return lines on undetermined parameters, grouped by reason."""
    by_reason: dict[str, list[str]] = {}
    for parameter in parameters:
        if not parameter.determined:
            by_reason.setdefault(parameter.reason or "", []).append(parameter.name)
    return [f"{', '.join(names)}: {reason}" for reason, names in by_reason.items()]


def _row(parameter: PosteriorParameter) -> list[str]:
    p = parameter
    if p.value is None:
        return [p.name, "—", "", "", "", p.unit]
    places = decimals(p.std or 0.0, p.value)
    number = lambda x: "" if x is None else f"{x:z.{places}f}"  # noqa: E731
    if p.upper95 is not None:
        shown = [f"< {number(p.upper95)}", number(p.median), number(p.std), "upper limit"]
        return [p.name, *shown, p.unit]
    mark = "" if p.significant else doubt(p.value, p.low95, p.high95, p.reason)
    span = f"{number(p.low95)} … {number(p.high95)}"
    return [p.name, number(p.value) + mark, number(p.median), number(p.std), span, p.unit]


def gap_draws(posterior: Posterior) -> "GapDraws":
    """Return draws of the backlash map of a posterior.

    **Raises** `NoAnswerError` if one flank was not measured or the constant backlash is
    undetermined.
    """
    require_x64("gap_draws")
    fit = posterior.fit
    gap = fit.parameters["constant_backlash_deg"]
    if len(fit.flanks) < 2:
        raise NoAnswerError(
            f"only flank {''.join(fit.flanks)} was measured, and draws of one flank do not"
            " determine the gap; record both directions.",
            where=fit.source,
        )
    if not gap.determined:
        raise NoAnswerError(
            f"the constant backlash is undetermined ({gap.reason}); record more turns.",
            where=fit.source,
        )
    draws = flank_draws(posterior)
    if posterior.gap_of_delay is None:
        return draws
    return replace(draws, of_delay=posterior.gap_of_delay[posterior.chosen])


def flank_draws(posterior: Posterior) -> "GapDraws":
    """Return drawn coefficients of both flanks, rad; those of an unmeasured flank are NaN."""
    fit = posterior.fit
    return GapDraws(
        pair=fit.pair,
        terms=tuple(fit.model.terms),
        offset=posterior.offset,
        cosine=posterior.cosine,
        sine=posterior.sine,
        batch=batches(posterior.chosen, posterior.draws.shape[:3]),
    )
