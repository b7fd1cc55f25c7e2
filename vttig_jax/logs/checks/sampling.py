"""Sampling of a log: rate, jitter and gaps, steady speeds, aliasing, and the orders that it shows.

The order spectrum of the transmission error is by least squares over samples with a certain flank.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from jaxtyping import Float, Int64

from ...base.numerics.counting import pieces
from ...base.units import ARCSEC, REV
from ...pair.schema import Flank
from ..channel.channel import gaps_of
from ..encoder_log import EncoderLog
from ..motion.segments import FULL_TURN, HIGHEST, Segment, groups_of_speed, turns_of
from ..readers.column_names import ROW

_STRAYED = 16
"""Largest range beside a line of p/q counts a sample, in counts/q, over which their rounding goes
with the angle and does not average out (chosen)."""

MOST_SAMPLES = 48
"""Largest number q of samples after which rounding repeats that is searched (chosen)."""

MODELLED = 12
"""Largest number q of samples after which rounding repeats for which the rounding of a steady
driving shaft is an offset of its segment; above, counts are so coarse that it also moves the orders
(chosen)."""

SAME_SPEED = 0.03
"""Segments with a smaller relative difference of speed belong to one plateau (chosen)."""


@dataclass(frozen=True)
class Sampling:
    """Properties of the time stamps of a log; see `sampling_of` for rate and jitter.

    `gaps` is the number of intervals that `gaps_of` finds, `duplicates` the number of
    intervals of length 0. `shortest_s` and `longest_s` are the extremes of the intervals.
    """

    duration_s: float
    rate_hz: float
    jitter_s: float
    shortest_s: float
    longest_s: float
    gaps: int
    duplicates: int


@dataclass(frozen=True)
class SpeedPlateau:
    """Samples at one speed on one flank; `speed_rpm` is the signed driving speed."""

    speed_rpm: float
    flank: str
    segments: int
    samples: int


@dataclass(frozen=True)
class Commensurate:
    """Segment in which `shaft` turns by a whole number of counts in each few samples.

    `speed_rpm` is the signed speed of the driving shaft. `rounding_arcsec` is the standard
    deviation of what the rounding of the counts adds to cosine or sine of an order, as an angle of
    the driven shaft: that of all of it, q/√12, over the root of the counts over which it strays.
    A driving shaft that moves by p/q counts alone has one rounding error in a segment, an offset,
    and there it is 0. `gap_arcsec` is that of the backlash: √2 as large, or that of the mean offset
    of the segments on flank A less that on flank B. `offsets`: samples [start, stop) of these
    segments, and the standard deviation of each offset in arcsec.
    """

    shaft: str
    counts_per_sample: float
    rounding_arcsec: float
    gap_arcsec: float
    speed_rpm: float
    offsets: tuple[tuple[int, int, float], ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence on what it does to a fit, with a cure."""
        step = Fraction(self.counts_per_sample).limit_denominator(MOST_SAMPLES).denominator
        orders = f" and {self.rounding_arcsec:.2g}″ in orders" if self.rounding_arcsec else ""
        return (
            f"at {self.speed_rpm:.5g} rpm the {self.shaft} encoder passes"
            f" {self.counts_per_sample:.4f} counts a sample, a whole number"
            f"{f' in {step} samples' * (step > 1)}: its quantisation"
            f" ({self.gap_arcsec:.2g}″ in the backlash{orders}) does not average out; change the"
            " speed or the rate slightly"
        )


@dataclass(frozen=True)
class Aliased:
    """Orders of a shaft, from `order` to `highest`, that lie above half the sampling rate.

    `speed_rpm` is the driving speed at which they do so.
    """

    shaft: str
    order: int | float
    highest: int | float
    speed_rpm: float


def sampling_of(time: Float[np.ndarray, " n"]) -> Sampling:
    """Return the properties of the time stamps in s.

    Rate (from the mean interval) and jitter (standard deviation of the intervals) exclude gaps.
    """
    interval, gaps = np.diff(time), gaps_of(time)
    usual = interval[~gaps]
    return Sampling(
        duration_s=float(time[-1] - time[0]),
        rate_hz=1.0 / float(usual.mean()),
        jitter_s=float(usual.std()),
        shortest_s=float(interval.min()),
        longest_s=float(interval.max()),
        gaps=int(np.count_nonzero(gaps)),
        duplicates=int(np.count_nonzero(interval == 0)),
    )


def plateaus_of(segments: Sequence[Segment]) -> tuple[SpeedPlateau, ...]:
    """Return plateaus: segments of one flank and nearly equal speed, in the order of the log."""
    numbers = groups_of_speed(segments, SAME_SPEED)
    found = []
    for number in dict.fromkeys(numbers):
        group = [one for one, k in zip(segments, numbers, strict=True) if k == number]
        sizes = [s.stop - s.start for s in group]
        rpm = 60 * float(np.average([s.speed for s in group], weights=sizes)) / REV
        found.append(SpeedPlateau(rpm, group[0].flank, len(group), sum(sizes)))
    return tuple(found)


def commensurate(
    log: EncoderLog, segments: Sequence[Segment], most: int = MOST_SAMPLES
) -> tuple[Commensurate, ...]:
    """Return shafts with readings in whole counts that turn by p/q counts per sample, q ≤ `most`.

    The rounding of a steady shaft then repeats every q samples, and their mean is rounded to 1/q
    counts. Most steps of q samples are p counts, which noise of the encoder would prevent, and
    their mean is within 0.001 of it, or one count in the segment, which a speed nearby would
    prevent. The number of the row is no reading. Each shaft and p/q is reported once, with the
    speed of the first segment in which it is found.
    """
    findings: dict[tuple[str, float], Commensurate] = {}
    sizes = Counter[Flank]()
    for segment in segments:
        sizes[segment.flank] += segment.stop - segment.start
    sides = ("driving", log.driving, abs(float(log.ratio))), ("driven", log.driven, 1.0)
    for shaft, channel, gain in sides:
        row = log.place.columns.get(shaft) == ROW
        if row or channel is None or not np.issubdtype(channel.reading.dtype, np.integer):
            continue
        for segment in segments:
            step, samples, strayed = _locked(channel.reading[segment.start : segment.stop], most)
            if not samples:
                continue
            name, rpm = (shaft, abs(step)), 60 * segment.speed / REV
            one = findings.setdefault(name, Commensurate(*name, 0.0, 0.0, rpm))
            size = gain * channel.resolution / (samples * ARCSEC)
            size /= float(np.sqrt(12 * max(strayed, 1.0)))
            if shaft == "driving" and strayed <= 1 and samples <= MODELLED:
                # One rounding error, an offset of the segment.
                own = segment.start, segment.stop, size
                one = replace(one, offsets=(*one.offsets, own))
                size *= (segment.stop - segment.start) / sizes[segment.flank]
            elif one.rounding_arcsec:
                continue
            else:
                one, size = replace(one, rounding_arcsec=size), 2**0.5 * size
            findings[name] = replace(one, gap_arcsec=float(np.hypot(one.gap_arcsec, size)))
    return tuple(findings.values())


def _locked(reading: Int64[np.ndarray, " n"], most: int) -> tuple[float, int, float]:
    """Return p/q for the least q ≤ `most`, that q, and the range beside p/q counts a sample.

    The range is in counts/q; q is 0 for a shaft that does not turn so.
    """
    total = np.cumsum(reading - reading[0])
    for samples in range(1, min(most, len(reading) // 3) + 1):
        moved = reading[samples:] - reading[:-samples]
        mean, near = float(np.mean(moved)), 1e-3 + samples / len(moved)
        whole = round(mean)
        if samples > MODELLED and abs(whole) >= samples:
            break  # a count or more a sample: such counts are not coarse
        if whole and abs(mean - whole) < near and np.mean(moved == whole) > 2 / 3:
            sums = total[samples:] - total[:-samples]
            strayed = float(np.ptp(sums - whole * np.arange(len(sums))))
            if strayed <= _STRAYED:
                return whole / samples, samples, strayed
    return 0.0, 0, 0.0


def aliased(
    plateaus: Sequence[SpeedPlateau],
    rate_hz: float,
    orders: Mapping[str, tuple[float, Sequence[int | float]]],
) -> tuple[Aliased, ...]:
    """Return for each shaft the orders of the fit above half the sampling rate at the top speed.

    **Arguments**
    - `orders`: shaft → (its speed relative to the driving shaft, its orders in the fit).
    """
    findings, fastest = [], max((one.speed_rpm for one in plateaus), key=abs, default=0.0)
    for shaft, (relative, used) in orders.items():
        turns = abs(fastest * relative) / 60
        if above := [order for order in used if order * turns >= rate_hz / 2]:
            findings.append(Aliased(shaft, min(above), max(above), fastest))
    return tuple(findings)


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
            if turns_of(angle, on_flank) >= FULL_TURN
        ]
        if not shafts:
            continue
        terms: dict[object, tuple[str, int]] = {}
        for shaft in shafts:
            speed = log.ratio if shaft == "driven" else 1
            for order in range(1, HIGHEST + 1):
                terms.setdefault(order * speed, (shaft, order))
        candidates = list(terms.values())
        gram, highest = _gram(log, on_flank, candidates), HIGHEST
        while highest:
            chosen = [k for k, (_, order) in enumerate(candidates) if order <= highest]
            columns = [0, 1, *(c for k in chosen for c in (2 + 2 * k, 3 + 2 * k))]
            matrix, right = gram[np.ix_(columns, columns)], gram[columns, -1]
            size = np.sqrt(np.diag(matrix))
            size[size == 0] = 1.0
            matrix = matrix / np.outer(size, size)
            # At the places of a table a wave may be zero everywhere.
            seen = np.all(size[2:] ** 2 >= SEPARABLE * gram[0, 0])
            if seen and np.linalg.eigvalsh(matrix)[0] >= SEPARABLE:
                solution = np.linalg.solve(matrix, right / size) / size
                amplitudes = np.hypot(solution[2::2], solution[3::2]) / ARCSEC
                found = zip(chosen, amplitudes.tolist(), strict=True)
                lines += [OrderLine(*candidates[k], flank, arcsec) for k, arcsec in found]
                break
            highest -= 1
        if highest < HIGHEST:
            orders = f"only orders 1 to {highest}" if highest else "no orders"
            notes.append(f"flank {flank}: {orders} can be told apart over its few turns or places")
    return tuple(lines), tuple(notes)


def _gram(
    log: EncoderLog, segments: Sequence[Segment], terms: Sequence[tuple[str, int]]
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
    for part in pieces(len(index)):
        turned = {shaft: np.exp(1j * angles[shaft][index[part]]) for shaft in dict(terms)}
        powers = {shaft: np.vander(x, HIGHEST + 1, increasing=True) for shaft, x in turned.items()}
        waves = [powers[shaft][:, order] for shaft, order in terms]
        columns = [half for wave in waves for half in (np.real(wave), np.imag(wave))]
        rows = np.stack([np.ones(len(time[part])), time[part], *columns, error[part]])
        gram += rows @ rows.T
    return gram
