"""Result codes of the fits of a batch, and a sentence on the meaning of each code."""

from enum import IntEnum


class Code(IntEnum):
    """Result of the fit of one log: OK, or why its parameters are missing or not reliable."""

    OK = 0
    EMPTY = 1
    NOT_FINITE = 2
    NO_ROOM = 3
    TOO_FEW_ROWS = 4
    UNDETERMINED = 5
    NOT_CONVERGED = 6
    MORE_LAGS = 7
    LONG_MEMORY = 8
    REFUSED = 9
    NEEDS_FIT = 10

    @property
    def reason(self) -> str:
        """Sentence that explains the code; "" for OK."""
        return _REASONS[self]


_REASONS = {
    Code.OK: "",
    Code.EMPTY: "it has no samples on a flank",
    Code.NOT_FINITE: "a used sample is not a number; remove it or correct the reading",
    Code.NO_ROOM: "it has more runs, rows or samples per row than the program has room for",
    Code.TOO_FEW_ROWS: "its averaged samples are too few for the coefficients and their noise;"
    " record more turns, or list fewer orders",
    Code.UNDETERMINED: "its samples leave a combination of the parameters open",
    Code.NOT_CONVERGED: "its fit did not converge",
    Code.MORE_LAGS: "its noise is correlated over more lags than the program has",
    Code.LONG_MEMORY: "its noise is correlated over a twentieth of a run, so that it cannot be told"
    " from slow structure; fit it alone with vttig_jax.fit",
    Code.REFUSED: "it was refused before the fit",
    Code.NEEDS_FIT: "the model of a batch does not hold for it; fit it alone with vttig_jax.fit",
}
