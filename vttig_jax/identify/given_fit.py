"""Passes over the logs until the parameters of a given flank model stand still.

Every pass makes the model linear at its parameters. Its derivatives are columns beside delay, drift
and regressors, and their coefficients under the noise of the pass are Gauss–Newton steps.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base.errors import NoAnswerError, UsageError
from ..base.units import REV
from ..logs.encoder_log import EncoderLog
from ..logs.motion.segments import Segments
from ..pair.gear_pair import Drive, GearPair
from .build_result import solve_model
from .model.given_model import GivenModel
from .model.identifiability import Identifiability
from .preliminary.given_search import searched
from .preliminary.linear_fit import Input
from .preliminary.model_selection import (
    SelectedModel,
    have_one_zero,
    plain_fit,
    select_model,
)
from .settings import FitSettings

_MOST_PASSES = 12  # passes after the search; two are enough near the optimum; chosen value
_SETTLED = 0.01
"""Largest step of the last pass in standard errors. The solution contains this step, so that its
error is that of the curvature of the model over the step (chosen)."""

_DIGITS = 1e-9  # step of a parameter, relative to it, that counts as rounding; chosen value


_OF_RELATION = ("perfect_encoders", "perfect_gears")
"""Settings that only the exact relation knows."""


def prepared_model(
    model: Any, logs: Sequence[EncoderLog], settings: FitSettings, found: Sequence[Segments]
) -> GivenModel:
    """Return the flank model of the user, ready to be fitted.

    **Raises** `UsageError` for an object that is no flank model, for settings of the exact relation
    and for logs without a common zero, whose angles have no common place in the model.
    """
    for name in _OF_RELATION:
        if getattr(settings, name):
            raise UsageError(
                f"{name} says what the exact relation contains, which `model` replaces; leave it"
                " out.",
                where="model",
            )
    if len(logs) > 1 and not have_one_zero(logs, settings):
        raise UsageError(
            "several logs with zeros of their own have no common angle at which to evaluate"
            " `model`; fit them one by one, or say same_zero=True if both encoders count whole"
            " turns from one zero in all of them.",
            where=", ".join(log.source for log in logs),
        )
    angles = [
        log.driving_angle[s.start : s.stop]
        for log, own in zip(logs, found, strict=True)
        for s in own.segments
    ]
    turns = max((float(np.ptp(angle)) / REV for angle in angles), default=1.0)
    return GivenModel.of(model).resolved(turns)


def select_given(
    inputs: tuple[Input, ...],
    pair: GearPair | Drive,
    identifiable: Identifiability,
    settings: FitSettings,
    given: GivenModel,
) -> SelectedModel:
    """Return the selected model of the last pass with a given flank model.

    **Raises** `NoAnswerError` if the parameters do not settle, or where the model is not finite.
    """
    given = searched(plain_fit(inputs, pair, identifiable, settings, given)[0])
    passes = 0
    while True:
        selected = select_model(inputs, pair, identifiable, settings, given)
        solution, passes = solve_model(selected, pair, identifiable, settings).solution, passes + 1
        places = [solution.names.index(name) for name in given.names]
        values, determined = solution.values[places], solution.determined[places]
        size = np.sqrt(np.diag(solution.covariance)[places]) + _DIGITS * np.abs(values) / _SETTLED
        step = np.where(determined, np.abs(values - given.values), 0.0)
        moved = np.divide(step, size, out=np.zeros_like(step), where=size > 0)
        if moved.max() <= _SETTLED:
            return selected
        if passes == _MOST_PASSES:
            break
        given = given.at(values)
    worst = given.names[int(np.argmax(moved))]
    raise NoAnswerError(
        f"the flank model {given.name} does not settle: {worst} still moves by"
        f" {moved.max():.3g} standard errors in pass {passes}; start it from other values, or give"
        " it fewer parameters.",
        where=", ".join(one.log.source for one in inputs),
    )
