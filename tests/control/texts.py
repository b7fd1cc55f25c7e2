"""Scenarios to start from, and how a bad one is refused.

They are the contract's example word for word, and the shortest.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from vttig_jax.base.errors import ScenarioError
from vttig_jax.control.scenario.spec import parse_scenario_spec

CONTRACT = """
pair = "pair.toml"                 # relative to this file
plant = "rigid"                    # play | rigid | elastic
controller = "acceleration"        # none | acceleration | predictive
[eccentricities]
driving_mm = 0.0226
driving_phase_deg = 49.5
driven_mm = 0.0273
driven_phase_deg = 79.3
constant_backlash_deg = 0.038
[motion]
speed_rpm = 60.0
reversal_deg = 7560.0
dwell_s = 2.0
ramp_s = 0.5
[sampling]
controller_hz = 1000
"""
RIG = {
    "driving_mm": 0.0226,
    "driving_phase_deg": 49.5,
    "driven_mm": 0.0273,
    "driven_phase_deg": 79.3,
    "constant_backlash_deg": 0.038,
}
MINIMAL = {"pair": "pair.toml", "eccentricities": RIG}


def scenario(**tables):
    """The shortest scenario with other tables."""
    return parse_scenario_spec({**MINIMAL, **tables})


def put(table, name, value):
    """A copy with one key changed; None takes it out."""
    above, _, last = name.rpartition(".")
    inner = {**(table.get(above, {}) if above else table), last: value}
    inner = {key: value for key, value in inner.items() if value is not None}
    return {**table, above: inner} if above else inner


@contextmanager
def refused(where: str, words: str) -> Iterator[None]:
    """Expect one sentence with these words, which names a key and perhaps its file."""
    with pytest.raises(ScenarioError) as caught:
        yield
    assert caught.value.where == where
    assert words in caught.value.message and "\n" not in str(caught.value)
    assert caught.value.exit_code == 3
