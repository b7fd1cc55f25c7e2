"""TOML files that a person writes: reading, checking against `msgspec` structs, and their keys.

Needs no jax.

Whatever is wrong becomes one sentence; its `where` names the file and the dotted key.
"""

import difflib
import json
import re
import reprlib
import tomllib
import types
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union, get_args, get_origin

import msgspec
from msgspec import NODEFAULT, Meta, Struct
from msgspec.inspect import Metadata, NoneType, UnionType

from ..errors import InputError


class Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of the structs that stand for TOML tables; subclasses say `frozen=True` again."""


_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}
"""Types of TOML as `msgspec` calls them → for people."""

_SHORT = reprlib.Repr()
"""What was seen, cut where it would no longer fit a sentence."""
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 120


@dataclass(frozen=True)
class TomlFile:
    """One kind of TOML file: the words of its messages.

    **Arguments**
    - `error`: class of the errors.
    - `noun`: what the file is called, with its article.
    - `cure`: who takes which file, for one that is not there.
    - `content`: what it holds, for one that is no TOML.
    """

    error: type[InputError]
    noun: str
    cure: str
    content: str

    def read(self, path: str | Path) -> dict[str, Any]:
        """The tables of a file, not yet checked.

        **Raises** `error` for a file that cannot be read or is no TOML in UTF-8.
        """
        where = str(path)
        try:
            return tomllib.loads(Path(path).read_bytes().decode("utf-8-sig"))
        except FileNotFoundError:
            raise self.error(f"no such file; {self.cure}.", where=where) from None
        except IsADirectoryError:
            raise self.error(f"this is a folder; {self.cure}.", where=where) from None
        except PermissionError:
            raise self.error("no permission to read this file.", where=where) from None
        except UnicodeDecodeError as error:
            raise self.error(
                f"not a text file (byte {error.start} is no UTF-8); {self.noun} is TOML in UTF-8.",
                where=where,
            ) from None
        except (ValueError, RecursionError) as error:  # too long a number, too deep a list
            raise self.error(
                f"not valid TOML: {error}; {self.noun} {self.content}.", where=where
            ) from None
        except OSError as error:
            raise self.error(f"cannot be read: {error.strerror}.", where=where) from None

    def convert(self, value: Any, kind: Any, where: str = "") -> Any:
        """A parsed value as a struct or another type `msgspec` knows.

        **Arguments**
        - `value`: what `tomllib` made of it; `kind`: the type, annotated or not.
        - `where`: dotted key of the value, when it is not the whole file.

        **Raises** `error` whose `where` is the dotted key at fault.
        """
        try:
            return msgspec.convert(value, kind)
        except msgspec.ValidationError as error:
            message, inner = _sentence(str(error), value, kind)
            dot = "." if where and inner and inner[0] != "[" else ""
            raise self.error(message, where=f"{where}{dot}{inner}") from None

    @contextmanager
    def placed(self, source: str) -> Iterator[None]:
        """Put the file's name before the key of an error raised inside."""
        try:
            yield
        except self.error as error:
            where = f"{source}: {error.where}" if source and error.where else source or error.where
            raise self.error(error.message, where=where) from None


def plain_table(struct: Struct) -> dict[str, Any]:
    """The TOML table of a struct; keys that were left out and have no default stay out."""
    return _without_none(msgspec.to_builtins(struct))


def did_you_mean(name: str, known: Iterable[str], otherwise: str) -> str:
    """The closest known name as a question, else the sentence `otherwise`."""
    close = difflib.get_close_matches(name, known, 1)
    return f"did you mean `{close[0]}`?" if close else otherwise


def _without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: _without_none(value) if isinstance(value, dict) else value
        for name, value in table.items()
        if value is not None
    }


def _sentence(error: str, value: Any, kind: Any) -> tuple[str, str]:
    """Turn msgspec's message into ours: the sentence and the dotted key."""
    text, _, path = error.partition(" - at `$")
    dotted = path.rstrip("`").lstrip(".")
    parts = re.findall(r"[^.\[\]]+", dotted)
    if unknown := re.match(r"Object contains unknown field `(.*)`", text, re.DOTALL):
        name = unknown[1]
        known = [field.encode_name for field in getattr(_kind_at(kind, parts), "fields", ())]
        hint = did_you_mean(name, known, f"known keys here: {', '.join(known)}.")
        return f"unknown key `{name}`; {hint}", f"{dotted}.{name}" if dotted else name
    for part in parts:
        try:
            value = value[int(part)] if isinstance(value, list) else value[part]
        except (KeyError, IndexError, ValueError, TypeError):
            break
    seen = f", but it is {_SHORT.repr(value)}"
    if text.startswith("Invalid enum value"):
        values = _kind_at(kind, parts).values
        text = "Expected " + " or ".join(repr(choice) for choice in values)
    elif missing := re.match(r"Object missing required field `(.*)`", text):
        seen = _example(_kind_at(kind, parts), missing[1]) or seen
    return f"{_plain(text)}{seen}.", dotted


def _plain(text: str) -> str:
    """A message of `msgspec` in words for people, without the type of what follows it anyway."""
    text = re.sub(r"(, got `?\w+`?| \| null|`)", "", text)
    text = f"{text[0].lower()}{text[1:]}".replace("object missing", "table missing")
    text = re.sub(r"^expected (\w+)", lambda kind: f"expected {_WORDS.get(kind[1], kind[1])}", text)
    return re.sub(r" \| (\w+)", lambda kind: f" or {_WORDS.get(kind[1], kind[1])}", text)


def _example(kind: Any, name: str) -> str:
    """What to write for a missing key, where its description has an example."""
    field = next(one for one in kind.fields if one.encode_name == name)
    schema = field.type.extra_json_schema if isinstance(field.type, Metadata) else None
    examples = (schema or {}).get("examples")
    return f"; write for example {name} = {json.dumps(examples[0])}" if examples else ""


def _kind_at(kind: Any, parts: list[str]) -> Any:
    """The description of a table or value at the parts of a key, as `msgspec` gives it."""
    found = _bare(msgspec.inspect.type_info(kind))
    for part in parts:
        fields = {one.encode_name: one.type for one in getattr(found, "fields", ())}
        found = _bare(fields.get(part, getattr(found, "item_type", None)))
    return found


def _bare(kind: Any) -> Any:
    """A description without its metadata, and of an optional one the part that is not None."""
    while isinstance(kind, Metadata | UnionType):
        if isinstance(kind, Metadata):
            kind = kind.type
        else:
            kind = next(one for one in kind.types if not isinstance(one, NoneType))
    return kind


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
    return isinstance(kind, types.UnionType) or get_origin(kind) is Union


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Struct)
