"""Start angles of all logs after the first: shaft angles at which their counters were zero.

An incremental counter starts at zero at any position of the shaft. If a log starts at the shaft
angles a₁ and a₂ of the first log, its harmonic n₁φ₁ + n₂φ₂ has the phase shift n₁a₁ + n₂a₂. This
shift rotates the cosine and sine columns of the rows, so the samples need not be read again. The
start angles are estimated from the orders that the log shares with the first log. They are
parameters of the fit, and the derivative by a start angle is a linear combination of the columns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.errors import NoAnswerError
from ...pair.gear_pair import Flank
from ..compress.block_rows import LogRows
from ..compress.harmonic_summary import FLANKS, Embedding, HarmonicSummary, summarise
from ..model.column_layout import ColumnLayout
from ..model.harmonics import AnyTerm, TermPlan
from ..noise.noise_model import autoregression, residual_rows
from .nuisance import own_terms

SHAFTS = ("driving", "driven")
START = {shaft: f"{shaft}_start" for shaft in SHAFTS}
"""Shaft → name of the column that only one log has: derivative of the model by its start angle."""

_GRID = 1440  # trial start angles per turn; chosen value
_MOST_STEPS = 20  # iterations; chosen value
_STILL = 0.01  # step, in standard errors, below which the iteration stops; chosen value
_LONGEST = np.radians(20.0)  # largest step, rad; chosen value

Coefficients = Mapping[Flank, Float[np.ndarray, " q"]]
"""Flank → cosine and sine coefficients of the harmonics, without the columns of single logs."""


@dataclass(frozen=True)
class Start:
    """Angles of both shafts at the zero of a log, in the angles of the first log, rad."""

    driving: float = 0.0
    driven: float = 0.0

    def turned(self, term: AnyTerm) -> float:
        """Return the phase shift of a harmonic, rad."""
        return float(term[0]) * self.driving + float(term[1]) * self.driven


def aligned(rows: Sequence[LogRows], terms: TermPlan) -> tuple[HarmonicSummary, tuple[Start, ...]]:
    """Return the summary of all logs in the angles of the first log, and the start angles.

    `rows` are the block rows of every log. The start angles of the first log are zero. A flank on
    which a single log lies tells nothing about start angles.

    **Raises** `NoAnswerError` if a log has no flank in common with the first log.
    """
    alone = [_alone(own, terms) for own in rows]
    for place, one in enumerate(alone[1:], 2):
        _require_common_flank(place, alone[0], one)
    starts = [Start(), *(_first_guess(alone[0], one, terms) for one in alone[1:])]
    silent = _of_single_logs(alone)
    model: Coefficients = {**alone[0], **silent}
    summary = summarise(rows, terms, _embeddings(rows, terms, starts, model))
    for _ in range(_MOST_STEPS):
        filter_ = autoregression(summary)
        solved = residual_rows(summary, filter_)
        found: Coefficients = {
            flank.flank: _harmonics(-row[:-1], summary.columns)
            for flank, row in zip(summary.flanks, solved, strict=True)
        }
        model = {**found, **silent}
        summary = summarise(rows, terms, _embeddings(rows, terms, starts, model))
        own = own_terms(summary, filter_)
        small = True
        for log in range(1, len(rows)):
            step = dict.fromkeys(SHAFTS, 0.0)
            for shaft in SHAFTS:
                name = f"{START[shaft]}_of_{log + 1}"
                value, std = own.estimate(name, own.names)
                step[shaft] = float(np.clip(value, -_LONGEST, _LONGEST)) if std < 1.0 else 0.0
                small &= abs(step[shaft]) <= _STILL * std
            old = starts[log]
            starts[log] = Start(old.driving + step["driving"], old.driven + step["driven"])
        summary = summarise(rows, terms, _embeddings(rows, terms, starts, model))
        if small:
            break
    return summary, tuple(starts)


def _require_common_flank(place: int, first: Coefficients, other: Coefficients) -> None:
    """Require a flank on which both logs lie; `place` counts the logs from 1."""
    if first.keys() & other.keys():
        return
    lies, first_lies = (" and ".join(one) or "none" for one in (other, first))
    raise NoAnswerError(
        f"log {place} has enough samples on flank {lies} and log 1 on flank {first_lies}, so that"
        f" their zeros cannot be compared; if both count"
        " from the same place, say so with --same-zero, or name a log that moves in both"
        " directions first"
    )


def _of_single_logs(alone: Sequence[Coefficients]) -> Coefficients:
    """Return zero coefficients for every flank on which only one of the logs lies."""
    return {
        flank: np.zeros_like(one[flank])
        for one in alone
        for flank in FLANKS
        if flank in one and sum(flank in other for other in alone) == 1
    }


def _alone(rows: LogRows, terms: TermPlan) -> Coefficients:
    """Return the coefficients of all harmonics (free and tied) from the rows of one log alone."""
    summary = summarise([rows], terms)
    solved = residual_rows(summary, autoregression(summary))
    return {
        flank.flank: _harmonics(-row[:-1], summary.columns)
        for flank, row in zip(summary.flanks, solved, strict=True)
    }


def _harmonics(
    coefficients: Float[np.ndarray, " c"], columns: ColumnLayout
) -> Float[np.ndarray, " h"]:
    return np.delete(coefficients, columns.own_slice)


def _first_guess(first: Coefficients, other: Coefficients, terms: TermPlan) -> Start:
    """Return the start angles of the log `other` at which its orders agree best with `first`.

    Each shaft is searched separately, on a grid over one turn, with the orders of this shaft only.
    """
    found = []
    for shaft in range(2):
        agreement = np.zeros(_GRID)
        angles = np.arange(_GRID) * 2 * np.pi / _GRID
        for place, term in enumerate(terms.terms):
            if term[1 - shaft] != 0:
                continue
            for flank in first.keys() & other.keys():
                product = np.conj(_phasor(first[flank], place)) * _phasor(other[flank], place)
                agreement += np.real(product * np.exp(-1j * term[shaft] * angles))
        found.append(float(angles[np.argmax(agreement)]))
    return Start(*found)


def _phasor(harmonics: Float[np.ndarray, " h"], place: int) -> complex:
    """Return a exp(jp) of a sin(kφ + p): cosine coefficient a sin p, sine coefficient a cos p."""
    return complex(harmonics[2 * place + 1], harmonics[2 * place])


def _embeddings(
    rows: Sequence[LogRows], terms: TermPlan, starts: Sequence[Start], model: Coefficients
) -> tuple[ColumnLayout, tuple[Embedding, ...]]:
    """Return the column layout of all logs, and for each log and flank its embedding matrix.

    The matrix has one row per column of the common layout and one column per column of the log. It
    rotates the harmonics by the start angles and adds the columns of the start angles, which are
    the derivatives of `model`.
    """
    extra = tuple(START.values())
    columns = ColumnLayout(
        rows[0].columns.free,
        rows[0].columns.tied,
        tuple((*log.columns.own[0], *(extra if k else ())) for k, log in enumerate(rows)),
    )
    embeddings = []
    for log, (own, start) in enumerate(zip(rows, starts, strict=True)):
        narrow = own.columns
        turn = np.eye(narrow.width)
        for place, term in enumerate(terms.terms):
            cell, angle = narrow.cosine(place), start.turned(term)
            cosine, sine = np.cos(angle), np.sin(angle)
            turn[cell : cell + 2, cell : cell + 2] = [[cosine, -sine], [sine, cosine]]
        plain = _placed(columns, log, narrow) @ turn
        by_flank: dict[Flank, np.ndarray] = {}
        for flank, harmonics in model.items():
            by_flank[flank] = plain.copy()
            for shaft in range(2 if log else 0):
                slope = _slope(harmonics, terms, columns, shaft)
                by_flank[flank][columns.index(extra[shaft], log)] = slope @ plain
        embeddings.append(by_flank)
    return columns, tuple(embeddings)


def _placed(
    columns: ColumnLayout, log: int, narrow: ColumnLayout
) -> Float[np.ndarray, "wide narrow"]:
    """Return the matrix that moves each column of one log to its place in the common layout.

    The columns of the start angles remain zero.
    """
    matrix = np.zeros((columns.width, narrow.width))
    places = [
        *range(narrow.free_width),
        *(columns.index(name, log) for name in narrow.own[0]),
        *range(columns.own_slice.stop, columns.width),
    ]
    matrix[places, np.arange(narrow.width)] = 1.0
    return matrix


def _slope(
    harmonics: Float[np.ndarray, " h"], terms: TermPlan, columns: ColumnLayout, shaft: int
) -> Float[np.ndarray, " wide"]:
    """Return the derivative of the model with respect to the angle of one shaft.

    It is a linear combination of the columns; the result contains the weight of each column.
    `shaft` is 0 for the driving shaft and 1 for the driven shaft.
    """
    slope = np.zeros(columns.width)
    for place, term in enumerate(terms.terms):
        cell = columns.cosine(place)
        slope[cell] = term[shaft] * harmonics[2 * place + 1]
        slope[cell + 1] = -term[shaft] * harmonics[2 * place]
    return slope
