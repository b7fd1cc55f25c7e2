"""Errors with a message for the user and an exit code.

Every error that a user can cause is a `VttigError`. Its `message` is one sentence that says what
was found and how to correct it; its `where` names the file, line, channel or key. Wrong arguments
in Python code raise a plain `ValueError`: "Argument `x` must …, but …".
"""

from typing import ClassVar


class VttigError(Exception):
    """Base of all errors with a message for the user; the command line ends with `exit_code`."""

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, *, where: str = ""):
        super().__init__(message, where)
        self.message = message
        self.where = where

    def __str__(self) -> str:
        return f"{self.where}: {self.message}" if self.where else self.message


class UsageError(VttigError):
    """The call or the command cannot be executed in this form.

    Examples: an argument is missing or contradicts another one, a request does not suit the data,
    an optional package is not installed, or a file that would be written already exists.
    """

    exit_code = 2


class InputError(VttigError):
    """A file, table or geometry is unreadable or invalid."""

    exit_code = 3


class PairError(InputError):
    """A pair file or gear geometry is invalid; `where` names the file and the key."""


class LogError(InputError):
    """An encoder log is unreadable or invalid; `where` names the file, line or channel."""


class ScenarioError(InputError):
    """A scenario or sweep file is invalid; `where` names the file and the key."""


class NoAnswerError(VttigError):
    """The input is readable, but it does not support a reliable result."""

    exit_code = 4


class NotConvergedError(VttigError):
    """The sampler has not converged and must continue; its samples are kept."""

    exit_code = 5
