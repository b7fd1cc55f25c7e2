"""Columns of a block row: free harmonics, own columns of each log, tied harmonics, y."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..settings import REGRESSORS
from .harmonics import AnyTerm

PER_RIG = ("delay", "ratio", *REGRESSORS)
"""Own columns whose coefficient is common to all logs of a rig."""


GIVEN = "model"
"""Prefix of the name of a parameter of a given flank model; a path such as ".tilt" follows."""

OFFSET = "offset"
"""Name of the first own column of a log, a column of ones."""


@dataclass(frozen=True)
class ColumnLayout:
    """Layout [free | own columns of log 1 | of log 2 | … | tied | y] of the rows of a fit.

    **Arguments**
    - `free`, `tied`: orders (n₁, n₂) of the harmonics; each has a cosine and a sine column.
    - `own`: for each log, the names of the columns that belong to it, "offset" first; these columns
      are zero in the rows of all other logs.
    """

    free: tuple[AnyTerm, ...]
    tied: tuple[AnyTerm, ...]
    own: tuple[tuple[str, ...], ...] = ((OFFSET,),)

    @property
    def width(self) -> int:
        """Number of columns, y included."""
        return self.free_width + self.own_width + 2 * len(self.tied) + 1

    @property
    def free_width(self) -> int:
        """Number of columns of free harmonics."""
        return 2 * len(self.free)

    @property
    def own_width(self) -> int:
        """Number of own columns of all logs."""
        return sum(map(len, self.own))

    @property
    def names(self) -> list[tuple[str, int]]:
        """Name and log (from 0) of every own column, in the order of the columns."""
        return [(name, log) for log, own in enumerate(self.own) for name in own]

    @property
    def own_slice(self) -> slice:
        """Slice of the own columns."""
        return slice(self.free_width, self.free_width + self.own_width)

    def index(self, name: str, log: int = 0) -> int:
        """Return the index of an own column of a log."""
        return self.free_width + self.names.index((name, log))

    def cosine(self, position: int) -> int:
        """Return the index of the cosine column of a harmonic; its sine column is the next one.

        `position` is the index of the harmonic in the list of free harmonics and then tied ones.
        """
        return 2 * position + (0 if position < len(self.free) else self.own_width)

    def of_log(self, log: int) -> "ColumnLayout":
        """Return the layout of the rows of one log alone."""
        return ColumnLayout(self.free, self.tied, (self.own[log],))

    def embedding(self, log: int) -> Float[np.ndarray, "wide narrow"]:
        """Return the matrix that maps a row of one log alone to a row of this layout."""
        narrow = self.of_log(log)
        matrix = np.zeros((self.width, narrow.width))
        places = [
            *range(self.free_width),
            *(self.index(name, log) for name in self.own[log]),
            *range(self.own_slice.stop, self.width),
        ]
        matrix[places, np.arange(narrow.width)] = 1.0
        return matrix


def is_shared(name: str) -> bool:
    """Return whether all logs of a rig share the coefficient of the own column `name`."""
    return is_given(name) or name.split("_")[0] in PER_RIG


def is_given(name: str) -> bool:
    """Return whether a column or a parameter belongs to a given flank model."""
    return name.startswith((f"{GIVEN}.", f"{GIVEN}["))


def column_of(parameter: str) -> str:
    """Return the name of the own column whose coefficient is `parameter`, without a log number."""
    return parameter if is_given(parameter) else parameter.split("_of_")[0]


def own_parameters(
    columns: ColumnLayout,
) -> tuple[tuple[str, ...], Float[np.ndarray, "own p"]]:
    """Return the parameters that are coefficients of own columns, offsets excluded.

    A coefficient that all logs share has the name of its column. If there are several logs, the
    name of any other coefficient ends with the number of its log.

    **Returns** the names of the coefficients, and a matrix with a 1 where a column (row of the
    matrix) has that coefficient.
    """
    several = len(columns.own) > 1
    entries = [entry for entry in columns.names if entry[0] != OFFSET]
    labels = [
        f"{name}_of_{log + 1}" if several and not is_shared(name) else name for name, log in entries
    ]
    names = tuple(dict.fromkeys(labels))
    matrix = np.zeros((len(entries), len(names)))
    for row, label in enumerate(labels):
        matrix[row, names.index(label)] = 1.0
    return names, matrix
