"""The posterior of a fit: draws of its coordinates, and of the flank model they imply."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..base.errors import NoAnswerError
from ..base.partial import filter_of
from ..identify.result import Fit
from .draws import PosteriorParameter, Share, SmallestGap, border, parameters_of_draws

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
        from .gap_draws import gap_draws

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
        from .arviz_bridge import to_arviz

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
        from .posterior_text import posterior_text

        return posterior_text(self)
