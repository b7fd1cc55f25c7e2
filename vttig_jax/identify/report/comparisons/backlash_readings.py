"""Backlash readings at single driving angles: a check of a fit, or further data for it.

For a reading, gear 1 is fixed, and gear 2 is turned from one flank to the other. The reading is the
gap TE_B − TE_A at this driving angle, rad. If the readings are used as data, they update the
Gaussian estimate of the fit,

    G = P Hᵀ (H P Hᵀ + V + σ² 1)⁻¹,    p ← p + G (readings − gap),    P ← P − G H P,

with the covariance P of the parameters p, the derivative H of the gap with respect to p, the
covariance V = L Lᵀ of the gap due to the free harmonics at fixed p, and the scatter σ of the
readings. H P lies in the span of [H √P, L]. With the singular values s and the left singular
vectors Q of this matrix,

    G = P Hᵀ Q (s² + σ²)⁻¹ Qᵀ,

so that time and memory grow with the number of readings and not with its square.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax.numpy as jnp
import msgspec
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from ....base.errors import LogError, UsageError
from ....base.numerics.counting import pieces
from ....base.units import DEG
from ....kinematics.exact import ExactModel
from ....logs.readers.backlash_readings import BacklashReadings
from ....pair.eccentricities import Eccentricities
from ....pair.gear_pair import Drive, Flank, GearPair
from ...model.column_layout import OFFSET
from ...model.mounting import mounted_exact, mounting_of, offset_name
from ...model.waves import Waves, product
from ...solve.least_squares import Solution
from ...solve.sandwich import Functional
from ...solve.solved_fit import SolvedFit
from ..checks import ReadingsComparison

_UNKNOWN = 1.0
"""Standard error, rad, of a constant backlash that the logs do not determine; chosen value, much
larger than any gap."""

_FAR, _SHARE = 10.0, 0.5
"""Readings contradict a fit if the mean of (reading − predicted gap) is more than ten standard
errors and more than half of the mean gap (chosen)."""

_MOST_ITERATIONS, _SETTLED = 60, 1e-8
"""Largest number of Newton's iterations of the driven angle, and the change, rad, after which it is
exact: the next change would be about its square."""

_CHUNK = 4096  # angles whose rows are computed at once, so that they stay in cache; chosen value

_SIGNS: dict[Flank, float] = {"A": -1.0, "B": 1.0}  # of the flanks in the gap

_STEP = 1e-6
"""Step of the central differences: mm for eccentricities, rad for constant backlash and offset."""


@dataclass(frozen=True)
class PredictedGap:
    """Gap TE_B − TE_A that a fit predicts at n driving angles.

    **Arguments**
    - `value`: gap, rad.
    - `slope`: derivative of the gap with respect to every parameter.
    - `root`: matrix L, rad; L Lᵀ is the covariance of the gap due to the free harmonics.
    - `free`: flank → derivative of the gap with respect to the free coefficients of this flank.
    """

    value: Float[np.ndarray, " n"]
    slope: Float[np.ndarray, "n p"]
    root: Float[np.ndarray, "n k"]
    free: Mapping[Flank, Float[np.ndarray, "n free"]] = field(default_factory=dict)

    @property
    def functional(self) -> Functional:
        """The gap as a linear function of the parameters and the free coefficients of the fit."""
        return Functional(self.slope, self.free)

    def variance(self, covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, " n"]:
        """Return the variance of every predicted gap, rad²."""
        return np.sum(self.slope @ covariance * self.slope, axis=1) + np.sum(self.root**2, axis=1)


def gap_of_both_flanks(driving: Float[np.ndarray, " n"], solved: SolvedFit) -> PredictedGap:
    """Return the gap TE_B − TE_A with all whole orders of a fit of both flanks.

    `driving` contains the driving angles, rad. Fractional orders are left out, because their phase
    at a reading is not known.
    """
    rows, given = _rows_of_flanks(driving, solved)
    for place, harmonic in enumerate(solved.summary.terms.free):
        if not harmonic.is_whole:
            for own in rows.values():
                own[:, 2 * place : 2 * place + 2] = 0.0
    return _gap_of_rows(rows, given, solved)


def mean_gap(
    driving: Float[np.ndarray, " n"],
    solved: SolvedFit,
    times: Int[np.ndarray, " n"] | None = None,
) -> PredictedGap:
    """Return the mean of the gap TE_B − TE_A over driving angles, as one gap (n = 1).

    **Arguments**
    - `driving`: driving angles, rad.
    - `solved`: fit of both flanks.
    - `times`: how many times each angle counts in the mean; by default once.
    """
    counts = np.ones(len(driving), np.int64) if times is None else times
    width = solved.summary.columns.width - 1
    means: dict[Flank, Float[np.ndarray, "1 columns"]] = {f: np.zeros((1, width)) for f in _SIGNS}
    value = np.zeros(1)
    for part in pieces(len(driving), _CHUNK):
        waves = Waves(driving[part])
        for flank, sign in _SIGNS.items():
            rows, given = _rows(waves, solved, flank)
            means[flank] += counts[part] @ rows / counts.sum()
            value += sign * float(counts[part] @ given) / counts.sum()
    return _gap_of_rows(means, value, solved)


def gap_values(driving: Float[np.ndarray, " n"], solved: SolvedFit) -> Float[np.ndarray, " n"]:
    """Return the gap TE_B − TE_A, rad, of a fit of both flanks at driving angles, rad."""
    flanks, found = [one.flank for one in solved.summary.flanks], np.empty(len(driving))
    for part in pieces(len(driving), _CHUNK):
        waves, total = Waves(driving[part]), np.zeros(part.stop - part.start)
        for flank, sign in _SIGNS.items():
            rows, given = _rows(waves, solved, flank)
            total += sign * (rows @ solved.coefficients[flanks.index(flank)] + given)
        found[part] = total
    return found


def _rows_of_flanks(
    driving: Float[np.ndarray, " n"], solved: SolvedFit
) -> tuple[dict[Flank, Float[np.ndarray, "n columns"]], Float[np.ndarray, " n"]]:
    """Return the regressors of each flank (rows without y), and the gap of a given flank model.

    The gap, rad, is zero without a given flank model.
    """
    rows: dict[Flank, Float[np.ndarray, "n columns"]] = {}
    value, waves = [], Waves(driving)
    for flank in _SIGNS:
        rows[flank], own = _rows(waves, solved, flank)
        value.append(own)
    return rows, value[1] - value[0]


def _gap_of_rows(
    rows: Mapping[Flank, Float[np.ndarray, "n columns"]],
    given: Float[np.ndarray, " n"],
    solved: SolvedFit,
) -> PredictedGap:
    """Return the gap that follows from the regressors of both flanks and the coefficients of a fit.

    `given` is the gap of a given flank model at its last linearisation, rad; zero without one.
    """
    count, solution = len(rows["A"]), solved.solution
    value, slope = given.copy(), np.zeros((count, len(solution.names)))
    roots, of_free = [np.zeros((count, 0))], {}
    for place, (flank, factor) in enumerate(
        zip(solved.summary.flanks, solved.whitened, strict=True)
    ):
        sign = _SIGNS[flank.flank]
        own, free = rows[flank.flank], factor.free
        inverse = np.linalg.inv(factor.factor[:free, :free])
        follow = -inverse @ factor.factor[:free, free:-1]
        value += sign * own @ solved.coefficients[place]
        slope += sign * (own[:, free:] + own[:, :free] @ follow) @ solution.jacobian[place]
        roots.append(own[:, :free] @ inverse)
        of_free[flank.flank] = sign * own[:, :free]
    return PredictedGap(value, slope, np.concatenate(roots, axis=1), of_free)


def gap_of_one_flank(
    driving: Float[np.ndarray, " n"], pair: GearPair, solution: Solution, flank: Flank
) -> PredictedGap:
    """Return the gap that the exact relation predicts from a fit of one flank.

    It follows from the fitted eccentricities and the constant backlash, which must be a parameter
    of `solution`. The offset of the first log gives the position of the driven gear; see
    `mounting`. `driving` contains the driving angles, rad.
    """
    offset = next(n for n in (OFFSET, offset_name(0, 2)) if n in solution.names)
    names = ("driving_x", "driving_y", "driven_x", "driven_y", "constant_backlash", offset)
    at = {n: float(solution.values[solution.names.index(n)]) for n in names if n in solution.names}

    def gap(**moved: float) -> np.ndarray:
        now = dict.fromkeys(names, 0.0) | at | moved
        polar = [complex(now[f"{shaft}_x"], now[f"{shaft}_y"]) for shaft in ("driving", "driven")]
        rig = Eccentricities(
            abs(polar[0]),
            float(np.angle(polar[0], deg=True)),
            abs(polar[1]),
            float(np.angle(polar[1], deg=True)),
            now["constant_backlash"] / DEG,
        )
        mounting = mounting_of(
            (offset,), np.array([now[offset]]), (flank,), now["constant_backlash"]
        )
        return np.asarray(_backlash(mounted_exact(pair, rig, mounting), driving))

    slope = np.zeros((len(driving), len(solution.names)))
    for name, value in at.items():
        up, down = gap(**{name: value + _STEP}), gap(**{name: value - _STEP})
        slope[:, solution.names.index(name)] = (up - down) / (2 * _STEP)
    return PredictedGap(gap(), slope, np.zeros((len(driving), 0)))


@eqx.filter_jit
def _backlash(model: ExactModel, driving: Float[ArrayLike, " n"]):
    return model.backlash(jnp.asarray(driving))


def with_constant_backlash(solution: Solution) -> Solution:
    """Return the solution of one flank with the constant backlash added as a parameter.

    Its value is zero, with a very large standard error, until readings determine it.
    """
    count = len(solution.names)
    covariance = np.zeros((count + 1, count + 1))
    covariance[:count, :count] = solution.covariance
    covariance[count, count] = _UNKNOWN**2
    return replace(
        solution,
        names=(*solution.names, "constant_backlash"),
        values=np.append(solution.values, 0.0),
        covariance=covariance,
        determined=np.append(solution.determined, True),
        jacobian=np.pad(solution.jacobian, ((0, 0), (0, 0), (0, 1))),
    )


def updated(solution: Solution, gap: PredictedGap, readings: BacklashReadings) -> Solution:
    """Return the solution after the update by the readings; `gap` is predicted at their angles."""
    off = readings.backlash - gap.value
    scatter = scatter_of(readings, gap)
    # Scaled by the standard errors, because the parameters have different units and sizes.
    std = np.sqrt(np.diag(solution.covariance))
    scale = np.where(std > 0, std, 1.0)
    sizes, vectors = np.linalg.eigh(solution.covariance / np.outer(scale, scale))
    rooted = vectors * np.sqrt(np.maximum(sizes, 0.0))  # rounding may put a size below zero
    of_parameters = gap.slope @ (scale[:, np.newaxis] * rooted)
    spread = np.concatenate([of_parameters, gap.root], axis=1)
    span, lengths, _ = np.linalg.svd(spread, full_matrices=False)
    variances = lengths**2 + scatter**2
    inverse = np.divide(1.0, variances, out=np.zeros_like(variances), where=variances > 0)
    gain = (span * inverse @ (span.T @ (gap.slope @ solution.covariance))).T
    step = gain @ off
    covariance = solution.covariance - gain @ gap.slope @ solution.covariance
    return replace(
        solution,
        values=solution.values + step,
        covariance=(covariance + covariance.T) / 2,
        tied=solution.tied + solution.jacobian @ step,
    )


def scatter_of(readings: BacklashReadings, gap: PredictedGap) -> float:
    """Return the standard deviation of (reading − predicted gap) about its mean, rad."""
    off = readings.backlash - gap.value
    return float(np.std(off, ddof=1)) if len(off) > 1 else float(np.abs(off[0]) or _UNKNOWN)


def comparison(
    readings: BacklashReadings, gap: PredictedGap, solution: Solution, *, used: bool
) -> ReadingsComparison:
    """Compare the readings with the gap that a fit without these readings predicts, in degrees.

    `used` is only recorded: whether the readings are also data of the final fit.
    """
    off = (readings.backlash - gap.value) / DEG
    spread = np.sqrt(np.mean(gap.variance(solution.covariance))) / DEG
    return ReadingsComparison(
        source=readings.source,
        sha256=readings.sha256,
        count=len(readings),
        rms_deg=float(np.sqrt(np.mean(off**2))),
        mean_deg=float(np.mean(off)),
        scatter_deg=scatter_of(readings, gap) / DEG,
        largest_deg=float(off[np.argmax(np.abs(off))]),
        largest_at_deg=float(readings.driving_angle[np.argmax(np.abs(off))] / DEG),
        expected_std_deg=float(spread),
        used=used,
    )


def judged(compared: ReadingsComparison, gap: PredictedGap) -> ReadingsComparison:
    """Return the comparison with its field `contradicts` set; `gap` is that of the comparison.

    The field is True if the mean of (reading − predicted gap) is far from zero. This points to a
    wrong unit, a wrong zero or another rig.

    **Raises** `LogError` if readings used as data contradict the fit.
    """
    usual = float(np.mean(np.abs(gap.value))) / DEG
    doubt = compared.scatter_deg / np.sqrt(compared.count) + compared.expected_std_deg
    off = abs(compared.mean_deg)
    contradicts = bool(off > _FAR * doubt and off > _SHARE * usual)
    if compared.used and contradicts:
        raise LogError(
            f"the readings stand {compared.mean_deg:+.3g}° off the gap of the fit, which is"
            f" {usual:.3g}° on average; check their unit, or leave --use-readings out.",
            where=compared.source,
        )
    return msgspec.structs.replace(compared, contradicts=contradicts)


def require_gap(
    pair: GearPair | Drive, flanks: Sequence[str], as_data: bool, where: str, *, given: bool = False
) -> None:
    """Raise `UsageError` if the fit predicts no gap with which readings can be compared.

    Both flanks always suffice. One flank suffices only for a gear pair whose readings are data
    (`as_data`). `given` is True if a flank model of the user replaces the exact relation.
    """
    if len(flanks) == 2:
        return
    if given:
        raise UsageError(
            "backlash readings need both flanks of a fit with `model`, because only the exact"
            " relation ties one flank to the other; record both directions.",
            where=where,
        )
    if isinstance(pair, Drive):
        raise UsageError(
            "backlash readings need both flanks of a drive without gear geometry; record both"
            " directions.",
            where=where,
        )
    if not as_data:
        raise UsageError(
            "one flank alone expects no backlash to check the readings against; use them as data"
            " (--use-readings), or record both directions.",
            where=where,
        )


def _rows(
    waves: Waves, solved: SolvedFit, flank: Flank
) -> tuple[Float[np.ndarray, "n columns"], Float[np.ndarray, " n"]]:
    """Return the regressors (rows without y) of one flank at driving angles of the first log.

    `waves` holds the angles. The second array is the transmission error of a given flank model,
    rad; zero without one.
    """
    columns, ratio, driving = solved.summary.columns, float(solved.model.ratio), waves.angle
    flanks = [one.flank for one in solved.summary.flanks]
    coefficients = solved.coefficients[flanks.index(flank)]
    table = np.zeros((columns.width - 1, len(driving)))  # transposed: a regressor is contiguous
    table[columns.index(OFFSET)] = 1.0
    value = np.zeros(len(driving))
    if (given := solved.linear.model.given) is not None:
        linearised = given.on(driving, flank)
        value = linearised.value
        for slope, name in zip(linearised.slopes.T, given.names, strict=True):
            if (name, 0) in columns.names:
                table[columns.index(name)] = slope
    error, moved = value, np.inf
    # NumPy replaces the implicit model, which would be compiled for every set of orders. Orders of
    # the driving shaft do not depend on the driven angle and are computed only once.
    changing = [(columns.cosine(k), term) for k, term in enumerate(columns.free + columns.tied)]
    slopes = np.zeros_like(coefficients)
    for cell, term in changing:
        slopes[cell] = float(term[1]) * coefficients[cell + 1]
        slopes[cell + 1] = -float(term[1]) * coefficients[cell]
    both = np.stack([coefficients, slopes])
    for _ in range(_MOST_ITERATIONS):
        of_driven = Waves(ratio * driving + error)
        for cell, term in changing:
            wave = product(waves, of_driven, term)
            table[cell], table[cell + 1] = np.real(wave), np.imag(wave)
        changing = [(cell, term) for cell, term in changing if term[1]]
        if moved <= _SETTLED:
            break
        off, slope = both @ table
        step = (off + value - error) / (1 - slope)  # Newton's step for the driven angle
        error = error + step
        moved = float(np.abs(step).max(initial=0.0))
    return table.T, value
