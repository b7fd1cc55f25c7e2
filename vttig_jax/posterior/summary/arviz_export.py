"""Export of posterior draws to arviz."""

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import UsageError


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
