"""Output of the commands: results on stdout, messages and progress on stderr, and a log file.

All text for people goes through this module, which shows control characters of foreign names
instead of sending them to the terminal; `tests/cli/test_printing.py` forbids other ways. Messages
of other libraries go to the log file: NumPy, SciPy and matplotlib warn through `warnings`, others
through `logging`; threads and finalisers print tracebacks. If a user must know about a problem,
vttig reports it in its own words.
"""

import logging
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..base.errors import InputError
from ..base.files.json_io import dumps
from ..base.logger import LOGGER
from ..base.shown_text import lines, one_line
from ..base.units import duration_text

if TYPE_CHECKING:
    from ..posterior.until import Progress


@dataclass
class Output:
    """Output of one command: its result and its progress bars.

    **Arguments**
    - `json`: whether `--json` was given; stdout then contains one JSON object and nothing else.
    - `quiet`: whether `-q` was given; progress bars are then hidden.
    - `verbose`: whether `-v` was given; the words of a report are then explained below it.
    """

    json: bool = False
    quiet: bool = False
    verbose: bool = False
    _object: Any = field(default=None, init=False, repr=False)

    def emit(self, obj: dict[str, Any], text: object) -> None:
        """Output the result, once per command: `obj` with `--json`, otherwise `str(text)`.

        The text is printed immediately. The object is stored until the command has succeeded,
        because stdout must contain exactly one object even if the command fails after this call.
        """
        if not self.json:
            shown = str(text)
            if self.verbose:
                from ..report.words import explained

                shown = "\n\n".join(filter(None, [shown, explained(shown)]))
            print_text(shown)
            return
        if self._object is not None:
            raise RuntimeError("a command gives one JSON object, but `emit` was called twice")
        self._object = obj

    def finish(self) -> None:
        """Print the stored object."""
        if self._object is not None:
            print_json(self._object)

    def narrate(self, sentence: str) -> None:
        """Print a sentence about the work to stderr, unless `-q` was given."""
        if not self.quiet:
            click.echo(one_line(sentence), err=True)

    def progress(self, total: int, desc: str) -> Any:
        """Return a progress bar of tqdm on stderr for use in a `with` statement.

        `.update(n)` advances it, and `.reach(done, total)` to a place of a total that may change.
        The bar is hidden by `-q` or if stderr is not a terminal. It is erased at the end.
        """
        from tqdm import tqdm

        class Bar(tqdm):
            def reach(self, done: float, total: float) -> None:
                self.total = max(done, total)
                self.update(done - self.n)

        hidden = True if self.quiet else None  # None hides the bar if stderr is not a terminal
        return Bar(total=total, desc=one_line(desc), file=sys.stderr, disable=hidden, leave=False)


def print_json(obj: dict[str, Any]) -> None:
    """Print an object to stdout as ASCII, with all control characters escaped as JSON does it.

    **Raises** as `print_text`.
    """
    # DEL is the only control character that `json` does not escape.
    _print(dumps(obj, ascii_only=True).replace("\x7f", "\\u007f"))


def print_text(text: str) -> None:
    """Print a text of several lines to stdout.

    **Raises** `InputError` if stdout cannot be written, for example on a full disk, and
    `BrokenPipeError` if it is a closed pipe.
    """
    _print(lines(text))


def _print(text: str) -> None:
    try:
        click.echo(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"results cannot be written: {error.strerror}.", where="stdout") from error


class Narrator(ExitStack):
    """Context that sends the messages of the library to stderr and, on request, to a file."""

    def __init__(self) -> None:
        super().__init__()
        self.log_file: Path | None = None
        self._stderr = logging.StreamHandler(sys.stderr)

    def __enter__(self) -> "Narrator":
        self._stderr.setFormatter(_Sentence())
        self._stderr.setLevel(logging.WARNING)
        self.callback(LOGGER.setLevel, LOGGER.level)
        LOGGER.setLevel(logging.DEBUG)
        self._add(LOGGER, self._stderr)
        return self

    def _add(self, logger: logging.Logger, handler: logging.Handler) -> None:
        logger.addHandler(handler)
        self.callback(logger.removeHandler, handler)

    def tune(self, verbose: int, quiet: bool, log_file: Path | None) -> None:
        """Apply `-v` (information), `-vv` (details), `-q` (errors only) and `--log-file`.

        **Raises** `InputError` for a log file that cannot be written.
        """
        levels = [logging.WARNING, logging.INFO, logging.DEBUG]
        self._stderr.setLevel(logging.ERROR if quiet else levels[min(verbose, 2)])
        if log_file is None:
            return
        if log_file.is_fifo():  # the system waits at a pipe until somebody reads from it
            raise InputError("the log file is a pipe and no regular file.", where=str(log_file))
        try:
            handler = logging.FileHandler(log_file, encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"the log file cannot be written: {error.strerror}.", where=str(log_file)
            ) from error
        handler.setFormatter(_LogLine("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        self.callback(handler.close)
        self._add(logging.getLogger(), handler)  # it holds records of other libraries too
        self.log_file = log_file


class _Sentence(logging.Formatter):
    """Formatter of messages without tracebacks, which only the log file contains."""

    def format(self, record: logging.LogRecord) -> str:
        prefix = {logging.WARNING: "warning: ", logging.ERROR: "error: "}
        return prefix.get(record.levelno, "") + one_line(record.getMessage())


class _LogLine(logging.Formatter):
    """Formatter of the log file: one line per message, and below it the traceback of a defect."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = one_line(record.message)
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:
        return lines(super().formatException(ei))


@contextmanager
def sampling_bar(output: Output) -> Iterator["Callable[[Progress], None]"]:
    """Show a progress bar over the steps, and yield the function that updates it.

    If a stop rule ends the chains, the total of the bar is an estimate that changes. Without a
    terminal there is a line every half minute instead of the bar.
    """
    with output.progress(1000, "sample") as bar:
        said_s = time.monotonic()

        def follow(progress: "Progress") -> None:
            nonlocal said_s
            if not sys.stderr.isatty() and time.monotonic() - said_s > 30.0:
                said_s = time.monotonic()
                left = duration_text(progress.remaining_s)
                output.narrate(f"{progress.steps} steps, {left} left or more; {progress.diagnosis}")
            ahead = (progress.remaining_s or 0.0) * progress.steps_per_s
            bar.reach(progress.steps, progress.total or max(int(progress.steps + ahead), bar.total))
            bar.set_postfix_str(progress.diagnosis)

        yield follow


@contextmanager
def library_messages_in_log() -> Iterator[None]:
    """Send warnings, log records and tracebacks of other libraries to the log, as details."""
    nothing = logging.NullHandler()  # with it Python does not print records that nobody handles
    before = warnings.showwarning, threading.excepthook, sys.unraisablehook
    logging.getLogger().addHandler(nothing)
    warnings.showwarning = _log_warning
    threading.excepthook = _log_exception
    sys.unraisablehook = _log_exception
    try:
        yield
    finally:
        warnings.showwarning, threading.excepthook, sys.unraisablehook = before
        logging.getLogger().removeHandler(nothing)


def adopt_loggers(name: str) -> None:
    """Remove the handlers of a library's loggers, because they print to the terminal.

    The records then go to the root logger and so to the log file.
    """
    for logger_name, logger in list(logging.Logger.manager.loggerDict.items()):
        if logger_name.partition(".")[0] == name and isinstance(logger, logging.Logger):
            logger.handlers.clear()
            logger.propagate = True


def _log_warning(message: Any, category: type, filename: str, lineno: int, *_: Any) -> None:
    LOGGER.debug("%s at %s:%d: %s", category.__name__, filename, lineno, message)


def _log_exception(seen: Any) -> None:
    """Write an exception that was raised in a thread or a finaliser to the log file.

    Python calls this function as `threading.excepthook` and as `sys.unraisablehook`. The arguments
    of these hooks are of different classes, but both have the fields `exc_type`, `exc_value` and
    `exc_traceback`.
    """
    LOGGER.debug(
        "an exception outside the command: %s",
        seen.exc_value,
        exc_info=(seen.exc_type, seen.exc_value, seen.exc_traceback),
    )
