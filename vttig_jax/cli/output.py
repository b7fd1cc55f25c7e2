"""Output of the commands: results on stdout, messages and progress on stderr, and a log file."""

import logging
import sys
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..base.errors import InputError
from ..base.files.json_io import dumps

if TYPE_CHECKING:
    from tqdm import tqdm

LOGGER = logging.getLogger("vttig_jax")


@dataclass
class Output:
    """Output of one command: its result and its progress bars.

    **Arguments**
    - `json`: whether `--json` was given; stdout then contains one JSON object and nothing else.
    - `quiet`: whether `-q` was given; progress bars are then hidden.
    """

    json: bool = False
    quiet: bool = False
    _object: Any = field(default=None, init=False, repr=False)

    def emit(self, obj: dict[str, Any], text: object) -> None:
        """Output the result, once per command: `obj` with `--json`, otherwise `str(text)`.

        The text is printed immediately. The object is stored until the command has succeeded,
        because stdout must contain exactly one object even if the command fails after this call.
        """
        if not self.json:
            print_result(str(text))
            return
        if self._object is not None:
            raise RuntimeError("a command gives one JSON object, but `emit` was called twice")
        self._object = obj

    def finish(self) -> None:
        """Print the stored object."""
        if self._object is not None:
            print_result(dumps(self._object, ascii_only=True))

    def progress(self, total: int, desc: str) -> "tqdm[Any]":
        """Return a progress bar that `-q` hides; see the function `progress`."""
        return progress(total, desc, self.quiet)


def progress(total: int, desc: str, quiet: bool) -> "tqdm[Any]":
    """Return a progress bar on stderr for use in a `with` statement; `.update(n)` advances it.

    The bar is hidden if `quiet` is true or stderr is not a terminal. It is erased at the end.
    """
    from tqdm import tqdm

    hidden = True if quiet else None  # None hides the bar if stderr is not a terminal
    return tqdm(total=total, desc=desc, file=sys.stderr, disable=hidden, leave=False)


def print_result(text: str) -> None:
    """Print a result to stdout.

    **Raises** `InputError` if stdout cannot be written, for example on a full disk, and
    `BrokenPipeError` if it is a closed pipe.
    """
    try:
        click.echo(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"results cannot be written: {error.strerror}.", where="stdout") from error


class Narrator(AbstractContextManager["Narrator"]):
    """Context that sends the messages of the library to stderr and, on request, to a file."""

    def __init__(self) -> None:
        self.log_file: Path | None = None
        self._level = LOGGER.level
        self._stderr = logging.StreamHandler(sys.stderr)
        self._handlers: list[logging.Handler] = [self._stderr]

    def __enter__(self) -> "Narrator":
        self._stderr.setFormatter(_Sentence())
        self._stderr.setLevel(logging.WARNING)
        LOGGER.setLevel(logging.DEBUG)
        LOGGER.addHandler(self._stderr)
        return self

    def __exit__(self, *_: object) -> None:
        for handler in self._handlers:
            LOGGER.removeHandler(handler)
        for handler in self._handlers[1:]:
            handler.close()
        LOGGER.setLevel(self._level)

    def tune(self, verbose: int, quiet: bool, log_file: Path | None) -> None:
        """Apply `-v` (information), `-vv` (details), `-q` (errors only) and `--log-file`.

        **Raises** `InputError` for a log file that cannot be written.
        """
        levels = [logging.WARNING, logging.INFO, logging.DEBUG]
        self._stderr.setLevel(logging.ERROR if quiet else levels[min(verbose, 2)])
        if log_file is None:
            return
        try:
            handler = logging.FileHandler(log_file, encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"the log file cannot be written: {error.strerror}.", where=str(log_file)
            ) from error
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        self._handlers.append(handler)
        LOGGER.addHandler(handler)
        self.log_file = log_file


class _Sentence(logging.Formatter):
    """Formatter of messages without tracebacks, which only the log file contains."""

    def format(self, record: logging.LogRecord) -> str:
        prefix = {logging.WARNING: "warning: ", logging.ERROR: "error: "}
        return prefix.get(record.levelno, "") + record.getMessage()
