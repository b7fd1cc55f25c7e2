"""Test whether several logs are of one rig: first orders of each log and of the first log."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ....base.errors import LogError
from ....base.units import ARCSEC
from ....pair.gear_pair import Flank
from ...compress.block_rows import LogRows
from ...compress.harmonic_summary import summarise
from ...model.harmonics import Harmonic, TermPlan
from ...noise.noise_model import autoregression
from ...preliminary.alignment import Start
from ..checks import Disagreement

Phasors = dict[tuple[str, str], tuple[complex, float]]
"""(shaft, flank) → a exp(jp) of the first order, and its standard error, rad."""

_DEVIATIONS = 8.0
_SHARE = 0.2
"""First orders of two logs contradict each other if they differ by more than 20 % of the larger one
and by more than eight standard errors; chosen values."""


def disagreements(
    rows: Sequence[LogRows], terms: TermPlan, starts: Sequence[Start], *, same_zero: bool
) -> list[Disagreement]:
    """Return the differences between the first orders of each log and those of the first log.

    `starts` are the start angles of the logs. If the logs have no common zero (`same_zero` False),
    their phases cannot be compared, and only the amplitudes are compared.
    """
    first = first_orders(rows[0], terms, starts[0])
    found = []
    for log, (own, start) in enumerate(zip(rows[1:], starts[1:], strict=True), 2):
        for key, (value, std) in first_orders(own, terms, start).items():
            if key not in first:
                continue
            other, other_std = first[key]
            difference = abs(value - other) if same_zero else abs(abs(value) - abs(other))
            found.append(
                Disagreement(
                    log=log,
                    shaft=key[0],
                    flank=key[1],
                    first_arcsec=float(abs(other)) / ARCSEC,
                    this_arcsec=float(abs(value)) / ARCSEC,
                    difference_arcsec=float(difference) / ARCSEC,
                    std_arcsec=float(np.hypot(std, other_std)) / ARCSEC,
                )
            )
    return found


def refuse_different_rigs(found: Sequence[Disagreement], sources: list[str]) -> None:
    """Raise `LogError` if the first orders of the logs contradict one rig."""
    for one in found:
        largest = max(one.first_arcsec, one.this_arcsec)
        far = one.difference_arcsec > _DEVIATIONS * one.std_arcsec
        if far and one.difference_arcsec > _SHARE * largest:
            seen = (
                f"the {one.shaft} shaft has a first order of {one.this_arcsec:.3g}″ on flank"
                f" {one.flank}, but {one.first_arcsec:.3g}″ in {sources[0]}"
            )
            raise LogError(
                f"{seen} (difference {one.difference_arcsec:.3g}″ ± {one.std_arcsec:.2g}″);"
                " these are not logs of one rig, or not with the same zero: fit them one by one.",
                where=sources[one.log - 1],
            )


def first_orders(rows: LogRows, terms: TermPlan, start: Start) -> Phasors:
    """Return the first orders from one log alone, with phases relative to the first log."""
    found = phasors(rows, terms, start)
    first = ((1, 0), (0, 1))
    return {(h.shaft, flank): value for (h, flank), value in found.items() if h.term in first}


def phasors(
    rows: LogRows, terms: TermPlan, start: Start
) -> dict[tuple[Harmonic, Flank], tuple[complex, float]]:
    """Return a exp(jp) and its standard error, rad, of every harmonic from one log alone.

    `start` turns the phases p into the angles of the first log. Flanks with too few rows are left
    out.
    """
    summary = summarise([rows], terms)
    filter_ = autoregression(summary)
    result = {}
    for flank in summary.flanks:
        if flank.rows < summary.columns.width:
            continue  # too few rows to determine the orders
        factor = flank.factor(filter_)
        spread = np.linalg.inv(factor[:-1, :-1])
        values = spread @ factor[:-1, -1]
        count = max(flank.rows - len(values), 1)
        covariance = spread @ spread.T * factor[-1, -1] ** 2 / count
        for place, harmonic in enumerate(terms.free + terms.tied):
            cell = summary.columns.cosine(place)
            phasor = complex(values[cell + 1], values[cell])
            turned = phasor * np.exp(-1j * start.turned(harmonic.term))
            result[harmonic, flank.flank] = turned, _std(covariance, cell)
    return result


def _std(covariance: Float[np.ndarray, "c c"], cell: int) -> float:
    """Return the largest standard error of a phasor over all directions in the complex plane.

    `cell` is the place of its cosine coefficient in `covariance`.
    """
    pair = covariance[cell : cell + 2, cell : cell + 2]
    return float(np.sqrt(np.linalg.eigvalsh(pair)[-1]))
