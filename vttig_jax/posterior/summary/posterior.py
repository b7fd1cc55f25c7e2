"""Posterior of a fit: its draws, its report, and its export to arviz."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from textwrap import fill
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.errors import NoAnswerError, UsageError
from ...base.facade import from_front_door
from ...base.files.text_tables import decimals, key_values, listed, text_table
from ...base.results import PlottedResult
from ...base.runtime import require_x64
from ...base.units import ARCSEC, duration_text
from ...identify.backlash import unknown_extremes
from ...identify.result import Fit, conditions, parameter_cells, refuse_unknown_gap
from ...kinematics.harmonic import OrderModel
from ...model.columns import FLAT, KNOWN, ROUNDING, Column
from ...model.parameter import open_reasons
from ...model.rows import SHAFTS
from ...pair.gear_pair import Eccentricities
from ..chains import Chains
from ..convergence import Diagnosis
from .draws import (
    PosteriorParameter,
    Share,
    SmallestGap,
    batches,
    parameters_of_draws,
    reported_name,
    shown_unit,
)
from .gap_draws import GapDraws

_WIDTH = 100
"""Characters in a line of the sentence above the report."""


@dataclass(frozen=True, repr=False)
class Posterior(PlottedResult):
    """Draws from the posterior of a fit.

    **Arguments**
    - `fit`: fit of the log.
    - `names`, `units`: quantities of the fit in internal units (mm, rad, s), then the coordinates
      of emcee: noise and widths of the priors.
    - `draws`: draws after burn-in, shape (ensembles, steps, walkers, d). The quantities are one
      draw from their exact distribution given the coordinates.
    - `offset`, `cosine`, `sine`: the m draws of the order-complete flank model, rad, shapes (m, 2),
      (m, 2, terms), (m, 2, terms), with the terms of `fit.model`, in the order of `flat`.
    - `chains`: the chains of emcee, burn-in included, and their diagnosis.
    """

    fit: Fit
    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: Float[np.ndarray, "ensembles steps walkers d"]
    offset: Float[np.ndarray, "m 2"]
    cosine: Float[np.ndarray, "m 2 terms"]
    sine: Float[np.ndarray, "m 2 terms"]
    chains: Chains

    @property
    def diagnosis(self) -> Diagnosis:
        """Convergence of the sampler."""
        return self.chains.diagnosis

    @property
    def seed(self) -> int:
        """Seed of the sampler."""
        return self.chains.header.seed

    @property
    def flat(self) -> Float[np.ndarray, "n d"]:
        """All draws as rows: ensemble by ensemble, step by step, walker by walker."""
        return self.draws.reshape(-1, self.draws.shape[-1])

    @property
    def physical(self) -> tuple[str, ...]:
        """Names of the quantities that the fit determines."""
        reported = {name: reported_name(self.fit, name) for name in self.names}
        parameters = self.fit.parameters
        return tuple(name for name, by in reported.items() if by and parameters[by].determined)

    @cached_property
    def parameters(self) -> dict[str, PosteriorParameter]:
        """Parameters of the fit by name, with median and equal-tailed interval."""
        return parameters_of_draws(self.fit, self.names, self.flat)

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

    @property
    def correlation(self) -> Float[np.ndarray, "p p"]:
        """Correlation of the quantities, in the order of `physical`."""
        columns = self.flat[:, [self.names.index(name) for name in self.physical]]
        return np.atleast_2d(np.corrcoef(columns.T)) if columns.size else np.empty((0, 0))

    def eccentricities(self) -> Eccentricities:
        """Return the rig of the posterior mean; an undetermined eccentricity counts as zero."""
        means = np.array([self.values(name).mean() for name in self.fit.covariance_names])
        gap = self.parameters["constant_backlash_deg"].value or 0.0
        return replace(self.fit, values=means).eccentricities(gap)

    def model(self, draw: Any = slice(None)) -> OrderModel:
        """Return the flank model of a draw, or those of several, stacked along a first axis."""
        parts = [jnp.asarray(part[draw]) for part in (self.offset, self.cosine, self.sine)]
        ratio = jnp.full(parts[0].shape[:-1], float(self.fit.pair.ratio))
        terms = self.fit.model.terms

        def one(ratio, offset, cosine, sine):
            return OrderModel(ratio, terms, offset, cosine, sine)

        return (jax.vmap(one) if ratio.ndim else one)(ratio, *parts)

    @cached_property
    def smallest_gap(self) -> SmallestGap:
        """Distribution of the smallest gap over the hunting period and of the safe closing.

        **Raises** `NoAnswerError` if the gap is not known, or only that over the angles covered.
        """
        draws = gap_draws(self)
        if reason := unknown_extremes(self.fit):
            raise NoAnswerError(f"the smallest gap is {reason}.", where=self.fit.source)
        return draws.smallest

    def probability_of_binding(self, closing_mm: float) -> Share:
        """Return the share of draws in which an axial closing, mm, binds, with standard error."""
        return self.smallest_gap.probability_of_binding(closing_mm)

    def save(self, folder: str | Path, *, overwrite: bool = False, figures: bool = True) -> None:
        """Write draws, report, map and pictures; see `vttig_jax.runs.save_posterior`."""
        from_front_door("save_posterior")(self, folder, overwrite=overwrite, figures=figures)

    def to_arviz(self) -> Any:
        """Return the draws for arviz: `InferenceData` before arviz 1, a `DataTree` from then on."""
        run = {"source": self.fit.source, "seed": np.int64(self.seed)}
        run["converged"] = str(bool(self.diagnosis.converged))
        return arviz_data(self.names, self.units, self.draws, **run)

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
            "prior": list(priors(self.fit)),
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

    __repr__ = __str__


_BESIDE_FIT = (
    "The intervals are those of draws over all noise and all widths. A fit takes both along lines"
    " through their most probable values only, so that its intervals may be narrower where the log"
    " hardly tells a width."
)


def _called(column: Column, given: str) -> str:
    """Return what people call a column; `given` is what they call those of an own model."""
    if column.prior == ROUNDING:
        return ROUNDING
    called = {"both": "orders 1 ± i of both shafts together", "given": given, "offset": ROUNDING}
    called |= {"mesh": "orders of the mesh", "line": "lines", "start": "start angles"}
    called["one"] = "gap" if column.differs else "offset"
    kind, order, _ = column.row
    return f"{kind} order {order}" if kind in SHAFTS else called.get(kind, kind)


def priors(fit: Fit) -> tuple[str, ...]:
    """Return sentences on what the fit, and so the draws, assume before the logs are read."""
    columns = fit.core.posterior.problem.columns
    given = "frequencies of lines" if fit.given is None else "your flank model"
    known = {_called(c, given): c.width for c in columns if c.prior in (KNOWN, ROUNDING)}
    flat = {_called(c, given) for c in columns if c.prior == FLAT}
    found = [f"flat: {', '.join(sorted(flat))}"]
    if "delay" in known:
        found.append(f"delay: zero ± {duration_text(known.pop('delay'))}")
    if "ratio" in known:
        share = known.pop("ratio") / abs(float(fit.pair.ratio))
        found.append(f"ratio: as given ± {share:.2g} of it")
    for width in sorted({*known.values()}, reverse=True):
        names = ", ".join(sorted(name for name, own in known.items() if own == width))
        found.append(f"{names}, each coefficient: zero ± {width / ARCSEC:.3g}″")
    found.append(
        "further orders of each shaft, their difference between the flanks, drift, a delay that"
        " moves, a gap that depends on speed: zero ± a width of each group, which is sampled and"
        " has a half-Cauchy prior"
    )
    return tuple(found)


def posterior_text(posterior: Posterior) -> str:
    """Return the report: parameters, smallest gap, priors and convergence."""
    ensembles, steps, walkers = posterior.draws.shape[:3]
    kept = f"{steps} kept of {posterior.diagnosis.steps} steps"
    counted = f"{ensembles} ensembles × {walkers} walkers × {kept}"
    drawn = [("log", posterior.fit.source), ("draws", f"{counted}, seed {posterior.seed}")]
    title = f"posterior of {posterior.fit.pair.name or 'fit'}"
    head = key_values([*drawn, *_gap(posterior)], title=title)
    parameters = list(posterior.parameters.values())
    rows = [_row(p) for p in parameters if p.determined]
    table = text_table(
        rows, ["parameter", "mean", "median", "std", "95 % interval", "unit"], align="lrrrrr"
    )
    warning = posterior.diagnosis.warning
    parts = [fill(f"{warning}.", _WIDTH), head, table] if warning else [head, table]
    parts += listed("undetermined", open_reasons(parameters))
    parts += listed("priors", list(priors(posterior.fit)))
    parts.append(fill(_BESIDE_FIT, _WIDTH))
    parts += conditions(posterior.fit.conditional_on)
    parts.append(str(posterior.diagnosis))
    return "\n\n".join(parts)


def _gap(posterior: Posterior) -> list[tuple[str, str]]:
    try:
        return posterior.smallest_gap.rows()
    except NoAnswerError as error:
        return [("smallest gap", unknown_extremes(posterior.fit) or f"not known: {error.message}")]


def _row(parameter: PosteriorParameter) -> list[str]:
    name, value, std, _, span, unit = parameter_cells(parameter)
    places = decimals(parameter.std or 0.0, parameter.value or 0.0)
    median = "" if parameter.median is None else f"{parameter.median:z.{places}f}"
    return [name, value, median, std, span, unit]


def gap_draws(posterior: Posterior) -> "GapDraws":
    """Return draws of the backlash map of a posterior.

    **Raises** `NoAnswerError` if one flank was not measured or the gap is not known anywhere.
    """
    require_x64("gap_draws")
    fit = posterior.fit
    if len(fit.flanks) < 2:
        raise NoAnswerError(
            f"only flank {''.join(fit.flanks)} was measured, and draws of one flank do not"
            " determine the gap; record both directions.",
            where=fit.source,
        )
    refuse_unknown_gap(fit)
    return flank_draws(posterior)


def flank_draws(posterior: Posterior) -> "GapDraws":
    """Return drawn coefficients of both flanks, rad.

    **Raises** `NoAnswerError` for a flank model of the user, which a map of orders does not hold.
    """
    fit, parts = posterior.fit, (posterior.offset, posterior.cosine, posterior.sine)
    if fit.given is not None:
        raise NoAnswerError(
            "draws of a flank model of your own have no map; take its parameters from"
            " `Posterior.draws`.",
            where=fit.source,
        )
    return GapDraws(fit.pair, tuple(fit.model.terms), *parts, batches(posterior.draws.shape[:3]))


def arviz_data(
    names: Sequence[str],
    units: Sequence[str],
    draws: Float[np.ndarray, "ensembles steps walkers d"],
    **attributes: object,
) -> Any:
    """Return the draws as an `InferenceData` before arviz 1, as an xarray `DataTree` from then on.

    A chain of arviz is an ensemble. It holds all steps of the first walker in the order of time,
    then those of the second walker, and so on: the draw of a walker at a step has the index
    `walker` · `steps` + `step`, and `attrs` hold the numbers of walkers and steps.

    With this order arviz estimates the effective draws as the diagnosis of the posterior does: the
    autocorrelation of the chain is the mean of those of its walkers about the mean of the ensemble.
    At a lag of t steps only t of `steps` products join two walkers, and these are uncorrelated,
    because in the stationary state the walkers are independent at equal times. If the draws were
    ordered step by step, neighbouring draws would belong to different walkers, and the number of
    effective draws would be too large by the factor τ. If every walker were a chain, the number
    would be right, but R-hat would be large for such short chains, and the walkers of an ensemble
    are not independent of each other, while ensembles are.

    Variables are the coordinates `names` in their `units`, which their `attrs` name; `attributes`
    join the `attrs` of all. arviz 1 shows 89 %
    intervals by default: pass `ci_prob=0.95` (before arviz 1: `hdi_prob`).

    **Raises** `UsageError` if arviz is not installed.
    """
    try:
        arviz: Any = importlib.import_module("arviz")
    except ImportError:
        raise UsageError(
            "the export to arviz needs the package arviz: pip install `vttig-jax[arviz]`."
        ) from None
    _, steps, walkers, _ = draws.shape
    groups = {
        # one row per ensemble: all steps of its first walker, then of its second, and so on
        "posterior": {
            name: draws[..., k].swapaxes(1, 2).reshape(len(draws), -1)
            for k, name in enumerate(names)
        },
    }
    # Before arviz 1 the groups are keyword arguments, from then on one nested mapping.
    nested = int(arviz.__version__.partition(".")[0]) >= 1
    data = arviz.from_dict(groups) if nested else arviz.from_dict(**groups)
    for name, unit in zip(names, units, strict=True):
        data["posterior"][name].attrs["units"] = unit
    data["posterior"].attrs.update(
        {**attributes, "walkers": np.int64(walkers), "steps": np.int64(steps)}
    )
    return data
