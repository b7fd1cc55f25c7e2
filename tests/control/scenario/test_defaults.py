"""The printed defaults: a scenario file that says everything it may hold."""

import re
import tomllib

import pytest

from vttig_jax.base.errors import ScenarioError
from vttig_jax.base.files.toml_io import value_keys
from vttig_jax.control.scenario.spec import (
    KEYS,
    ScenarioSpec,
    default_toml,
    parse_scenario_spec,
    spec_table,
)

TEXT = default_toml()
HIDDEN = re.compile(r'^# (?=\[|"?[\w.]+"? = )', re.MULTILINE)
REQUIRED = re.compile(r"^# (?=.*# required: )", re.MULTILINE)
DRAWS, SWEEP = "# Instead of [eccentricities]", "# Only in a sweep file: "


def one_case():
    """What a user makes of it for `vttig simulate`: the required keys uncommented."""
    return tomllib.loads(REQUIRED.sub("", TEXT.partition(DRAWS)[0]))


def leaves(table, above=""):
    for name, value in table.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def test_it_is_toml_that_lacks_the_required_keys_only():
    printed = dict(leaves(tomllib.loads(TEXT)))
    optional = {one.name for one in KEYS.values() if not one.required and one.default is not None}
    assert set(printed) == optional
    with pytest.raises(ScenarioError, match="missing required field driving_mm"):
        parse_scenario_spec(tomllib.loads(TEXT))


def test_the_printed_defaults_are_those_of_the_structs_and_the_example_is_the_rig_of_the_paper(
    paper_rig,
):
    rig = one_case()["eccentricities"]
    assert rig == {name: getattr(paper_rig, name) for name in rig} and len(rig) == 5
    spec = parse_scenario_spec({"pair": "pair.toml", "eccentricities": rig})
    assert parse_scenario_spec(one_case()) == spec
    assert dict(leaves(one_case())) == dict(leaves(spec_table(spec)))


def test_every_key_is_there_with_its_unit_and_meaning():
    shown = tomllib.loads(HIDDEN.sub("", TEXT.partition(SWEEP)[0]))
    every = {one.name: one for one in value_keys(ScenarioSpec) if "sweep" not in one.name}
    assert set(dict(leaves(shown))) == set(every) and set(KEYS) < set(every)
    for one in every.values():
        above, _, last = one.name.rpartition(".")
        part = TEXT.split(f"[{above}]")[1] if above else TEXT
        line = re.search(rf"^(?:# )?{last} = .*$", part, re.MULTILINE)
        assert line is not None, one.name
        assert line[0].endswith(one.meaning)
        assert f"[{one.unit}] " in line[0] if one.unit else "[" not in line[0]
        assert ("required: " in line[0]) == one.required


def test_the_sweep_and_the_draws_it_shows_are_a_sweep_and_a_rig():
    start = REQUIRED.sub("", TEXT.partition(DRAWS)[0])
    sweep = HIDDEN.sub("", TEXT[TEXT.index(SWEEP) :])
    spec = parse_scenario_spec(tomllib.loads(start + sweep))
    assert spec.sweep is not None and spec.sweep.zip == (("motion.speed_rpm", "motion.ramp_s"),)
    assert len(spec.sweep.values("motion.reversal_deg")) == 1000
    draws = HIDDEN.sub("", TEXT[TEXT.index(DRAWS) : TEXT.index(SWEEP)])
    spec = parse_scenario_spec(tomllib.loads('pair = "pair.toml"\n' + draws))
    assert spec.rig is not None and (spec.rig.run, spec.rig.draws) == ("RUN", 200)


def test_it_is_ascii_keeps_to_a_screen_and_lists_choices():
    """Plain letters survive any terminal; a file of them is UTF-8."""
    assert TEXT.isascii() and max(map(len, TEXT.splitlines())) <= 130
    assert "# none | acceleration | predictive | feedforward: " in TEXT
