"""Silence of libraries that write warnings of their own to the terminal."""

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO


@contextmanager
def silent(*loggers: str) -> Iterator[None]:
    """Keep warnings, log messages and prints of a library off the terminal inside the block."""
    # Modules of a library may have loggers with levels and handlers of their own.
    names = [
        name
        for name in (*loggers, *logging.root.manager.loggerDict)
        if name.split(".")[0] in loggers
    ]
    levels = {name: logging.getLogger(name).level for name in names}
    hook = sys.unraisablehook
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        sys.unraisablehook = lambda _: None  # destructors of half-open files fail aloud
        with warnings.catch_warnings(), redirect_stderr(StringIO()), redirect_stdout(StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook = hook
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
