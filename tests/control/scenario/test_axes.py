"""`[sweep]`: its axes, their values and what goes together."""

import tomllib

import numpy as np
import pytest
import tomli_w

from tests.control.texts import MINIMAL, refused
from vttig_jax.control.scenario.axes import Range
from vttig_jax.control.scenario.spec import load_sweep_spec, parse_scenario_spec, spec_table

pytestmark = pytest.mark.smoke

DRAWS = {"pair": "pair.toml", "rig": {"from": "RUN", "draws": 200, "seed": 0}}


def sweep_of(text, start=MINIMAL):
    spec = parse_scenario_spec({**start, "sweep": tomllib.loads(text)})
    assert spec.sweep is not None
    return spec.sweep


def test_the_contracts_example(write):
    axes = """
[sweep]
"motion.reversal_deg" = { from = 360, to = 5760, num = 1000 }
"controller" = ["none", "acceleration", "predictive"]
"""
    spec = load_sweep_spec(write(tomli_w.dumps(MINIMAL) + axes))
    sweep = spec.sweep
    assert sweep is not None and sweep.axes == {
        "motion.reversal_deg": Range(first=360.0, last=5760.0, num=1000),
        "controller": ("none", "acceleration", "predictive"),
    }
    assert sweep.groups == (("motion.reversal_deg",), ("controller",))
    np.testing.assert_allclose(np.diff(sweep.values("motion.reversal_deg")), 5400 / 999, rtol=1e-9)
    assert spec.motion.reversal_deg == 7560.0  # the scenario itself keeps its value


def test_rigs_from_a_posterior_need_no_axis(write):
    spec = load_sweep_spec(write({**DRAWS, "sweep": {}}))
    assert spec.rig is not None and spec.sweep is not None and spec.eccentricities is None
    assert (spec.rig.run, spec.rig.draws, spec.rig.seed) == ("RUN", 200, 0)
    assert spec.sweep.groups == () and spec.sweep.axes == {}


@pytest.mark.parametrize(("start", "words"), [(MINIMAL, "simulate`."), (DRAWS, "empty [sweep]")])
def test_a_sweep_needs_its_table(start, words, write):
    path = write(start)
    with refused(f"{path}: sweep", words):
        load_sweep_spec(path)


ZIPPED = """
"motion.speed_rpm" = [30, 60, 90]
controller = ["none", "predictive"]
"motion.ramp_s" = { from = 1.0, to = 0.2, num = 3 }
seed = { from = 0, to = 9, num = 10 }
zip = [["motion.ramp_s", "motion.speed_rpm"]]
"""


def test_zipped_axes_stand_where_the_first_does_and_values_have_the_type_of_their_key():
    sweep = sweep_of(ZIPPED)
    assert sweep.groups == (("motion.speed_rpm", "motion.ramp_s"), ("controller",), ("seed",))
    assert sweep.values("motion.ramp_s") == pytest.approx((1.0, 0.6, 0.2))
    for name, kind in (("motion.speed_rpm", float), ("seed", int)):
        assert {type(value) for value in sweep.values(name)} == {kind}
    assert sweep.values("seed") == tuple(range(10))


# The writer of TOML puts lists before tables, which would change the places of all cases.
MIXED = 'seed = { from = 0, to = 1, num = 2 }\nplant = ["play", "rigid"]\n'


@pytest.mark.parametrize("text", [ZIPPED, MIXED, "plant = { values = ['play'] }"])
def test_a_sweep_goes_back_to_the_table_it_came_from(text):
    spec = parse_scenario_spec({**MINIMAL, "sweep": tomllib.loads(text)})
    table = tomllib.loads(tomli_w.dumps(spec_table(spec)))
    again = parse_scenario_spec(table)
    assert again == spec and parse_scenario_spec(spec_table(spec)) == spec
    assert spec.sweep is not None and again.sweep is not None
    assert list(again.sweep.axes) == list(spec.sweep.axes)
    assert again.sweep.groups == spec.sweep.groups


RANGE = "seed = { from = 0, to = 9, num = %s }"
GROUPS = "seed = [1, 2]\nplant = ['play']\nflanks = ['exact']\nzip = %s"
BAD = [
    ('"motion.reversal" = [1.0]', '"motion.reversal"', "did you mean `motion.reversal_deg`?"),
    ("reversal_deg = [1.0]", "reversal_deg", "did you mean `motion.reversal_deg`?"),
    ('motion = ["sine"]', "motion", "is no key of a scenario"),
    ("motion.reversal_deg = [1.0]", "motion", 'write "motion.reversal_deg" = ….'),
    ("rig = [1]", "rig", "move `rig` to the top of the file"),
    ("seed = []", "seed", "an axis is a list of values or { from = …, to = …, num = … }"),
    ("seed = 3", "seed", "but it is 3."),
    ('controller = ["none", "nine"]', "controller[1]", "but it is 'nine'."),
    ('"mesh.restitution" = [0.5, 2]', '"mesh.restitution"[1]', "expected a number <= 1.0"),
    ("controller = { from = 0, to = 1, num = 2 }", "controller", "takes no numbers"),
    ("seed = { from = 0, too = 9, num = 2 }", "seed.too", "did you mean `to`?"),
    (RANGE % 3, "seed", "takes whole numbers, but 4.5 is one"),
    (RANGE % 1, "seed.num", "one value cannot be both 0 and 9; give num = 2 or more"),
    ('"mesh.restitution" = { from = 0, to = 2, num = 3 }', '"mesh.restitution".to', "<= 1.0"),
    ("", "", "names no axis; write for example"),
    ("seed = [1]\nzip = 3", "zip", "expected a list"),
    (GROUPS % '[["seed"]]', "zip[0]", "a group needs at least two axes"),
    (GROUPS % '[["seed", "sed"]]', "zip[0]", "did you mean `seed`?"),
    (GROUPS % '[["seed", "seed"]]', "zip[0]", "`seed` occurs twice in zip"),
    (GROUPS % '[["plant", "flanks"], ["plant", "seed"]]', "zip[0]", "put each axis in one group."),
    (GROUPS % '[["seed", "plant"]]', "zip[0]", "need equally many values, but they have: seed 2"),
]


@pytest.mark.parametrize(("text", "key", "words"), BAD)
def test_a_bad_sweep_is_one_sentence_that_names_its_key(text, key, words):
    with refused(f"sweep.{key}" if key else "sweep", words):
        sweep_of(text)


def test_drawn_rigs_and_given_ones_exclude_each_other():
    with refused('sweep."eccentricities.driving_mm"', "given together with `rig`"):
        sweep_of('"eccentricities.driving_mm" = [0.1]', DRAWS)
    assert sweep_of('"eccentricities.driving_mm" = [0.1]').values("eccentricities.driving_mm")
