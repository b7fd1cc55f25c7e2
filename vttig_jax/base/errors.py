"""What can go wrong, as sentences with an exit code.

Every error a user can cause is a `VttigError`: one sentence (`message`) that says what was seen
and the cure, and the file, line, channel or key it concerns (`where`). Wrong arguments in Python
code are plain `ValueError`s: "Argument `x` must …, but …".
"""

from typing import ClassVar


class VttigError(Exception):
    """Base of all errors with a sentence for the user; `exit_code` is that of the command line."""

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, *, where: str = ""):
        super().__init__(message, where)
        self.message = message
        self.where = where

    def __str__(self) -> str:
        return f"{self.where}: {self.message}" if self.where else self.message


class UsageError(VttigError):
    """The call cannot be done as asked: a missing extra, a refused overwrite."""

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
    """The input is readable but holds no trustworthy answer."""

    exit_code = 4


class NotConvergedError(VttigError):
    """A sampler that has to go on; what it has is kept."""

    exit_code = 5
