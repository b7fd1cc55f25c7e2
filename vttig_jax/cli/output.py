"""Where words go: results to stdout, narration to stderr and the log file, progress to stderr."""

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
    """What a verb gets to speak through.

    **Arguments**
    - `json`: `--json` was given; stdout holds one object and nothing else.
    - `quiet`: `-q` was given; no progress bars.
    """

    json: bool = False
    quiet: bool = False
    _object: Any = field(default=None, init=False, repr=False)

    def emit(self, obj: dict[str, Any], text: object) -> None:
        """Give the result, once a command: `obj` with `--json`, otherwise `str(text)`.

        The object is held back until the command has ended well, because a failure after this must
        still leave exactly one object on stdout; text is printed now.
        """
        if not self.json:
            print_result(str(text))
            return
        if self._object is not None:
            raise RuntimeError("a command gives one JSON object, but `emit` was called twice")
        self._object = obj

    def finish(self) -> None:
        """Print the object that was held back."""
        if self._object is not None:
            print_result(dumps(self._object, ascii_only=True))

    def progress(self, total: int, desc: str) -> "tqdm[Any]":
        """Return a progress bar that `-q` silences; see the function of this name."""
        return progress(total, desc, self.quiet)


def progress(total: int, desc: str, quiet: bool) -> "tqdm[Any]":
    """Return a progress bar on stderr, to be used in `with` and moved by `.update(n)`.

    Shows nothing when `quiet` or where stderr is no terminal, and leaves no line behind.
    """
    from tqdm import tqdm

    hidden = True if quiet else None  # None: hidden off a terminal
    return tqdm(total=total, desc=desc, file=sys.stderr, disable=hidden, leave=False)


def print_result(text: str) -> None:
    """Print to stdout; a full disk behind it is an `InputError`, a closed pipe stays itself."""
    try:
        click.echo(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"results cannot be written: {error.strerror}.", where="stdout") from error


class Narrator(AbstractContextManager["Narrator"]):
    """Connects the library's logger to stderr, and to a log file, while a command runs."""

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
        """Follow `-v` (information), `-vv` (details), `-q` (errors only) and `--log-file`."""
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
    """The message alone: tracebacks belong in the log file."""

    def format(self, record: logging.LogRecord) -> str:
        prefix = {logging.WARNING: "warning: ", logging.ERROR: "error: "}
        return prefix.get(record.levelno, "") + record.getMessage()
