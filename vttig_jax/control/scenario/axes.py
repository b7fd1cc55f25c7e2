"""`[sweep]` of a sweep file: which keys of the scenario take which values. Needs no jax."""

from collections.abc import Mapping
from typing import Annotated, Any

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
_Bound = Annotated[float, key("an end of the range, included", ge=-1e12, le=1e12)]


class Range(Table, frozen=True, rename={"first": "from", "last": "to"}):
    """`{ from, to, num }`: evenly spaced values, both ends included."""

    first: _Bound
    last: _Bound
    num: Annotated[int, key("number of values", ge=1, le=10**7)]

    @property
    def values(self) -> tuple[float, ...]:
        """All of them, in order."""
        return tuple(np.linspace(self.first, self.last, self.num).tolist())


class _Values(Table, frozen=True):
    """`{ values = […] }`: a list where only a table keeps its place, see `Sweep.table`."""

    values: list[Any]


class Sweep(Struct, frozen=True, kw_only=True):
    """Axes of a sweep in file order, and which of them go together.

    **Arguments**
    - `axes`: dotted key of the scenario → its values or their range.
    - `zip`: groups of axes that advance together instead of being combined.
    - `whole`: those of the axes whose key takes whole numbers only.
    """

    axes: dict[str, Range | tuple[Value, ...]]
    zip: tuple[tuple[str, ...], ...] = ()
    whole: frozenset[str] = frozenset()

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Axes of the Cartesian product, slowest first; a group stands where its first name does.

        The names of a group are in file order.
        """
        found: dict[str, tuple[str, ...]] = {}
        for name in self.axes:
            group = next((one for one in self.zip if name in one), (name,))
            ordered = tuple(one for one in self.axes if one in group)
            found.setdefault(ordered[0], ordered)
        return tuple(found.values())

    def values(self, name: str) -> tuple[Value, ...]:
        """Values of one axis, of the type its key has."""
        axis = self.axes[name]
        if not isinstance(axis, Range):
            return axis
        return tuple(map(round, axis.values)) if name in self.whole else axis.values

    @property
    def table(self) -> dict[str, Any]:
        """The table as a file holds it.

        Writers of TOML put tables last. The order of the axes means something, so that after a
        range, which is a table, a list is written as one too.
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
    """What to say of a dotted name that is no key of a scenario."""
    last = name.rpartition(".")[2]
    same = [f"`{one}`" for one in known if one.rpartition(".")[2] == last]
    hint = did_you_mean(name, known, "`vttig simulate --print-defaults` lists them.")
    if same:
        hint = f"did you mean {' or '.join(same)}?"
    return f"`{name}` is no key of a scenario; {hint}"


def parse_sweep(table: Any, known: Mapping[str, Key]) -> Sweep:
    """Validate `[sweep]`; `known` are the keys an axis may name.

    **Raises** `ScenarioError` whose `where` is the dotted key.
    """
    table = SCENARIO_FILE.convert(table, dict[str, Any], "sweep")
    axes = {name: _axis(name, given, known) for name, given in table.items() if name != "zip"}
    sweep = Sweep(
        axes=axes,
        zip=SCENARIO_FILE.convert(table.get("zip", ()), tuple[tuple[str, ...], ...], "sweep.zip"),
        whole=frozenset(name for name in axes if int in known[name].types),
    )
    for number, group in enumerate(sweep.zip):
        _check_group(sweep, group, f"sweep.zip[{number}]")
    return sweep


def _axis(name: str, given: Any, known: Mapping[str, Key]) -> Range | tuple[Value, ...]:
    where = f'sweep."{name}"' if "." in name else f"sweep.{name}"
    if name not in known:
        tables = {one.partition(".")[0] for one in known if "." in one}
        if name in tables and isinstance(given, dict):
            inner = next(iter(given), "…")
            raise ScenarioError(
                f'an axis is one dotted name in quotes; write "{name}.{inner}" = ….', where=where
            )
        raise ScenarioError(unknown_key(name, known), where=where)
    if isinstance(given, dict):
        if "values" not in given:
            return _range(given, known[name], where)
        given = SCENARIO_FILE.convert(given, _Values, where).values
    if not isinstance(given, list) or not given:
        raise ScenarioError(
            f"an axis is a list of values or {{ from = …, to = …, num = … }}, but it is {given!r}.",
            where=where,
        )
    return tuple(
        SCENARIO_FILE.convert(value, known[name].kind, f"{where}[{number}]")
        for number, value in enumerate(given)
    )


def _range(given: dict[str, Any], known: Key, where: str) -> Range:
    if not {int, float} & set(known.types):
        raise ScenarioError(
            f"`{known.name}` takes no numbers, so that its axis is a list of values.", where=where
        )
    axis: Range = SCENARIO_FILE.convert(given, Range, where)
    if axis.num == 1 and axis.first != axis.last:
        raise ScenarioError(
            f"one value cannot be both {axis.first:g} and {axis.last:g}; give num = 2 or more, or"
            " a list of one value.",
            where=f"{where}.num",
        )
    ends: tuple[float, ...] = (axis.first, axis.last)
    if int in known.types:
        if broken := [value for value in axis.values if not value.is_integer()]:
            raise ScenarioError(
                f"`{known.name}` takes whole numbers, but {broken[0]:g} is one of these; choose a"
                " num that divides the range, or write a list.",
                where=where,
            )
        ends = tuple(map(round, ends))
    for name, end in zip(("from", "to"), ends, strict=True):
        SCENARIO_FILE.convert(end, known.kind, f"{where}.{name}")
    return axis


def _check_group(sweep: Sweep, group: tuple[str, ...], where: str) -> None:
    """Refuse a group of axes that cannot go together."""
    for name in group:
        if name not in sweep.axes:
            hint = did_you_mean(
                name, sweep.axes, f"the axes are {', '.join(sweep.axes) or 'none'}."
            )
            raise ScenarioError(f"`{name}` is no axis of this sweep; {hint}", where=where)
        if sum(one.count(name) for one in sweep.zip) > 1:
            raise ScenarioError(
                f"`{name}` stands twice in zip; an axis belongs to one group.", where=where
            )
    if len(group) < 2:
        raise ScenarioError("a group names at least two axes that go together.", where=where)
    lengths = {name: len(sweep.values(name)) for name in group}
    if len(set(lengths.values())) > 1:
        seen = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ScenarioError(
            f"axes that go together need equally many values, but they have: {seen}.", where=where
        )
