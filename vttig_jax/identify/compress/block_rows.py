"""Block rows of one log: means over blocks of the segments in certain contact, for all columns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...base.numerics.counting import nearest_whole, whole_below
from ...base.units import REV
from ...kinematics.te_curve import TECurve
from ...logs.motion.segments import Segment
from ...pair.gear_pair import Flank
from ..model.column_layout import OFFSET, ColumnLayout
from ..model.harmonics import TermPlan
from ..settings import NoiseSettings
from .block_means import block_means, block_rows, block_size
from .regressors import Drift, Regressors, trimmed

_FEWEST_ROWS = 32  # rows of the longest segment, as many as a turn has at least; chosen value

SHORT_RUN = 2048  # samples up to which the rows of runs are computed together (chosen)

_DIGITS = 1e-6
"""A residual below this share of the transmission error is rounding; see `harmonic_summary`."""


@dataclass(frozen=True, eq=False)
class BlockRun:
    """Rows of one segment, and its transmission error as block means for pictures and checks.

    `given` holds the block means of a given flank model, with the weights of the rows. This model
    was subtracted from y of the rows. `given` is None without such a model.
    """

    segment: Segment
    rows: Float[np.ndarray, "n q"]
    curve: TECurve
    given: Float[np.ndarray, " n"] | None = None

    @property
    def error(self) -> Float[np.ndarray, " n"]:
        """Block means of the TE with the weights of the rows, rad; the level is subtracted.

        A given flank model, which y does not contain, is added again.
        """
        value = self.rows[:, -1]
        return value if self.given is None else value + self.given


@dataclass(frozen=True, eq=False)
class LogRows:
    """All rows of one log.

    **Arguments**
    - `columns`: layout of the rows. - `runs`: rows of each segment.
    - `size`, `block_s`: number of samples and duration in s of a row of the fastest run.
    - `noise`: kind of the noise model.
    - `rounding`: rounding error of y due to the last digit of the readings, rad.
    - `drift`: model of the drift; the steps of its coefficients may be penalised, see `Drift`.
    """

    columns: ColumnLayout
    runs: tuple[BlockRun, ...]
    size: int
    block_s: float
    noise: NoiseSettings = NoiseSettings()
    rounding: float = 0.0
    drift: Drift = Drift()

    def runs_by_flank(self, longer_than: int = 0) -> dict[Flank, list[BlockRun]]:
        """Return flank → its runs with more than `longer_than` rows."""
        found: dict[Flank, list[BlockRun]] = {}
        for run in self.runs:
            if len(run.rows) > longer_than:
                found.setdefault(run.segment.flank, []).append(run)
        return found

    def by_flank(self, longer_than: int = 0) -> dict[Flank, list[Float[np.ndarray, "_ q"]]]:
        """Return flank → the rows of each of its runs with more than `longer_than` rows."""
        runs = self.runs_by_flank(longer_than)
        return {flank: [run.rows for run in own] for flank, own in runs.items()}

    def held(self, flank: Flank) -> Float[np.ndarray, "steps q"]:
        """Return the additional rows that penalise the steps of the drift; see `Drift.held`.

        Both flanks share the drift, so only the flank of the first run gets these rows. For the
        other flank the result has no rows.
        """
        held = self.drift.held(self.columns)
        return held if self.runs[0].segment.flank == flank else held[:0]


def turns_of(rows: Sequence[LogRows]) -> float:
    """Return the number of driving revolutions in the longest run of all logs."""
    angles = [run.curve.driving_angle for log in rows for run in log.runs]
    return max((float(np.ptp(angle)) / REV for angle in angles), default=0.0)


def block_seconds(
    channels: Sequence[Regressors],
    segments: Sequence[Sequence[Segment]],
    terms: TermPlan,
    given_order: float = 0.0,
) -> float:
    """Return the duration of a block in s.

    It is the shortest of the durations that the logs require, so that all logs share one noise
    model. `given_order` is the highest order of a given flank model, 0 without one.
    """
    return min(
        c.sample_s * samples_per_row(c.driving, own, terms, given_order)
        for c, own in zip(channels, segments, strict=True)
        if own
    )


def samples_per_row(
    driving: Float[np.ndarray, " n"],
    segments: Sequence[Segment],
    terms: TermPlan,
    given_order: float = 0.0,
) -> int:
    """Return the number of samples per block row that the segments of one log require.

    The longest segment has at least `_FEWEST_ROWS` rows even if it is a small part of a turn.
    """
    highest = float(max((terms.frequency(term) for term in terms.terms), default=1))
    longest = max(segment.stop - segment.start for segment in segments)
    size = block_size(_samples_per_turn(driving, segments), highest, given_order)
    return min(size, max(1, longest // _FEWEST_ROWS))


def log_rows(
    channels: Regressors,
    segments: Sequence[Segment],
    terms: TermPlan,
    block_s: float,
    noise: NoiseSettings = NoiseSettings(),
    fastest: float = 0.0,
) -> LogRows:
    """Return the block rows of the given segments of a log.

    A row lasts `block_s`, in s. If the noise is stationary in angle, every row instead covers the
    angle that a segment with the speed `fastest`, in rad/s, covers in `block_s`.
    """
    columns = ColumnLayout(
        tuple(h.term for h in terms.free),
        tuple(h.term for h in terms.tied),
        ((OFFSET, *channels.own, *channels.slopes),),
    )
    shortest = max(1, nearest_whole(block_s / channels.sample_s))
    found: list[tuple[int, Segment]] = []
    together: dict[tuple[Flank, int, int], list[int]] = {}
    for whole in segments:
        segment = trimmed(whole, channels)
        size = shortest
        if noise.stationary_in == "angle" and whole.speed:
            size = max(1, nearest_whole(shortest * fastest / abs(whole.speed)))
        samples = segment.stop - segment.start
        if samples < size:
            continue
        alone = len(found) if samples > SHORT_RUN else -1
        together.setdefault((segment.flank, size, alone), []).append(len(found))
        found.append((size, segment))
    made: dict[int, BlockRun] = {}
    for (_, size, _), places in together.items():
        of_group = [found[place][1] for place in places]
        made |= zip(places, _runs_of(channels, columns, of_group, size), strict=True)
    runs = [made[place] for place in range(len(found))]
    row_s = shortest * channels.sample_s
    return LogRows(
        columns=columns,
        runs=tuple(runs),
        size=shortest,
        block_s=row_s,
        noise=noise,
        rounding=float(np.hypot(channels.log.rounding, _rounding_of_given(runs))),
        drift=channels.drift,
    )


def _runs_of(
    channels: Regressors, columns: ColumnLayout, segments: Sequence[Segment], size: int
) -> list[BlockRun]:
    """Return the rows of segments on one flank, with `size` samples a row.

    The rows of several segments are computed in one array, because a log may have hundreds of short
    ones. An incomplete last block of a segment is left out.
    """
    flank = segments[0].flank
    blocks = [(segment.stop - segment.start) // size for segment in segments]
    starts = [segment.start for segment in segments]
    part: slice | Int[np.ndarray, " m"] = slice(starts[0], starts[0] + blocks[0] * size)
    if len(segments) > 1:
        ends = zip(starts, blocks, strict=True)
        part = np.concatenate([np.arange(start, start + n * size) for start, n in ends])
    driving, error = channels.driving[part], channels.error[flank][part]
    weight = None if channels.weight is None else channels.weight[part]
    rows = block_rows(
        columns,
        size=size,
        driving_angle=driving,
        driven_angle=channels.driven[part],
        own=(values[part] for values in channels.own_on(flank).values()),
        error=error,
        weight=weight,
    )
    given = channels.given[flank].value[part] if channels.given else None
    seen = block_means(error, size) + channels.level
    if given is not None:
        seen += block_means(given, size)
        given = _weighted_means(given, size, weight)
    angles, times = block_means(driving, size), block_means(channels.time[part], size)
    runs, stop = [], 0
    for segment, count in zip(segments, blocks, strict=True):
        own, stop = slice(stop, stop + count), stop + count
        curve = TECurve(flank, angles[own], seen[own], times[own])
        runs.append(BlockRun(segment, rows[own], curve, None if given is None else given[own]))
    return runs


def _weighted_means(
    values: Float[np.ndarray, " n"], size: int, weight: Float[np.ndarray, " n"] | None
) -> Float[np.ndarray, " blocks"]:
    """Return block means with the weights of the rows: mean(w x)/√mean(w); see `block_rows`."""
    if weight is None:
        return block_means(values, size)
    share = block_means(weight, size)
    return block_means(weight * values, size) / np.sqrt(np.where(share > 0, share, 1.0))


def _rounding_of_given(runs: Sequence[BlockRun]) -> float:
    """Return the rounding error of a given flank model, rad: 1e-6 of its rms value.

    Residuals of that size count as rounding in every fit, because no encoder resolves them.
    """
    values = [run.given for run in runs if run.given is not None]
    if not values:
        return 0.0
    return _DIGITS * float(np.sqrt(np.mean(np.concatenate(values) ** 2)))


def _samples_per_turn(driving: Float[np.ndarray, " n"], segments: Sequence[Segment]) -> float:
    """Return the samples per driving turn at the highest speed.

    The speed is averaged over windows that last a 64th of a turn at mean speed. The highest speed
    is used so that no block covers more of a cycle than planned.
    """
    travelled = sum(abs(driving[s.stop - 1] - driving[s.start]) for s in segments)
    samples = sum(s.stop - s.start for s in segments)
    window = max(1, whole_below(samples * REV / max(travelled, 1e-9) / 64))
    steps = [np.abs(np.diff(driving[s.start : s.stop : window])) for s in segments]
    fastest = max((float(step.max(initial=0.0)) for step in steps), default=0.0)
    return window * REV / max(fastest, 1e-9)
