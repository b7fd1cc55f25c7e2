"""Passes over the logs, repeated until the parameters of a given flank model settle.

Every pass linearises the model at the present values of its parameters. The derivatives are columns
of the block rows like delay, drift and regressors. Their coefficients, estimated with the noise
model of the pass, are the Gauss–Newton steps of the parameters.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError, UsageError
from ..base.units import REV
from ..logs.encoder_log import EncoderLog
from ..logs.motion.segments import Segments
from ..pair.gear_pair import Drive, GearPair
from .build_result import solve_model
from .given_search import searched
from .model.given_model import GivenModel
from .model.identifiability import Identifiability
from .preliminary.linear_fit import Input
from .preliminary.model_selection import (
    SelectedModel,
    have_one_zero,
    plain_fit,
    select_model,
)
from .settings import FitSettings
from .solve.least_squares import Solution

_MOST_PASSES = 12  # passes after the search; two are enough near the optimum; chosen value
_SETTLED = 0.01
"""Largest step of the last pass in standard errors (chosen). The solution contains this step, so
its remaining error comes only from the curvature of the model over the step."""

_DIGITS = 1e-9  # step of a parameter, relative to it, that counts as rounding; chosen value


_OF_RELATION = ("perfect_encoders", "perfect_gears")
"""Settings that apply only to a fit of the exact relation."""


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
    ends = [
        np.sort(log.driving_angle[[s.start, s.stop - 1]])
        for log, own in zip(logs, found, strict=True)
        for s in own.segments
    ]
    first, last = max(ends, key=lambda pair: float(pair[1] - pair[0]), default=(0.0, REV))
    return GivenModel.of(model).resolved(float(first), float(last - first) / REV)


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
        after = given.updated(solution.names, solution.values)
        moved = _moved(solution, after, given)
        if moved.max() <= _SETTLED:
            return selected
        if passes == _MOST_PASSES:
            break
        given = after
    worst = given.names[int(np.argmax(moved))]
    raise NoAnswerError(
        f"the flank model {given.name} does not settle: {worst} still moves by"
        f" {moved.max():.3g} standard errors in pass {passes}; start it from other values, or give"
        " it fewer parameters.",
        where=", ".join(one.log.source for one in inputs),
    )


def _moved(solution: Solution, after: GivenModel, before: GivenModel) -> Float[np.ndarray, " p"]:
    """Return the step of every parameter in its standard errors, 0 for undetermined parameters."""
    moved = np.zeros(len(after.names))
    std = dict(zip(solution.names, np.sqrt(np.diag(solution.covariance)), strict=True))
    open_ones = {n for n, good in zip(solution.names, solution.determined, strict=True) if not good}
    for place, name in enumerate(after.names):
        step = abs(float(after.values[place] - before.values[place]))
        size = std.get(name, 0.0) + _DIGITS / _SETTLED * abs(float(after.values[place]))
        if step > 0 and name not in open_ones:
            moved[place] = step / size
    return moved
