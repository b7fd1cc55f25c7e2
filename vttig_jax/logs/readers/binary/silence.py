"""Suppression of the warnings and messages that libraries write to the terminal."""

import logging
import sys
import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from typing import TypeVar

_Item = TypeVar("_Item")


@contextmanager
def silent(*loggers: str) -> Iterator[None]:
    """Suppress warnings, log messages and prints of libraries within a `with` block.

    `loggers` are the names of the loggers of the libraries.
    """
    # Modules of a library may have separate loggers with separate levels and handlers.
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
        sys.unraisablehook = lambda _: None  # destructors of half-open files print errors
        with warnings.catch_warnings(), redirect_stderr(StringIO()), redirect_stdout(StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook = hook
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def each_silent(items: Generator[_Item, None, None], *loggers: str) -> Generator[_Item, None, None]:
    """Yield the items of a generator that runs within `silent`; the code between them does not."""
    try:
        while True:
            with silent(*loggers):
                try:
                    item = next(items)
                except StopIteration:
                    return
            yield item
    finally:
        with silent(*loggers):
            items.close()
