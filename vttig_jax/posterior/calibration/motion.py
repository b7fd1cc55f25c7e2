"""The motion all rigs of a scenario share: steady, with a little ripple, forward and back."""

import numpy as np
from jaxtyping import Float

from ...base.units import REV
from ...identify.blocks import block_size
from .layout import planned
from .scenarios import Scenario

_RIPPLE, _RIPPLE_ORDER = 0.001, 6


def driving_angles(scenario: Scenario) -> Float[np.ndarray, "flanks n"]:
    """True driving angle on the way there (flank A) and on the way back (flank B), rad."""
    time = np.arange(scenario.samples) / scenario.rate_hz
    there = REV * scenario.speed_rpm / 60.0 * time
    passes = {"A": there, "B": REV * scenario.turns - there}
    angle = np.stack([passes[flank] for flank in scenario.flanks])
    return angle + _RIPPLE / _RIPPLE_ORDER * np.sin(_RIPPLE_ORDER * angle)


def row_size(scenario: Scenario) -> int:
    """Samples a row, as the fit chooses them for this motion."""
    terms = planned(scenario)
    highest = float(max(terms.frequency(term) for term in terms.terms))
    steps = np.abs(np.diff(driving_angles(scenario)[0]))
    return block_size(REV / float(steps.max()), highest)
