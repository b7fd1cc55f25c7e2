"""Completion of command lines: names of columns from the log on the line, and words of bash."""

import os
import re
from contextlib import suppress
from pathlib import Path

import click
from click.shell_completion import BashComplete, add_completion_class, shell_complete
from click.shell_completion import CompletionItem as Item

from ..logs.readers.column_names import ROLES

MOST_BYTES = 1 << 26
"""Columns of a larger log are not completed, because reading it takes too long (chosen)."""

_BREAKS = ("=", ":")
_ONE_VALUE = "[[ ${#COMPREPLY[@]} -eq 1 && ${COMPREPLY[0]} == *= ]] && compopt -o nospace"


def answer(group: click.Group, program: str, variable: str, instruction: str) -> int:
    """Print the completion script or the completions that `instruction` asks for."""
    add_completion_class(_Bash)
    return shell_complete(group, {}, program, variable, instruction)


def columns_of_log(context: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    """Return the values ROLE=NAME that complete `incomplete`, with the columns of the first log.

    As long as several roles are possible, it returns them without a name.
    """
    role, equals, _name = incomplete.partition("=")
    roles = [one for one in ROLES if (one == role if equals else one.startswith(role))]
    if len(roles) != 1:
        return [f"{one}=" for one in roles]
    named = [f"{roles[0]}={name}" for name in _names(context)]
    return [one for one in named if one.startswith(incomplete)] or [f"{roles[0]}="] * (not equals)


def _names(context: click.Context) -> list[str]:
    """Return the names of the columns of the first log on the line, or [] if it cannot be read.

    A name that several columns have is replaced by the number of the column.
    """
    parsed = context.params.get("logs") or context.params.get("log") or ()
    # For `--column ` without a value click stops parsing, and leaves the words of the line in args.
    words = [*(parsed if isinstance(parsed, tuple) else [parsed]), *context.args]
    logs = [path for word in words if (path := Path(word).expanduser()).exists()]
    with suppress(Exception):  # a message or a traceback would be taken for a completion
        path = logs[0]
        if path.is_dir() or path.stat().st_size <= MOST_BYTES:
            from ..logs.readers.open_table import open_table

            names = list(open_table(path).names)
            return [
                name if names.count(name) == 1 else f"#{number}"
                for number, name in enumerate(names, 1)
            ]
    return []


class _Bash(BashComplete):
    """Completion of bash, which divides words at `=` and `:` and completes the last part only."""

    source_template = BashComplete.source_template.replace(
        "    return 0\n", f"    {_ONE_VALUE}\n\n    return 0\n", 1
    ).replace("read type value", "read -r type value")
    _whole = ""
    """Part of the incomplete word that bash does not replace."""

    def get_completion_args(self) -> tuple[list[str], str]:
        """Return the complete words and the incomplete one, joined where bash divided them."""
        before, last = super().get_completion_args()
        words: list[str] = []
        joins = False
        for word in [os.environ["COMP_WORDS"].split()[0], *before, last]:
            breaks = word in _BREAKS
            self._whole = words[-1] if words and (joins or breaks) else ""
            if words and (joins or breaks):
                words[-1] += word
            else:
                words.append(word)
            joins = breaks
        if last in _BREAKS:
            self._whole = words[-1]
        return words[1:-1], words[-1]

    def format_completion(self, item: Item) -> str:
        """Return type and value: the part that bash replaces, with escaped special characters."""
        whole = self._whole.partition("=")[2] if self._whole.startswith("-") else self._whole
        value = str(item.value).removeprefix(whole)
        escaped = re.sub(r"[^\w=+,./:@%#°-]", r"\\\g<0>", value)
        return f"{item.type},{escaped}"
