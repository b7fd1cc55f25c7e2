"""Whether logs need a component: the likelihood ratio of a fit with it and a fit without it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .columns import GROUPS
from .density import Compressed
from .mixed_fit import MixedFit
from .newton import maximise

NEEDED = 12.0
"""2 ln of the likelihood ratio above which a component is reported: one in some thousand logs that
do not have it."""

_HELD = 1e12


def without(logs: Compressed, group: str) -> Compressed:
    """Return the logs with the coefficients of a group of columns held at zero."""
    place = GROUPS.index(group)
    member = np.asarray(logs.member)
    own = member[:, place] > 0
    left = float(np.sum(np.log(member[own, place]))) - own.sum() * np.log(_HELD)
    return eqx.tree_at(
        lambda c: (c.on, c.precision, c.member, c.constant),
        logs,
        (
            jnp.asarray(logs.on).at[place].set(0.0),
            jnp.where(own, _HELD, logs.precision),
            jnp.asarray(logs.member).at[:, place].set(0.0),
            logs.constant + left,
        ),
    )


def likelihood_ratio(fit: MixedFit, group: str) -> float:
    """Return 2 ln of the restricted likelihood with a group of columns over that without it.

    All other prior widths and the noise are maximised again. It is 0 for a group that the fit does
    not have.
    """
    logs, posterior = fit.posterior.problem.compressed, fit.posterior
    if not logs.on[GROUPS.index(group)]:
        return 0.0
    found = maximise(without(logs, group), posterior.theta)
    return max(0.0, float(found.aux.likelihood - posterior.at.likelihood))
