"""The scenario file: the contract's example word for word, every key, other values."""

import tomllib
from typing import Any, Literal, get_args, get_origin

import msgspec
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from tests.control.texts import CONTRACT, MINIMAL, RIG, put, refused, scenario
from vttig_jax.base.errors import ScenarioError
from vttig_jax.control.scenario.scenario import (
    EccentricityTable,
    MotionTable,
    RigTable,
    SamplingTable,
)
from vttig_jax.control.scenario.spec import (
    KEYS,
    load_scenario_spec,
    parse_scenario_spec,
    spec_table,
    with_values,
)

pytestmark = pytest.mark.smoke


def test_the_contracts_example(write):
    spec = load_scenario_spec(write(CONTRACT))
    assert (spec.pair, spec.plant, spec.controller) == ("pair.toml", "rigid", "acceleration")
    assert spec.eccentricities == EccentricityTable(**RIG)
    assert spec.motion == MotionTable() and spec.sampling == SamplingTable()
    assert spec == scenario()  # what the contract writes are the defaults
    assert spec.rig is None and spec.sweep is None


DEFAULTS = """
plant_map = "eccentricities"
controller_gap = "mean"
plant = "rigid"
controller = "acceleration"
flanks = "exact"
seed = 0
map = {}
motion = { kind = "trapezoid", event = "reversal", speed_rpm = 60.0, reversal_deg = 7560.0, dwell_s = 2.0, ramp_s = 0.5, slow_share = 0.3, stop_s = 0.05, file = "" }
servo = { motor = "prescribed", speed_gain_Nms = 1.0, integral_gain_Nm = 20.0, position_gain_1_s = 20.0, torque_limit_Nm = 5.0 }
inertia = { driven_kgm2 = 0.01, driving_kgm2 = 0.002 }
friction = { coulomb_Nm = 0.1, viscous_Nms = 0.0, stribeck_Nm = 0.0, stribeck_rad_s = 0.1, driving_Nm = 0.05 }
load = { torque_Nm = 0.0 }
mesh = { restitution = 0.3, stiffness_N_mm_um = 20.0, damping_ratio = 0.1, friction_coefficient = 0.0 }
driving_encoder = { amplitude_arcsec = 0.0, phase_deg = 0.0, noise_arcsec = 0.0 }
driven_encoder = { amplitude_arcsec = 0.0, phase_deg = 0.0, noise_arcsec = 0.0 }
actuator = { speed_mm_s = 20.0, acceleration_mm_s2 = 2000.0, resolution_mm = 0.0, delay_s = 0.0, stroke_mm = 10.0, force_limit_N = 0.0 }
judgement = { turn = "known", observer = "alpha_beta_gamma", bandwidth_hz = 20.0, threshold_rad_s2 = 1.0, least_rpm = 3.0, horizon_s = 0.3, margin_mm = 0.01, jump_s = 0.005 }
sampling = { controller_hz = 1000.0, plant_hz = 0.0 }
"""  # noqa: E501


def test_the_keys_and_defaults_are_those_agreed_on():
    """Written out again here, so that a change of a default is a change of this file too."""
    assert spec_table(scenario()) == MINIMAL | tomllib.loads(DEFAULTS)


def test_every_number_is_bounded_and_every_key_explained():
    assert len(KEYS) >= 50
    for one in KEYS.values():
        assert one.meaning, one.name
        numbers = {int, float} & set(one.types)
        assert bool(one.unit) == bool(numbers), one.name
        for bad in (float("inf"), -float("inf"), float("nan")) if float in numbers else ():
            with pytest.raises(ScenarioError, match=f"^{one.name}: expected a number"):
                with_values(scenario(), {one.name: bad})


def test_other_values_make_another_case():
    spec = parse_scenario_spec({**MINIMAL, "sweep": {"seed": [1, 2]}})
    case = with_values(spec, {"motion.reversal_deg": 720.0, "controller": "none"})
    changed = put(put(MINIMAL, "motion.reversal_deg", 720.0), "controller", "none")
    assert case == parse_scenario_spec(changed)
    assert case.sweep is None and spec.controller == "acceleration"


def test_eccentricities_take_the_place_of_draws():
    spec = parse_scenario_spec({"pair": "p", "rig": {"from": "RUN", "draws": 3}})
    assert spec.rig == RigTable(run="RUN", draws=3)
    assert with_values(spec, {"seed": 3}).rig == spec.rig
    case = with_values(spec, {f"eccentricities.{name}": value for name, value in RIG.items()})
    assert case.rig is None and case.eccentricities == EccentricityTable(**RIG)
    with pytest.raises(ScenarioError, match="missing required field driving_phase_deg"):
        with_values(spec, {"eccentricities.driving_mm": 0.1})


@pytest.mark.parametrize(
    ("values", "where", "words"),
    [
        ({"motion.reversal_deg": 9.0}, "motion.reversal_deg", "inside the ramps"),
        ({"motion.speed": 9.0}, "motion.speed", "did you mean `motion.speed_rpm`?"),
        ({"noise_arcsec": 1.0}, "noise_arcsec", "or `driven_encoder.noise_arcsec`?"),
        ({"motion": {}}, "motion", "is no key of a scenario"),
        ({"rig.draws": 2}, "rig.draws", "`vttig simulate --print-defaults` lists them."),
        ({"motion.speed_rpm": "9"}, "motion.speed_rpm", "expected a number"),
    ],
)
def test_other_values_are_validated(values, where, words):
    with refused(where, words):
        with_values(scenario(), values)


def values_of(one):
    """Values a key may have, from its bounds as `msgspec` tells them."""
    kinds = [kind for kind in one.types if kind is not type(None)]
    if get_origin(kinds[0]) is Literal:
        return st.sampled_from(get_args(kinds[0]))
    if kinds[0] is str:
        return st.text(min_size=1, max_size=5)
    told: Any = msgspec.inspect.type_info(one.kind)
    while not hasattr(told, "ge"):
        told = told.type if hasattr(told, "type") else told.types[0]
    low = told.gt if told.ge is None else told.ge
    high = told.lt if told.le is None else told.le
    if kinds[0] is int:
        return st.integers(low, high)
    return st.floats(low, high, exclude_min=told.ge is None, exclude_max=told.le is None)


FREE = [
    name
    for name in KEYS
    if name.partition(".")[0]
    not in ("motion", "sampling", "constant_backlash_deg", "controller_gap")
    or name == "motion.stop_s"
]


@given(st.fixed_dictionaries({}, optional={name: values_of(KEYS[name]) for name in FREE}))
def test_any_values_within_bounds_come_back(values):
    case = with_values(scenario(), values)
    table = tomllib.loads(tomli_w.dumps(spec_table(case)))
    assert parse_scenario_spec(table) == case
    for name, value in values.items():
        above, _, last = name.rpartition(".")
        assert getattr(getattr(case, above) if above else case, last) == value
