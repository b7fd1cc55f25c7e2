"""Every way to get the scenario file wrong: one sentence that names file and key, exit 3."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.texts import MINIMAL, put, refused, scenario
from vttig_jax.base.errors import ScenarioError
from vttig_jax.control.scenario.scenario import MotionTable
from vttig_jax.control.scenario.spec import load_scenario_spec, parse_scenario_spec, spec_table

BAD_VALUES = [
    ("plants", "rigid", "unknown key `plants`; did you mean `plant`?"),
    ("motion.reversal", 1.0, "unknown key `reversal`; did you mean `reversal_deg`?"),
    ("plant", "rigd", "expected 'elastic' or 'play' or 'rigid', but it is 'rigd'."),
    ("pair", 3, "expected text, but it is 3."),
    ("pair", "", "missing"),
    ("eccentricities.driving_mm", -0.01, "expected a number >= 0.0, but it is -0.01."),
    ("mesh.restitution", 1.5, "expected a number <= 1.0, but it is 1.5."),
    ("motion.ramp_s", 0.0, "expected a number > 0.0"),
    ("motion.slow_share", 1.0, "expected a number < 1.0"),
    ("driven_encoder.counts_per_rev", 2.5, "expected a whole number, but it is 2.5."),
    ("seed", True, "expected a whole number, but it is True."),
    ("load.torque_Nm", float("nan"), "but it is nan."),
    ("zip", [["a", "b"]], "not at the top level; move it to [sweep]."),
]


@pytest.mark.parametrize(("name", "value", "words"), BAD_VALUES)
def test_a_bad_value_is_one_sentence_that_names_file_and_key(name, value, words, write):
    path = write(put(MINIMAL, name, value))
    with refused(f"{path}: {name}", words):
        load_scenario_spec(path)


def test_a_missing_key_is_named_with_an_example(write):
    path = write(put(MINIMAL, "eccentricities.driven_mm", None))
    with pytest.raises(ScenarioError, match=r"field driven_mm; write for example driven_mm = 0\.0"):
        load_scenario_spec(path)
    with pytest.raises(ScenarioError, match=r'field pair; write for example pair = "pair\.toml"'):
        parse_scenario_spec({})


CONTRADICTIONS = [
    ({"kind": "recorded"}, "file", 'missing; kind = "recorded" follows a CSV'),
    ({"file": "a.csv"}, "file", 'given, but kind is "trapezoid"; write kind = "recorded"'),
    ({"kind": "sine", "event": "aborted"}, "event", '"aborted" needs kind = "trapezoid"'),
    ({"kind": "recorded", "file": "a", "event": "slow_down"}, "event", '"slow_down" needs'),
    ({"reversal_deg": 179.9}, "reversal_deg", "inside the ramps"),
]


@pytest.mark.parametrize(("motion", "key", "words"), CONTRADICTIONS)
def test_a_contradiction_names_its_key(motion, key, words, write):
    path = write({**MINIMAL, "motion": motion})
    with refused(f"{path}: motion.{key}", words):
        load_scenario_spec(path)


def test_what_does_not_contradict_is_read():
    recorded = {"kind": "recorded", "file": "a.csv"}
    for motion in (
        recorded,
        recorded | {"reversal_deg": 1.0},
        {"kind": "sine", "reversal_deg": 1.0},
    ):
        assert scenario(motion=motion).motion == MotionTable(**motion)


MOTIONS = {
    "event": st.sampled_from(["reversal", "slow_down", "aborted", "emergency_stop"]),
    "speed_rpm": st.floats(1, 1000),
    "ramp_s": st.floats(0.01, 3),
    "slow_share": st.floats(0.05, 0.95),
    "stop_s": st.floats(0.01, 3),
    "dwell_s": st.floats(0, 5),
}


@given(st.fixed_dictionaries(MOTIONS))
def test_the_smallest_reversal_named_is_allowed(numbers):
    """That it is the angle of the ramps laid out one after the other, test_motion.py tells."""
    with pytest.raises(ScenarioError) as caught:
        scenario(motion={**numbers, "reversal_deg": 1e-3})
    smallest = float(caught.value.message.rpartition(" ")[2].rstrip("."))
    assert scenario(motion={**numbers, "reversal_deg": smallest}).motion.reversal_deg == smallest
    inside = smallest * (1 - 2e-5)  # the sentence rounds up in the sixth digit
    with refused("motion.reversal_deg", "inside the ramps"):
        scenario(motion={**numbers, "reversal_deg": inside})


@pytest.mark.parametrize(
    ("controller_hz", "plant_hz", "words"),
    [
        (1000, 1500, "1500 Hz is 1.5 times controller_hz; write a whole multiple such as 2000"),
        (1000, 10, "such as 1000, or 0 for controller_hz itself."),
        (1000, 2000.01, "such as 2000"),
        *[(1000, hertz, None) for hertz in (0, 1000, 3000.0, 1e5)],
        (0.1, 0.3, None),  # no exact multiple in binary
    ],
)
def test_plant_steps_are_whole_multiples(controller_hz, plant_hz, words):
    table = {"controller_hz": controller_hz, "plant_hz": plant_hz}
    if words is None:
        assert scenario(sampling=table).sampling.plant_hz == plant_hz
        return
    with refused("sampling.plant_hz", words):
        scenario(sampling=table)


@pytest.mark.parametrize(
    ("table", "seen"),
    [
        ({"pair": "p"}, "missing"),
        ({**MINIMAL, "rig": {"from": "RUN"}}, "given together"),
        ({"pair": "p", "plant_map": "RUN", "controller_map": "eccentricities"}, "missing"),
        ({"pair": "p", "rig": {"from": "RUN"}, "controller_map": "eccentricities"}, "missing"),
    ],
)
def test_the_rig_is_given_once(table, seen):
    with pytest.raises(ScenarioError, match=f"^eccentricities: {seen}"):
        parse_scenario_spec(table)


leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
NAMES = "pair plant motion eccentricities rig sweep zip from to num motion.ramp_s kind seed values"
names = st.sampled_from(NAMES.split()) | st.text(max_size=4)
anything = st.recursive(
    leaves | st.lists(names, max_size=2),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=4),
    max_leaves=8,
)


@given(
    st.dictionaries(names, anything, min_size=1, max_size=3), st.sampled_from(["", "base", "sweep"])
)
def test_any_table_is_a_scenario_or_our_error(table, within):
    tables = {"": table, "base": {**MINIMAL, **table}, "sweep": {**MINIMAL, "sweep": table}}
    try:
        spec = parse_scenario_spec(tables[within])
    except ScenarioError:
        return
    assert parse_scenario_spec(spec_table(spec)) == spec
