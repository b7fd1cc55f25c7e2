"""Output of the commands: results on stdout, messages and progress on stderr, and a log file.

All text for people goes through this module, which shows control characters of foreign names
instead of sending them to the terminal; `tests/cli/test_printing.py` forbids other ways.
"""

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
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


class Narrator(AbstractContextManager["Narrator"]):
    """Context that sends the messages of the library to stderr and, on request, to a file."""

    def __init__(self) -> None:
        self.log_file: Path | None = None
        self._level = LOGGER.level
        self._stderr = logging.StreamHandler(sys.stderr)
        self._file: logging.Handler | None = None

    def __enter__(self) -> "Narrator":
        self._stderr.setFormatter(_Sentence())
        self._stderr.setLevel(logging.WARNING)
        LOGGER.setLevel(logging.DEBUG)
        LOGGER.addHandler(self._stderr)
        return self

    def __exit__(self, *_: object) -> None:
        LOGGER.removeHandler(self._stderr)
        if self._file is not None:
            logging.getLogger().removeHandler(self._file)
            self._file.close()
        LOGGER.setLevel(self._level)

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
        self._file = handler
        logging.getLogger().addHandler(handler)  # so that it holds records of other libraries too
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
