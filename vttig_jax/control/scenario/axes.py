"""Axes of a sweep: the `[sweep]` table of a sweep file, and its checks. This module needs no jax.

An axis is a key of the scenario with the values that the sweep gives to it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Struct

from ...base.errors import ScenarioError
from ...base.files.toml_io import Key, Table, TomlFile, did_you_mean, key

SCENARIO_FILE = TomlFile(
    ScenarioError,
    noun="a scenario",
    cure="`vttig simulate --print-defaults` prints one to start from",
    content="names the pair file and the tables that `vttig simulate --print-defaults` prints",
)

Value = str | float | int

_NO_AXES = {
    "rig": "no axis; move `rig` to the top of the file, before the first table.",
    "constant_backlash_deg": "a map is read once, with one backlash; sweep"
    " map.constant_backlash_deg, which the controller believes, or run one sweep for each"
    " backlash.",
}
"""Key that a sweep cannot vary → why."""

Gap = Literal["mean", "low95", "low95_simultaneous"]
"""Gap of a map that a controller believes: its mean, or an edge of its band."""
_Bound = Annotated[float, key("an end of the range, included", ge=-1e12, le=1e12)]


class Range(Table, frozen=True, rename={"first": "from", "last": "to"}):
    """Table `{ from, to, num }` of an axis: `num` evenly spaced values including both ends."""

    first: _Bound
    last: _Bound
    num: Annotated[int, key("number of values", ge=1, le=10**7)]

    @property
    def values(self) -> tuple[float, ...]:
        """All values of the range, from the first to the last."""
        return tuple(np.linspace(self.first, self.last, self.num).tolist())


class _Values(Table, frozen=True):
    """Table `{ values = […] }`: the list of values of an axis, written as a table.

    `Sweep.table` uses it so that the axes keep their order in the file.
    """

    values: list[Any]


class Sweep(Struct, frozen=True, kw_only=True):
    """Axes of a sweep in file order, and groups of axes that advance together.

    **Arguments**
    - `axes`: dotted key of the scenario → its values or their range.
    - `zip`: groups of axes that advance together: case by case, all axes of a group take their next
      value, instead of every combination of their values.
    - `whole`: axes whose key takes only whole numbers.
    """

    axes: dict[str, Range | tuple[Value, ...]]
    zip: tuple[tuple[str, ...], ...] = ()
    whole: frozenset[str] = frozenset()

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Factors of the Cartesian product, slowest first: groups of axes that advance together.

        An axis outside `zip` is a group of one name. Names in a group are in file order, and the
        position of a group is that of its first name in the file.
        """
        groups: dict[str, tuple[str, ...]] = {}
        for name in self.axes:
            group = next((group for group in self.zip if name in group), (name,))
            ordered = tuple(axis for axis in self.axes if axis in group)
            groups.setdefault(ordered[0], ordered)
        return tuple(groups.values())

    def values(self, name: str) -> tuple[Value, ...]:
        """Return the values of one axis, converted to the type of its key."""
        axis = self.axes[name]
        if not isinstance(axis, Range):
            return axis
        return tuple(map(round, axis.values)) if name in self.whole else axis.values

    @property
    def table(self) -> dict[str, Any]:
        """Table `[sweep]` as it is written in a file.

        TOML writers put subtables after all other keys, but the order of the axes matters. After an
        axis with a range, which is a subtable, each list is therefore written as a subtable too.
        """
        table: dict[str, Any] = {"zip": [list(group) for group in self.zip]} if self.zip else {}
        ranges = False
        for name, axis in self.axes.items():
            if isinstance(axis, Range):
                ranges = True
                table[name] = {"from": axis.first, "to": axis.last, "num": axis.num}
            else:
                table[name] = {"values": list(axis)} if ranges else list(axis)
        return table


def unknown_key(name: str, known: Mapping[str, Key]) -> str:
    """Return the message for a dotted name that is not a key of a scenario."""
    last = name.rpartition(".")[2]
    matches = [f"`{dotted}`" for dotted in known if dotted.rpartition(".")[2] == last]
    hint = did_you_mean(name, known, "`vttig simulate --print-defaults` lists them.")
    if matches:
        hint = f"did you mean {' or '.join(matches)}?"
    return f"`{name}` is no key of a scenario; {hint}"


def parse_sweep(table: Any, known: Mapping[str, Key]) -> Sweep:
    """Validate the parsed table `[sweep]` and return the sweep.

    `known` holds the keys that are allowed as axes, by their dotted names.

    **Raises** `ScenarioError`; its attribute `where` is the dotted key.
    """
    table = SCENARIO_FILE.convert(table, dict[str, Any], "sweep")
    axes = {name: _axis(name, value, known) for name, value in table.items() if name != "zip"}
    sweep = Sweep(
        axes=axes,
        zip=SCENARIO_FILE.convert(table.get("zip", ()), tuple[tuple[str, ...], ...], "sweep.zip"),
        whole=frozenset(name for name in axes if int in known[name].types),
    )
    for number, group in enumerate(sweep.zip):
        _check_group(sweep, group, f"sweep.zip[{number}]")
    return sweep


def _axis(name: str, axis: Any, known: Mapping[str, Key]) -> Range | tuple[Value, ...]:
    where = f'sweep."{name}"' if "." in name else f"sweep.{name}"
    if name in _NO_AXES:
        raise ScenarioError(_NO_AXES[name], where=where)
    if name not in known:
        tables = {dotted.partition(".")[0] for dotted in known if "." in dotted}
        if name in tables and isinstance(axis, dict):
            inner = next(iter(axis), "…")
            raise ScenarioError(
                f'an axis is one dotted name in quotes; write "{name}.{inner}" = ….', where=where
            )
        raise ScenarioError(unknown_key(name, known), where=where)
    if isinstance(axis, dict):
        if "values" not in axis:
            return _range(axis, known[name], where)
        axis = SCENARIO_FILE.convert(axis, _Values, where).values
    if not isinstance(axis, list) or not axis:
        raise ScenarioError(
            f"an axis is a list of values or {{ from = …, to = …, num = … }}, but it is {axis!r}.",
            where=where,
        )
    return tuple(
        SCENARIO_FILE.convert(value, known[name].kind, f"{where}[{number}]")
        for number, value in enumerate(axis)
    )


def _range(table: dict[str, Any], known: Key, where: str) -> Range:
    if not {int, float} & set(known.types):
        raise ScenarioError(
            f"`{known.name}` takes no numbers; give its axis as a list of values.", where=where
        )
    axis: Range = SCENARIO_FILE.convert(table, Range, where)
    if axis.num == 1 and axis.first != axis.last:
        raise ScenarioError(
            f"one value cannot be both {axis.first:g} and {axis.last:g}; give num = 2 or more, or"
            " a list of one value.",
            where=f"{where}.num",
        )
    ends: tuple[float, ...] = (axis.first, axis.last)
    if int in known.types:
        if fractions := [value for value in axis.values if not value.is_integer()]:
            raise ScenarioError(
                f"`{known.name}` takes whole numbers, but {fractions[0]:g} is one of these values;"
                " choose a num that divides the range, or write a list.",
                where=where,
            )
        ends = tuple(map(round, ends))
    for name, end in zip(("from", "to"), ends, strict=True):
        SCENARIO_FILE.convert(end, known.kind, f"{where}.{name}")
    return axis


def _check_group(sweep: Sweep, group: tuple[str, ...], where: str) -> None:
    """Check that a group of `zip` has two or more axes of the sweep with equally many values."""
    for name in group:
        if name not in sweep.axes:
            hint = did_you_mean(
                name, sweep.axes, f"the axes are {', '.join(sweep.axes) or 'none'}."
            )
            raise ScenarioError(f"`{name}` is no axis of this sweep; {hint}", where=where)
        if sum(group.count(name) for group in sweep.zip) > 1:
            raise ScenarioError(
                f"`{name}` occurs twice in zip; put each axis in one group.", where=where
            )
    if len(group) < 2:
        raise ScenarioError("a group needs at least two axes; add axes or remove it.", where=where)
    lengths = {name: len(sweep.values(name)) for name in group}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ScenarioError(
            f"axes of a group need equally many values, but they have: {counts}.", where=where
        )
