"""Pointwise and simultaneous bands of a curve from its draws; the backlash map with bands."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.files.text_tables import key_values
from ...base.results import PlottedResult
from ...base.units import DEG
from ...identify.backlash import map_of
from ...kinematics.backlash_map import BacklashMap
from ...pair.gear_pair import GearPair
from .draws import SmallestGap, millimetres
from .posterior import Posterior, gap_draws

MOST_ROWS = 200_000
"""Most rows of a map whose span is not given (chosen)."""

_ROUNDING = 1e-10
"""Relative widening that keeps the draw which defines the band inside it (chosen)."""

Curve = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Band:
    """Bands from draws of a curve, in the unit of the curve.

    **Arguments**
    - `probability`: probability of both bands.
    - `centre`, `std`: mean and standard deviation of the draws, shape (n,).
    - `low`, `high`: equal-tailed interval at each point; it contains the curve at any *one* point.
    - `low_simultaneous`, `high_simultaneous`: centre ∓ `critical` · std, and at least from `low` to
      `high`; the band between them contains the *whole* curve.
    - `critical`: quantile, over the draws, of the largest deviation of a draw from the centre in
      standard deviations (sup-t).
    """

    probability: float
    centre: Curve
    std: Curve
    low: Curve
    high: Curve
    critical: float

    @property
    def low_simultaneous(self) -> Curve:
        """Lower edge of the simultaneous band, never above that of the pointwise band."""
        return np.minimum(self.centre - self.critical * self.std, self.low)

    @property
    def high_simultaneous(self) -> Curve:
        """Upper edge of the simultaneous band, never below that of the pointwise band."""
        return np.maximum(self.centre + self.critical * self.std, self.high)

    @property
    def edges(self) -> dict[str, Curve]:
        """Edges of both bands by the names of their columns, such as low95, without the unit."""
        percent = f"{100 * self.probability:.6g}"
        return {
            f"low{percent}": self.low,
            f"high{percent}": self.high,
            f"low{percent}_simultaneous": self.low_simultaneous,
            f"high{percent}_simultaneous": self.high_simultaneous,
        }

    def rows(self, of: str) -> list[tuple[str, str]]:
        """Return the report rows (label, text) of a band in rad; `of` names the whole curve."""
        percent = f"{100 * self.probability:.6g} %"
        pointwise = np.median(self.high - self.low) / 2 / DEG
        whole = np.median(self.critical * self.std) / DEG
        return [
            (f"{percent} at one angle", f"± {pointwise:.2g}° (median)"),
            (f"{percent} of the whole {of}", f"± {whole:.2g}° (median), everywhere at once"),
        ]


def band(curves: Float[np.ndarray, "m n"], probability: float = 0.95) -> Band:
    """Return the bands of a curve from its draws.

    **Arguments**
    - `curves`: m draws of the curve at n points.
    - `probability`: probability of both bands, between 0 and 1.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior import band
    >>> draws = np.random.default_rng(0).standard_normal((4000, 50))
    >>> result = band(draws)
    >>> inside = (draws >= result.low_simultaneous) & (draws <= result.high_simultaneous)
    >>> float(np.mean(inside.all(axis=1)))
    0.95

    ```
    """
    return streamed_band([curves.T], probability)


def streamed_band(blocks: Iterable[Float[np.ndarray, "_ m"]], probability: float = 0.95) -> Band:
    """Return the bands of a curve whose draws come in blocks of points, which are read once.

    A block has the shape (points, m), with the same m draws in every block. The simultaneous band
    is calibrated on the draws: its half width is the smallest multiple of the standard deviation
    for which at least `probability` of the draws lie inside at every point.
    O. H. Sørensen, M. Plagborg-Møller, J. Appl. Econometrics 34 (2019) 1 ("sup-t").

    **Raises** `ValueError` for a probability outside (0, 1), fewer than two draws, or no points.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"Argument `probability` must be between 0 and 1, but is {probability:g}.")
    tail = (1.0 - probability) / 2.0
    parts: list[list[np.ndarray]] = []
    largest: np.ndarray | float = 0.0
    for block in blocks:
        if block.shape[1] < 2:
            raise ValueError(
                f"Argument `blocks` must have at least two draws, but has {block.shape[1]}."
            )
        centre, std = block.mean(axis=1), block.std(axis=1, ddof=1)
        low, high = np.quantile(block, [tail, 1.0 - tail], axis=1)
        parts.append([centre, std, low, high])
        deviation = np.abs(block - centre[:, None])
        # Draws that are equal to the last bit have no spread and never leave the band.
        scale = np.where(std > 0, std, np.inf)[:, None]
        largest = np.maximum(largest, (deviation / scale).max(axis=0, initial=0.0))
    if not parts:
        raise ValueError("Argument `blocks` must hold at least one point, but is empty.")
    largest = np.sort(np.atleast_1d(largest))
    count = math.ceil(probability * len(largest) - 1e-9)
    critical = float(largest[count - 1]) * (1.0 + _ROUNDING)
    centre, std, low, high = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Band(probability, centre, std, low, high, critical)


@dataclass(frozen=True)
class BandedMap(PlottedResult):
    """Backlash over the driving angle with its bands.

    **Arguments**
    - `map`: order-complete map of the mean coefficients.
    - `driving_angle`: driving angles, rad, shape (n,).
    - `band`: band of the backlash, rad of the driven gear.
    - `first_order`: first-order backlash, closed form (21) + (22), rad; NaN without gear geometry.
    - `smallest`: draws of the smallest gap over the whole hunting period.
    - `step_deg`, `turns`: step and span of the grid, ° and turns of the driving shaft.
    """

    map: BacklashMap
    driving_angle: Curve
    band: Band
    first_order: Curve
    smallest: SmallestGap
    step_deg: float
    turns: float

    @property
    def columns(self) -> dict[str, Curve]:
        """Columns of its table: those of a map without bands, then the bands.

        The axial displacement that closes the backlash j is j R₂/(tan β_L + tan β_R), and its bands
        are those of j times this factor. Columns in mm are NaN without gear geometry, and axial
        columns also without taper.
        """
        radius, axial = millimetres(self.map.pair)
        ends, gap = self.band.edges, self.band.centre
        return {
            "driving_deg": self.driving_angle / DEG,
            "backlash_deg": gap / DEG,
            "backlash_mm": gap * radius,
            "axial_mm": gap * axial,
            "backlash_first_order_deg": self.first_order / DEG,
            **{f"{name}_deg": end / DEG for name, end in ends.items()},
            **{f"axial_{name}_mm": end * axial for name, end in ends.items()},
        }

    def __str__(self) -> str:
        rows = [
            ("span", f"{self.turns:.6g} driving turns in steps of {self.step_deg:g}°"),
            *self.map.coverage_rows,
            *self.band.rows("map"),
            *([("smallest gap", self.map.unknown)] if self.map.unknown else self.smallest.rows()),
        ]
        return key_values(rows, title="backlash map with bands")


def band_map(
    posterior: Posterior,
    step_deg: float = 1.0,
    turns: float | None = None,
    probability: float = 0.95,
) -> BandedMap:
    """Return the backlash map of a posterior with pointwise and simultaneous bands.

    The map is order-complete: j = TE_B − TE_A of every draw of both flanks. The simultaneous band
    contains the whole map at the grid angles. If it should also contain the map between them,
    choose a step that resolves the tooth mesh.

    **Arguments**
    - `step_deg`: step of the driving angle, °.
    - `turns`: driving turns to cover; by default the hunting period, at most 200 000 rows.
    - `probability`: probability of both bands.

    **Raises** `NoAnswerError` if the gap is not known, `ValueError` for a step or a span that is
    not positive.
    """
    for name, value in (("step_deg", step_deg), ("turns", turns)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise ValueError(f"Argument `{name}` must be positive, but is {value:g}.")
    draws = gap_draws(posterior)
    pair = posterior.fit.pair
    if turns is None:
        turns = min(float(pair.hunting_turns), MOST_ROWS * step_deg / 360.0)
    rows = math.ceil(turns * 360.0 / step_deg - 1e-9)
    angle = np.arange(rows) * step_deg * DEG
    rig = posterior.eccentricities() if isinstance(pair, GearPair) else None
    grid = map_of(posterior.fit, draws.mean_model, rig)
    bands = streamed_band(draws.chunks(angle), probability)
    return BandedMap(
        map=grid,
        driving_angle=angle,
        band=bands,
        first_order=grid.first_order_over(angle),
        smallest=draws.smallest,
        step_deg=float(step_deg),
        turns=float(turns),
    )
