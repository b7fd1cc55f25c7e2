"""Whether logs need a component: the likelihood ratio of a fit with it and a fit without it."""

from dataclasses import replace

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
    member, on = np.array(logs.member), np.array(logs.on)
    own = member[:, place] > 0
    left = float(np.sum(np.log(member[own, place]))) - own.sum() * np.log(_HELD)
    member[:, place], on[place] = 0.0, 0.0
    return replace(
        logs,
        on=on,
        precision=np.where(own, _HELD, logs.precision),
        member=member,
        constant=np.asarray(logs.constant + left),
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
    return max(0.0, float(found.aux.likelihood) - float(posterior.at.likelihood))
