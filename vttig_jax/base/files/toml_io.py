"""Input files in TOML: reading, validation against `msgspec` structs, and the list of their keys.

Every error is one sentence, and its `where` names the file and the dotted key. Imports no jax.
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

from ..errors import InputError
from .limits import read_regular


class Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of the structs that represent TOML tables; subclasses repeat `frozen=True`."""


_TYPE_NAMES = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}
"""Type names in messages of `msgspec` → type names in messages for the user."""

_SHORT = reprlib.Repr()
"""Printer of wrong values; it shortens them to 120 characters (a chosen length)."""
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 120


@dataclass(frozen=True)
class TomlFile:
    """Kind of TOML file, with the words of its error messages.

    **Arguments**
    - `error`: class of the errors.
    - `noun`: name of this kind of file, with its article.
    - `cure`: advice in the message for a missing file.
    - `content`: words on the expected content that follow `noun` in the message for a file that
      is not valid TOML.
    """

    error: type[InputError]
    noun: str
    cure: str
    content: str

    def read(self, path: str | Path) -> dict[str, Any]:
        """Read the tables of a file without validation.

        **Raises** `error` for a file that cannot be read or is not TOML in UTF-8.
        """
        try:
            return tomllib.loads(read_regular(path).decode("utf-8-sig"))
        except FileNotFoundError:
            message = f"no such file; {self.cure}."
        except IsADirectoryError:
            message = f"this is a folder; {self.cure}."
        except PermissionError:
            message = "there is no permission to read this file."
        except OSError as error:
            message = f"this file cannot be read: {error.strerror}."
        except UnicodeDecodeError as error:
            found = f"not a text file (byte {error.start} is not UTF-8)"
            message = f"{found}; {self.noun} is TOML in UTF-8."
        except (ValueError, RecursionError) as error:  # also too long numbers and too deep lists
            message = f"not valid TOML: {error}; {self.noun} {self.content}."
        raise self.error(message, where=str(path))

    def convert(self, value: Any, kind: Any, where: str = "") -> Any:
        """Convert a parsed value to a struct or to another type that `msgspec` supports.

        **Arguments**
        - `value`: value from `tomllib`; `kind`: target type, annotated or not.
        - `where`: dotted key of the value; empty for the whole file.

        **Raises** `error` whose `where` is the dotted key of the wrong value.
        """
        try:
            return msgspec.convert(value, kind)
        except msgspec.ValidationError as error:
            message, inner = _message_and_key(str(error), value, kind)
            dot = "." if where and inner and inner[0] != "[" else ""
            raise self.error(message, where=f"{where}{dot}{inner}") from None

    @contextmanager
    def error_context(self, source: str) -> Iterator[None]:
        """Put the file name `source` before the key of every error raised inside the block."""
        try:
            yield
        except self.error as error:
            where = f"{source}: {error.where}" if source and error.where else source or error.where
            raise self.error(error.message, where=where) from None


def plain_table(struct: Struct) -> dict[str, Any]:
    """Return the TOML table of a struct without the keys whose value is None."""
    return _without_none(msgspec.to_builtins(struct))


def did_you_mean(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return "did you mean …?" with the known name closest to `name`.

    If no known name is close, return the sentence `otherwise`.
    """
    close = difflib.get_close_matches(name, known, 1)
    return f"did you mean `{close[0]}`?" if close else otherwise


def _without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: _without_none(value) if isinstance(value, dict) else value
        for name, value in table.items()
        if value is not None
    }


def _message_and_key(error: str, value: Any, kind: Any) -> tuple[str, str]:
    """Convert a message of `msgspec` to a message for the user and the dotted key.

    `value` is the value that was converted, and `kind` the type that was expected.
    """
    text, _, path = error.partition(" - at `$")
    dotted = path.rstrip("`").lstrip(".")
    parts = re.findall(r"[^.\[\]]+", dotted)
    if unknown := re.match(r"Object contains unknown field `(.*)`", text, re.DOTALL):
        name = unknown[1]
        known = [one.name for one in _keys_at(kind, parts)]
        hint = did_you_mean(name, known, f"known keys here: {', '.join(known)}.")
        return f"unknown key `{name}`; {hint}", f"{dotted}.{name}" if dotted else name
    for part in parts:
        try:
            value = value[int(part)] if isinstance(value, list) else value[part]
        except (KeyError, IndexError, ValueError, TypeError):
            break
    ending = f", but it is {_SHORT.repr(value)}"
    if text.startswith("Invalid enum value"):
        words = sorted((word for one in _kinds_at(kind, parts) for word in get_args(one)), key=str)
        text = "Expected " + " or ".join(map(repr, words))
    elif missing := re.match(r"Object missing required field `(.*)`", text):
        for one in _keys_at(kind, parts):
            if one.name == missing[1] and one.examples:
                ending = f"; write for example {one.name} = {json.dumps(one.examples[0])}"
    return f"{_readable(text)}{ending}.", dotted


def _readable(text: str) -> str:
    """Replace the type names in a message of `msgspec`, and remove the type of the wrong value."""
    text = re.sub(r"(, got `?\w+`?| \| null|`)", "", text)
    text = f"{text[0].lower()}{text[1:]}".replace("object missing", "table missing")
    name = _TYPE_NAMES.get
    text = re.sub(r"^expected (\w+)", lambda kind: f"expected {name(kind[1], kind[1])}", text)
    return re.sub(r" \| (\w+)", lambda kind: f" or {name(kind[1], kind[1])}", text)


def _kinds_at(kind: Any, parts: list[str]) -> list[Any]:
    """Return the types that are allowed for the entry with the dotted key `parts`."""
    kinds = _types(kind)
    for part in parts:
        fields = {one.name: one.types for struct in _structs(kinds) for one in keys(struct)}
        lists = [get_args(one)[0] for one in kinds if get_origin(one) in (list, tuple)]
        kinds = list(fields.get(part, [own for item in lists for own in _types(item)]))
    return kinds


def _keys_at(kind: Any, parts: list[str]) -> "list[Key]":
    return [one for struct in _structs(_kinds_at(kind, parts)) for one in keys(struct)]


def _structs(kinds: Iterable[Any]) -> list[type[Struct]]:
    return [one for one in kinds if isinstance(one, type) and issubclass(one, Struct)]


def key(meaning: str, unit: str = "", **bounds: Any) -> Meta:
    """Return the meaning, unit and bounds of a key for `Annotated`; required keys have `examples`.

    The unit of a pure number is "1"; the unit of a text or a choice is "".
    """
    return Meta(description=meaning, extra={"unit": unit}, **bounds)


@dataclass(frozen=True)
class Key:
    """Description of one key of a file.

    **Arguments**
    - `name`: dotted name, for example `motion.speed_rpm`.
    - `kind`: annotated type for `msgspec.convert`.
    - `default`: default value; `msgspec.NODEFAULT` for a required key.
    - `meaning`, `unit`, `examples`: arguments of `key`.
    - `table`: struct of a key that is a table, else None.
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
        """Whether the key has no default."""
        return self.default is NODEFAULT

    @property
    def types(self) -> tuple[Any, ...]:
        """Allowed types of the value, without their descriptions."""
        return tuple(_types(self.kind))


def keys(struct: type[Struct], above: str = "") -> Iterator[Key]:
    """Yield the keys of one table in the order of its struct; `above` is its dotted name."""
    for field in msgspec.structs.fields(struct):
        meta = next((part for part in _parts(field.type) if isinstance(part, Meta)), Meta())
        tables = _structs(_types(field.type))
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
    """Yield the keys of a table that hold a value, including those of all its subtables."""
    for entry in keys(struct, above):
        if entry.table is None:
            yield entry
        else:
            yield from value_keys(entry.table, entry.name)


def _types(kind: Any) -> list[Any]:
    """Return the member types of a union without their descriptions."""
    return [part for part in _parts(kind) if not isinstance(part, Meta)]


def _parts(kind: Any) -> Iterator[Any]:
    """Yield the `Meta` descriptions and the types of which an annotated type or a union is made."""
    if hasattr(kind, "__metadata__"):
        yield from (part for part in kind.__metadata__ if isinstance(part, Meta))
        yield from _parts(kind.__origin__)
    elif isinstance(kind, types.UnionType) or get_origin(kind) is Union:
        for member in get_args(kind):
            yield from _parts(member)
    else:
        yield kind
