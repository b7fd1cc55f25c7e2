"""What is known of a file's keys from the structs that describe it."""

from typing import Annotated, Literal

from msgspec import NODEFAULT

from vttig_jax.base.files.toml_io import Table, key, keys, value_keys


class Oven(Table, frozen=True):
    heat_degC: Annotated[float, key("in the middle", "degC", gt=0, le=300, examples=[180.0])]
    fan: Annotated[Literal["on", "off"], key("of the oven")] = "off"
    shelf: Annotated[int, key("from below", "1", ge=1)] | None = None


class Recipe(Table, frozen=True):
    name: Annotated[str, key("of the dish")] = ""
    oven: Annotated[Oven | None, key("the oven")] = None
    steps: tuple[str, ...] = ()
    spare: Oven = Oven(heat_degC=20.0)


def test_keys_of_a_struct():
    name, oven, steps, spare = keys(Recipe)
    assert [one.name for one in (name, oven, steps, spare)] == ["name", "oven", "steps", "spare"]
    assert oven.table is Oven and spare.table is Oven
    assert name.table is None and steps.table is None
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
