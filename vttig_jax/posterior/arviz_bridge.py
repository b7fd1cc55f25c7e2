"""The draws for arviz, whichever of its two data models is installed."""

import importlib
from typing import Any

import numpy as np

from ..base.errors import UsageError
from .posterior import Posterior


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
