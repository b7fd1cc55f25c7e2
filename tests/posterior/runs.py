"""Short runs of the sampler on a checkpoint, and what is asked of every one."""

from pathlib import Path
from typing import Any

import numpy as np

from tests.posterior.densities import Gaussian, plain
from vttig_jax.posterior.chains import Chains, run_ensembles


def sample(path: Path | None, target: Gaussian | None = None, **options: Any) -> Chains:
    settings: dict[str, Any] = {"steps": 100, "walkers": 16} | options
    return run_ensembles(target or plain(), checkpoint=path, **settings)


def same(one: Chains, other: Chains) -> bool:
    return one.header == other.header and all(
        np.array_equal(getattr(one.record, name), getattr(other.record, name))
        for name in ("draws", "log_density", "accepted")
    )


def sentence(error: BaseException) -> str:
    text = str(error)
    assert "\n" not in text and text.endswith(".")
    return text


def only(path: Path) -> bool:
    """No lock and no temporary file is left."""
    return [item.name for item in path.parent.iterdir()] == [path.name]
