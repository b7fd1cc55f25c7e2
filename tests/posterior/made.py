"""Posteriors made from a fit and its covariance: what a perfect sampler would hand over."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from tests.identify.quick import quick_rig
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.posterior.summary.posterior import Posterior

PARTIALS = (0.43, -0.067)


@dataclass(frozen=True)
class Diagnosis:
    """Stands in for the diagnosis of a sampler."""

    converged: bool = True

    @property
    def warning(self) -> str:
        return "" if self.converged else "not converged: sample on"

    def to_json(self) -> dict:
        return {"converged": self.converged, "r_hat": 1.001}

    def __str__(self) -> str:
        return "converged: R-hat 1.001" if self.converged else "NOT converged: R-hat 1.4"


@cache
def quick_fit(seed: int = 0, **motion) -> Fit:
    rig = quick_rig(seed, **motion)
    return fit(rig.log(seed), rig.pair)


def unit_of(name: str, drive: bool = False) -> str:
    if name == "delay":
        return "s"
    gear = name in {f"{shaft}_{axis}" for shaft in ("driving", "driven") for axis in "xy"}
    return "mm" if gear and not drive else "rad"


def made_posterior(
    result: Fit,
    *,
    ensembles: int = 4,
    steps: int = 60,
    walkers: int = 20,
    chosen: int = 1000,
    seed: int = 0,
    converged: bool = True,
    orders_arcsec: float = 0.3,
    **fields,
) -> Posterior:
    """Gaussian draws around the fit; coefficients of each order scatter by `orders_arcsec`.

    The first orders and the offsets follow the draws, as the sampler's do, to first order.
    """
    generator = np.random.default_rng(seed)
    names = tuple(name for name in result.covariance_names if not name.startswith("offset"))
    places = [result.covariance_names.index(name) for name in names]
    shape = (ensembles, steps, walkers)
    draws = generator.multivariate_normal(
        result.values[places], result.covariance[np.ix_(places, places)], shape
    )
    noise = np.stack(
        [
            np.log(result.noise.innovation_std) + 0.02 * generator.standard_normal(shape),
            *(p + 0.02 * generator.standard_normal(shape) for p in PARTIALS),
        ],
        axis=-1,
    )
    noise_names = ("log_innovation_std", "partial_1", "partial_2")
    count = ensembles * steps * walkers
    picked = np.sort(generator.choice(count, min(chosen, count), replace=False))
    offset, cosine, sine = coefficient_draws(result, names, draws, picked, orders_arcsec, generator)
    drive = not hasattr(result.pair, "driving") or "driving_amplitude_arcsec" in result.parameters
    settings = {
        "fit": result,
        "names": (*names, *noise_names),
        "units": (*(unit_of(name, drive) for name in names), "log rad", "1", "1"),
        "draws": np.concatenate([draws, noise], axis=-1),
        "log_density": -0.5 * np.sum(generator.standard_normal((*shape, len(names))) ** 2, axis=-1),
        "offset": offset,
        "cosine": cosine,
        "sine": sine,
        "chosen": picked,
        "diagnosis": Diagnosis(converged),
        "prior": ("flat in the Cartesian coordinates.",),
        "seed": seed,
    }
    return Posterior(**(settings | fields))


def coefficient_draws(
    result: Fit,
    names: tuple[str, ...],
    draws: Float[np.ndarray, "e s w p"],
    picked: np.ndarray,
    orders_arcsec: float,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flank models around the fitted one; the gap follows the constant backlash of each draw."""
    flat = draws.reshape(-1, draws.shape[-1])[picked]
    model, size = result.model, np.radians(orders_arcsec / 3600)
    scatter = lambda part: (  # noqa: E731
        np.asarray(part) + size * generator.standard_normal((len(picked), *part.shape))
    )
    offset = np.repeat(np.asarray(model.offset)[None], len(picked), axis=0)
    if "constant_backlash" in names:
        place = names.index("constant_backlash")
        offset[:, 1] += flat[:, place] - flat[:, place].mean()
    offset += 0.2 * size * generator.standard_normal((len(picked), 1))
    return offset, scatter(model.cosine), scatter(model.sine)
