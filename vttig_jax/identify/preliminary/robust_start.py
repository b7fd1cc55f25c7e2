"""Second start of the robust weights, from a fit without drift.

The bisquare loss has several optima. If a log has one run in each direction, drift and gap resemble
each other, and the weights that follow from a model with both may end at a drift that gives the
samples of one direction no weight. A model without drift has fewer coefficients, so a fit with
drift must not leave larger residuals.
"""

from dataclasses import replace

from ..compress.regressors import Drift
from .linear_fit import LinearFit, linear_fit
from .robust import Reweighted, reweighted

_MORE = 1.05
"""A fit with drift is started again if its robust scale exceeds that without drift by more than
this factor (chosen)."""


def with_second_start(weights: Reweighted, plain: LinearFit) -> Reweighted:
    """Return the weights, or those from a second start if a fit without drift has less residual.

    `weights` are those of `plain`, whose model has the widest drift.
    """
    if weights.loss != "bisquare" or plain.model.drift == Drift(0):
        return weights
    simple = reweighted(
        linear_fit(
            plain.inputs,
            replace(plain.model, drift=Drift(0)),
            plain.channels[0].delay_s,
            block_s=plain.block_s,
        ),
        weights.loss,
    )
    if _scale_deg(weights) <= _MORE * _scale_deg(simple):
        return weights
    again = reweighted(plain, weights.loss, simple.values)
    return min(again, weights, key=_scale_deg)


def _scale_deg(weights: Reweighted) -> float:
    """Return the largest robust scale of the residuals of a log, deg."""
    return max(one.scale_deg for one in weights.outliers)
