"""Warnings, records and tracebacks of other libraries: in the log file, not on the terminal."""

import logging
import sys
import threading
import warnings
from typing import Any

import pytest

from vttig_jax.cli.output import adopt_loggers


class _Unraisable:
    exc_type, exc_value, exc_traceback = ValueError, ValueError("in a finaliser"), None


@pytest.fixture
def talking(monkeypatch):
    """Let `inspect` call a library that talks past the program in all ways."""

    def read(*_, **__):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            # `pytest` records warnings in its own way; this is what Python calls without it.
            warnings.showwarning("overflow in\x1b[31m square", RuntimeWarning, "numpy.py", 7)
        logging.getLogger("another.library").warning("font\x07 not found")
        thread = threading.Thread(target=lambda: 1 / 0)
        thread.start()
        thread.join()
        hook: Any = sys.unraisablehook
        hook(_Unraisable())
        raise ValueError("planted")

    monkeypatch.setattr("vttig_jax.logs.preview.preview_log", read)


def test_nothing_of_it_reaches_the_terminal_and_the_hooks_come_back(talking, vttig, tmp_path):
    def hooks():
        own = warnings.showwarning, threading.excepthook, sys.unraisablehook
        return own, list(logging.getLogger().handlers)

    before = hooks()
    code, out, err = vttig("inspect", tmp_path / "log.csv", "--log-file", tmp_path / "log.txt")
    assert code == 1 and out == "" and len(err.splitlines()) == 1
    assert hooks() == before
    kept = (tmp_path / "log.txt").read_text()
    for words in (
        r"RuntimeWarning at numpy.py:7: overflow in\x1b[31m square",
        r"font\x07 not found",
        "ZeroDivisionError",
        "in a finaliser",
        "planted",
    ):
        assert words in kept
    assert "\x1b" not in kept and "\x07" not in kept


def test_loggers_with_handlers_of_their_own_are_adopted(capsys):
    logger = logging.getLogger("talkative.part")
    logger.addHandler(logging.StreamHandler(sys.stderr))
    logger.propagate = False
    adopt_loggers("talkative")
    logger.error("to nobody")
    assert logger.propagate and logger.handlers == []
    assert capsys.readouterr().err == ""
