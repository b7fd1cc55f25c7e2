"""Reading TOML into structs: words of the errors, for any struct and any kind of file."""

from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import NODEFAULT, Meta

from vttig_jax.base.errors import InputError, LogError
from vttig_jax.base.files.toml_io import (
    Table,
    TomlFile,
    did_you_mean,
    key,
    keys,
    plain_table,
    value_keys,
)

pytestmark = pytest.mark.smoke


class RecipeError(InputError):
    """An error of this test alone."""


class Oven(Table, frozen=True):
    heat_degC: Annotated[float, key("in the middle", "degC", gt=0, le=300, examples=[180.0])]
    fan: Annotated[Literal["on", "off"], key("of the oven")] = "off"
    shelf: Annotated[int, key("from below", "1", ge=1)] | None = None


class Step(Table, frozen=True):
    minutes: Annotated[float, Meta(ge=0)]


class Recipe(Table, frozen=True):
    name: Annotated[str, key("of the dish")] = ""
    oven: Annotated[Oven | None, key("the oven")] = None
    steps: tuple[Step, ...] = ()
    spare: Oven = Oven(heat_degC=20.0)


RECIPE = TomlFile(
    RecipeError, noun="a recipe", cure="--recipe takes a TOML", content="names the dish"
)


def refused(table: dict) -> tuple[str, str]:
    with pytest.raises(RecipeError) as caught:
        RECIPE.convert(table, Recipe)
    return caught.value.where, caught.value.message


WRONG = [
    ({"ofen": {}}, "ofen", "unknown key `ofen`; did you mean `oven`?"),
    ({"xyz": 1}, "xyz", "unknown key `xyz`; known keys here: name, oven, steps, spare."),
    ({"oven": {"heat_degC": 1, "fun": 1}}, "oven.fun", "unknown key `fun`; did you mean `fan`?"),
    ({"oven": {"fan": "on"}}, "oven",
     "table missing required field heat_degC; write for example heat_degC = 180.0."),
    ({"steps": [{}]}, "steps[0]", "table missing required field minutes, but it is {}."),
    ({"oven": {"heat_degC": 1.0, "fan": "maybe"}}, "oven.fan",
     "expected 'off' or 'on', but it is 'maybe'."),
    ({"oven": {"heat_degC": 0}}, "oven.heat_degC", "expected a number > 0.0, but it is 0."),
    ({"oven": {"heat_degC": 1, "shelf": "top"}}, "oven.shelf",
     "expected a whole number, but it is 'top'."),
    ({"steps": [{"minutes": 1}, {"minutes": 2, "minute": 1}]}, "steps[1].minute",
     "unknown key `minute`; did you mean `minutes`?"),
    ({"oven": 3}, "oven", "expected a table, but it is 3."),
]  # fmt: skip


@pytest.mark.parametrize(("table", "where", "message"), WRONG)
def test_what_is_wrong_is_a_sentence_and_a_key(table, where, message):
    assert refused(table) == (where, message)


def test_long_values_are_cut():
    _, message = refused({"oven": {"heat_degC": "x" * 10_000}})
    assert len(message) < 200 and "xxx...xxx" in message


def test_a_good_table_is_the_struct():
    table = {"name": "pie", "oven": {"heat_degC": 180}, "steps": [{"minutes": 2}]}
    recipe = Recipe(name="pie", oven=Oven(heat_degC=180.0), steps=(Step(minutes=2.0),))
    assert RECIPE.convert(table, Recipe) == recipe
    assert RECIPE.convert(plain_table(recipe), Recipe) == recipe
    assert "shelf" not in plain_table(recipe)["oven"]


def test_a_value_inside_a_file_names_its_own_key():
    kind = next(one.kind for one in value_keys(Recipe) if one.name == "oven.heat_degC")
    assert RECIPE.convert(7, kind, "list[2]") == 7.0
    for value, struct, place, where in (
        (700, kind, "list[2]", "list[2]"),
        ({"heat_degC": "hot"}, Oven, "ovens", "ovens.heat_degC"),
    ):
        with pytest.raises(RecipeError) as caught:
            RECIPE.convert(value, struct, place)
        assert caught.value.where == where


def test_the_file_stands_before_the_key_of_its_own_errors():
    for source, where, whole in (("f", "k", "f: k"), ("", "k", "k"), ("f", "", "f"), ("", "", "")):
        with pytest.raises(RecipeError) as caught, RECIPE.error_context(source):
            raise RecipeError("burnt.", where=where)
        assert (caught.value.where, caught.value.message) == (whole, "burnt.")
    with pytest.raises(LogError) as other, RECIPE.error_context("f"):
        raise LogError("no log.", where="k")
    assert other.value.where == "k"


def test_what_is_no_toml_is_refused(tmp_path):
    for content, message in (
        (b"name = \n", "not valid TOML: "),
        (b'name = "\xff"\n', "not a text file (byte 8 is not UTF-8); a recipe is TOML in UTF-8."),
        (b"shelf = " + b"9" * 5000, "not valid TOML: "),
        (b"steps = " + b"[" * 100_000, "not valid TOML: "),
    ):
        path = tmp_path / "recipe.toml"
        path.write_bytes(content)
        with pytest.raises(RecipeError) as caught:
            RECIPE.read(path)
        assert caught.value.message.startswith(message) and caught.value.where == str(path)
        assert "a recipe" in caught.value.message


def test_what_is_not_there_is_refused(tmp_path):
    with pytest.raises(RecipeError, match="no such file; --recipe takes a TOML"):
        RECIPE.read(tmp_path / "none.toml")
    with pytest.raises(RecipeError, match="this is a folder; --recipe takes a TOML"):
        RECIPE.read(tmp_path)


def test_a_good_file_is_read(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_bytes(b'\xef\xbb\xbfname = "caf\xc3\xa9"\n')
    assert RECIPE.read(path) == {"name": "café"}


leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
names = st.sampled_from(["name", "oven", "steps", "fan", "heat_degC", "` - at `$.b"]) | st.text()
anything = st.recursive(
    leaves,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(names, anything, max_size=3))
def test_any_table_is_a_struct_or_our_error(table):
    try:
        recipe = RECIPE.convert(table, Recipe)
    except RecipeError:
        return
    assert RECIPE.convert(plain_table(recipe), Recipe) == recipe


def test_the_closest_name_is_proposed():
    assert did_you_mean("ofen", ["oven", "name"], "no.") == "did you mean `oven`?"
    assert did_you_mean("zzz", ["oven", "name"], "no.") == "no."


def test_keys_of_a_struct():
    name, oven, steps, spare = keys(Recipe)
    assert [one.name for one in (name, oven, steps, spare)] == ["name", "oven", "steps", "spare"]
    assert [one.table for one in (name, oven, steps, spare)] == [None, Oven, None, Oven]
    assert (name.default, name.unit, name.meaning) == ("", "", "of the dish")
    assert (oven.default, oven.meaning, oven.required) == (None, "the oven", False)


def test_keys_that_hold_values():
    found = {one.name: one for one in value_keys(Recipe)}
    assert list(found) == [
        *("name", "oven.heat_degC", "oven.fan", "oven.shelf"),
        *("steps", "spare.heat_degC", "spare.fan", "spare.shelf"),
    ]
    heat, shelf = found["oven.heat_degC"], found["oven.shelf"]
    assert (heat.default, heat.required, heat.examples) == (NODEFAULT, True, (180.0,))
    assert (heat.unit, heat.types) == ("degC", (float,))
    assert (shelf.default, shelf.unit, shelf.meaning) == (None, "1", "from below")
    assert shelf.types == (int, type(None))
