"""Order spectrum of the transmission error, by least squares over samples with a certain flank."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from ...base.units import ARCSEC
from ..encoder_log import EncoderLog
from ..motion.coverage import HIGHEST, turns_of
from ..motion.segments import Segment

CHUNK = 65536  # rows per block of the Gram matrix (chosen)

SEPARABLE = 0.02
"""Orders are separable if the least eigenvalue of the normalised Gram matrix reaches this value
(chosen)."""


@dataclass(frozen=True)
class OrderLine:
    """Amplitude of one order of a shaft on one flank, as an angle of the driven shaft."""

    shaft: str
    order: int
    flank: str
    amplitude_arcsec: float


def order_spectrum(
    log: EncoderLog, segments: Sequence[Segment]
) -> tuple[tuple[OrderLine, ...], tuple[str, ...]]:
    """Return amplitudes of orders 1 … 8 of both shafts on each flank, and notes on omitted orders.

    The model of each flank is TE = c₀ + c₁ t + Σ (a cos kφ + b sin kφ). The sum is over the orders
    k of each shaft that turns at least once on this flank; φ is the angle of the shaft. Driven
    orders equal to a driving order are omitted. If the log is too short to separate neighbouring
    orders, the highest orders are omitted.
    """
    lines: list[OrderLine] = []
    notes: list[str] = []
    for flank in ("A", "B"):
        on_flank = [s for s in segments if s.flank == flank]
        shafts = [
            shaft
            for shaft, angle in (("driving", log.driving_angle), ("driven", log.driven_angle))
            if turns_of(angle, on_flank) >= 1
        ]
        if not shafts:
            continue
        amplitudes, highest = _flank_spectrum(log, on_flank, shafts)
        lines += [OrderLine(*term, flank, value) for term, value in amplitudes]
        if highest < HIGHEST:
            orders = f"only orders 1 to {highest}" if highest else "no orders"
            notes.append(f"flank {flank}: {orders} can be told apart over its few turns")
    return tuple(lines), tuple(notes)


def _flank_spectrum(
    log: EncoderLog, segments: Sequence[Segment], shafts: Sequence[str]
) -> tuple[list[tuple[tuple[str, int], float]], int]:
    speeds = {"driving": 1, "driven": log.ratio}
    terms: dict[object, tuple[str, int]] = {}
    for shaft in shafts:
        for order in range(1, HIGHEST + 1):
            terms.setdefault(order * speeds[shaft], (shaft, order))
    candidates = list(terms.values())
    gram = _gram(log, segments, shafts, candidates)
    for highest in range(HIGHEST, 0, -1):
        chosen = [k for k, (_, order) in enumerate(candidates) if order <= highest]
        columns = [0, 1, *(c for k in chosen for c in (2 + 2 * k, 3 + 2 * k))]
        matrix, right = gram[np.ix_(columns, columns)], gram[columns, -1]
        size = np.sqrt(np.diag(matrix))
        size[size == 0] = 1.0
        matrix = matrix / np.outer(size, size)
        if np.linalg.eigvalsh(matrix)[0] < SEPARABLE:
            continue
        solution = np.linalg.solve(matrix, right / size) / size
        amplitudes = np.hypot(solution[2::2], solution[3::2]) / ARCSEC
        return [(candidates[k], float(a)) for k, a in zip(chosen, amplitudes, strict=True)], highest
    return [], 0


def _gram(
    log: EncoderLog,
    segments: Sequence[Segment],
    shafts: Sequence[str],
    terms: Sequence[tuple[str, int]],
) -> Float[np.ndarray, "p p"]:
    """Return the Gram matrix of the columns 1, t, cos and sin of every term, and the TE (last)."""
    index = np.concatenate([np.arange(s.start, s.stop) for s in segments])
    time = log.time[index]
    time = (time - time.mean()) / max(np.ptp(time) / 2, 1e-300)
    error = log.transmission_error[index]
    error = error - error.mean()
    angles = {"driving": log.driving_angle, "driven": log.driven_angle}
    size = 3 + 2 * len(terms)
    gram = np.zeros((size, size))
    for start in range(0, len(index), CHUNK):
        part = slice(start, start + CHUNK)
        rows = np.empty((size, len(index[part])))
        rows[0], rows[1], rows[-1] = 1.0, time[part], error[part]
        powers = {shaft: _powers(angles[shaft][index[part]]) for shaft in shafts}
        for k, (shaft, order) in enumerate(terms):
            power = powers[shaft][order]
            rows[2 + 2 * k], rows[3 + 2 * k] = np.real(power), np.imag(power)
        gram += rows @ rows.T
    return gram


def _powers(angle: Float[np.ndarray, " n"]) -> list[Complex[np.ndarray, " n"]]:
    """Return exp(jkφ) for k = 0 … `HIGHEST` by repeated multiplication with exp(jφ)."""
    first = np.exp(1j * angle)
    powers = [np.ones_like(first)]
    for _ in range(HIGHEST):
        powers.append(powers[-1] * first)
    return powers
