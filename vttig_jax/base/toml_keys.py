"""The keys of a file described by `msgspec` structs: dotted name, type, default, unit, meaning."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Any, Union, get_args, get_origin

import msgspec
from msgspec import NODEFAULT, Meta, Struct


def key(meaning: str, unit: str = "", **bounds: Any) -> Meta:
    """What a key means, its unit and its bounds, for `Annotated`; `examples` are for required keys.

    The unit of a pure number is "1", that of a text or a choice is "".
    """
    return Meta(description=meaning, extra={"unit": unit}, **bounds)


@dataclass(frozen=True)
class Key:
    """One key of a file.

    **Arguments**
    - `name`: dotted name, `motion.speed_rpm`.
    - `kind`: its annotated type, as `msgspec.convert` takes it.
    - `default`: its default; `msgspec.NODEFAULT` where it is required.
    - `meaning`, `unit`, `examples`: what `key` was told.
    - `table`: struct of a key that is a table.
    """

    name: str
    kind: Any
    default: Any
    meaning: str
    unit: str
    examples: tuple[Any, ...]
    table: type[Struct] | None = None

    @property
    def required(self) -> bool:
        """Whether there is no default."""
        return self.default is NODEFAULT

    @property
    def types(self) -> tuple[Any, ...]:
        """The types it may have, without their descriptions."""
        return tuple(_types(self.kind))


def keys(struct: type[Struct], above: str = "") -> Iterator[Key]:
    """Keys of one table in the order of its struct; `above` is the table's own dotted name."""
    for field in msgspec.structs.fields(struct):
        meta = next(_metas(field.type), Meta())
        tables = [one for one in _types(field.type) if _is_table(one)]
        yield Key(
            name=f"{above}.{field.encode_name}" if above else field.encode_name,
            kind=field.type,
            default=field.default,
            meaning=meta.description or "",
            unit=(meta.extra or {}).get("unit", ""),
            examples=tuple(meta.examples or ()),
            table=tables[0] if tables else None,
        )


def value_keys(struct: type[Struct], above: str = "") -> Iterator[Key]:
    """Keys that hold a value, those of the tables inside included."""
    for one in keys(struct, above):
        if one.table is None:
            yield one
        else:
            yield from value_keys(one.table, one.name)


def _types(kind: Any) -> Iterator[Any]:
    """The members of a union, each without its descriptions."""
    if hasattr(kind, "__metadata__"):
        yield from _types(kind.__origin__)
    elif _is_union(kind):
        for member in get_args(kind):
            yield from _types(member)
    else:
        yield kind


def _metas(kind: Any) -> Iterator[Meta]:
    """Descriptions of a type, then those of its union's members."""
    yield from (one for one in getattr(kind, "__metadata__", ()) if isinstance(one, Meta))
    for member in get_args(kind) if _is_union(kind) else ():
        yield from _metas(member)


def _is_union(kind: Any) -> bool:
    return isinstance(kind, UnionType) or get_origin(kind) is Union


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Struct)
