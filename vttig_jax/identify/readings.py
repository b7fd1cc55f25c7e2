"""Backlash readings at single driving angles: a check of a fit, or further data for it.

For a reading, gear 1 is held and gear 2 is turned from one flank to the other: r = TE_B − TE_A at
one driving angle, plus a scatter σ. As data the readings condition the coefficients b of the fit,

    K = P Cᵀ (C P Cᵀ + σ² 1)⁻¹,    b ← b + K (r − C b),    P ← P − K C P.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ..base.errors import UsageError
from ..base.files.text_tables import key_values, text_table
from ..base.numerics.polar_spread import polar_spread
from ..base.units import DEG, REV
from ..logs.channel.unwrap import step_of
from ..logs.readers.backlash_readings import BacklashReadings
from ..model.columns import GAP, told_waves, waves_of
from ..model.functionals import Readings
from ..model.mixed_fit import CLEAR, MixedFit
from ..model.parameters import FULL_TURN, gap_row
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import HarmonicOrders
from .fit_settings import FitSettings
from .records import ReadingsComparison, Record

_SPAN = 1e-9


def _rows(core: MixedFit, readings: BacklashReadings) -> Float[np.ndarray, "n columns"]:
    if GAP not in core.posterior.problem.index:
        raise UsageError(
            "backlash readings compare with the gap between two flanks, but the log has one; record"
            " both directions.",
            where=readings.source,
        )
    angles = readings.driving_angle
    return np.stack([gap_row(core, angles[k : k + 1]) for k in range(len(angles))])


def compared(
    core: MixedFit, readings: BacklashReadings, settings: FitSettings
) -> ReadingsComparison:
    """Compare readings with the gap that a fit predicts at their angles."""
    rows = _rows(core, readings)
    mean = rows.mean(0)
    off = (readings.backlash - rows @ core.posterior.moved) / DEG
    worst = int(np.argmax(np.abs(off)))
    return ReadingsComparison(
        source=readings.source,
        sha256=readings.sha256,
        count=len(off),
        rms_deg=float(np.sqrt(np.mean(off**2))),
        mean_deg=float(off.mean()),
        scatter_deg=float(off.std()),
        largest_deg=float(off[worst]),
        largest_at_deg=float(readings.driving_angle[worst]) / DEG,
        expected_std_deg=core.posterior.one(mean, moved=True).std / DEG,
        used=settings.use_readings,
    )


def updated(core: MixedFit, readings: BacklashReadings) -> MixedFit:
    """Return the fit with the readings as further data; their scatter is that about the fit."""
    posterior, problem = core.posterior, core.posterior.problem
    rows = np.zeros((len(readings.backlash), len(posterior.at.beta)))
    rows[:, : len(problem.columns)] = _rows(core, readings) * np.diag(problem.natural)
    start = np.zeros(len(posterior.at.beta))
    start[: len(problem.columns)] = problem.start
    values = (readings.backlash - rows @ start) / problem.unit
    off = problem.unit * (values - rows @ np.asarray(posterior.at.beta))
    scatter = max(float(np.var(off)), _SPAN * float(np.mean(readings.backlash**2)))
    measured = Readings(rows, values, scatter / problem.unit**2)
    return replace(core, posterior=posterior.with_readings(measured))


class GapAt(Record, frozen=True):
    """Fitted backlash at a driving angle."""

    driving_deg: float
    backlash_deg: float


class GapOrder(Record, frozen=True):
    """Harmonic a sin(k φ_shaft + p) of the backlash, ° of the driven shaft."""

    shaft: str
    order: int | float
    amplitude_deg: float
    std_deg: float
    phase_deg: float
    significant: bool


class ReadingsFit(Record, frozen=True):
    """Backlash from readings alone: its mean and orders over the driving angle.

    **Arguments**
    - `backlash_deg`: mean over the turn. - `std_deg`, `low95_deg`, `high95_deg`: its standard error
      and interval, None for a single reading.
    - `scatter_deg`: standard deviation of a reading. - `orders`: those that the places tell.
    - `least`, `largest`: of the fitted backlash between the first and the last place.
    """

    source: str
    sha256: str
    count: int
    backlash_deg: float
    std_deg: float | None
    low95_deg: float | None
    high95_deg: float | None
    scatter_deg: float | None
    orders: tuple[GapOrder, ...]
    least: GapAt
    largest: GapAt

    def to_json(self) -> dict:
        """Return the object of schema `vttig.readings/1`."""
        return {"schema": "vttig.readings/1", **super().to_json()}

    def __str__(self) -> str:
        sure = "" if self.std_deg is None else f" ± {self.std_deg:.2g}°"
        interval = f" (95 % interval {self.low95_deg:.5f} … {self.high95_deg:.5f}°)" if sure else ""
        rows = [
            ("readings", f"{self.count}"),
            ("backlash", f"{self.backlash_deg:.5f}°{sure}{interval}"),
            *(
                (name, f"{at.backlash_deg:.5f}° at {at.driving_deg:.5g}°")
                for name, at in (("least", self.least), ("largest", self.largest))
            ),
            ("scatter", "unknown" if self.scatter_deg is None else f"{self.scatter_deg:.2g}°"),
        ]
        orders = []
        for one in self.orders:
            size = f"{one.amplitude_deg:.5f} ± {one.std_deg:.2g}"
            phase = f"{one.phase_deg:.4g}" if one.significant else "not above its noise"
            orders.append([f"{one.shaft} {one.order:g}", size, phase])
        table = text_table(orders, ["order", "amplitude [°]", "phase [°]"])
        return "\n\n".join([key_values(rows, title=self.source), *[table] * bool(self.orders)])


def fit_readings(
    readings: BacklashReadings, pair: GearPair | Drive, orders: HarmonicOrders | None = None
) -> ReadingsFit:
    """Fit backlash readings at single driving angles, without a log.

    The readings are c + Σ (a cos kφ + b sin kφ) and white noise, with the orders of both shafts
    that their places tell; half of the readings are left for the noise. Where places repeat, so
    does the rounding of the readings. At i = 1 orders count as those of the driving shaft.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.identify.readings import fit_readings
    >>> from vttig_jax.logs import BacklashReadings
    >>> from vttig_jax.pair import parse_pair_spec
    >>> from vttig_jax.pair.gear_pair import pair_from_spec
    >>> angle = np.arange(0.0, 360.0, 15.0)
    >>> gap = 0.1 + 0.02 * np.sin(np.radians(angle)) + 1e-4 * np.cos(90.0 * angle)
    >>> drive = pair_from_spec(parse_pair_spec({"drive": {"ratio": "1/5"}}))
    >>> found = fit_readings(BacklashReadings.from_arrays(angle, gap), drive)
    >>> [round(x, 3) for x in (found.backlash_deg, found.orders[0].amplitude_deg)]
    [0.1, 0.02]

    ```
    """
    angle, gap, count = readings.driving_angle, readings.backlash / DEG, len(readings)
    ratio = float(pair.ratio)
    # n places 360°/n apart are a turn; an order of a shaft that made a part of one is a slope.
    steps = len(np.unique(np.round(angle, 6)))
    turns = np.ptp(angle) / REV * steps / max(steps - 1, 1)
    whole = {"driving": turns >= FULL_TURN, "driven": turns * abs(ratio) >= FULL_TURN}
    waves = [w for w in waves_of(pair, orders or pair.fit) if whole.get(w.shaft)]
    kept = told_waves(angle, waves, ratio)

    def design(at: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n p"]:
        phase = np.outer(at, [wave.cycles(ratio) for wave in kept])
        return np.hstack([np.ones((len(at), 1)), np.sin(phase), np.cos(phase)])

    columns = design(angle)
    found = np.linalg.lstsq(columns, gap, rcond=None)[0]
    left, free = gap - columns @ found, count - columns.shape[1]
    scatter = float(np.sqrt(left @ left / free)) if free else None
    inverse = np.linalg.inv(columns.T @ columns)
    # Readings that repeat at a place have one error of rounding, of variance q²/12, in common, and
    # where they change by few steps it lies in the mean and in low orders.
    rounding = step_of(gap) ** 2 / 12
    shared = inverse @ columns.T @ (np.round(angle, 6)[:, None] == np.unique(np.round(angle, 6)))
    spread = inverse * max((scatter or 0.0) ** 2 - rounding, 0.0) + rounding * shared @ shared.T
    spread += 6 / steps * rounding * np.eye(len(inverse))
    rows = []
    for k, wave in enumerate(kept, 1):
        at = [k, k + len(kept)]
        size, std, phase, _ = polar_spread(found[at], spread[np.ix_(at, at)])
        significant = size >= CLEAR * std
        rows.append(GapOrder(wave.shaft, wave.order, size, std, phase, significant))
    step = max(DEG, float(np.ptp(angle)) / 1e4)
    grid = np.append(np.arange(angle.min(), angle.max(), step), angle.max())
    curve = design(grid) @ found
    ends = [GapAt(float(grid[k] / DEG), float(curve[k])) for k in (curve.argmin(), curve.argmax())]
    mean, std, low, high = float(found[0]), None, None, None
    if scatter is not None:
        std = float(np.sqrt(spread[0, 0]))
        half = float(stdtrit(free, 0.975)) * std
        low, high = mean - half, mean + half
    source = readings.source, readings.sha256
    return ReadingsFit(*source, count, mean, std, low, high, scatter, tuple(rows), *ends)
