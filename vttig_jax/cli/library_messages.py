"""Redirection of messages of other libraries from the terminal to the log file.

NumPy, SciPy and matplotlib warn through `warnings`, others through `logging`; threads and
finalisers print tracebacks. If a user must know about a problem, vttig reports it in its own words.
"""

import logging
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..base.logger import LOGGER


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
