"""Parameters of a fit as linear functionals of its coefficients."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ..base.numerics.polar_spread import polar_spread, upper_limit
from ..base.units import ARCSEC, DEG, REV
from ..pair.gear_pair import Drive, GearPair
from .columns import KNOWN
from .gears import Gears, fitted_gears
from .mixed_fit import MixedFit
from .parameter import BELOW, LARGEST, OPEN, Parameter, undetermined
from .rows import Shafts

FULL_TURN = 0.99
SHAFTS = ("driving", "driven")
SIGNIFICANT = 3.0

Row = Float[np.ndarray, " columns"]


class Reader:
    """Reader of many functionals of one fit: they are asked first and told together."""

    def __init__(self, fit: MixedFit) -> None:
        self.fit = fit
        self.rows: list[Row] = []

    def ask(self, row: Row) -> int:
        """Return the number of a functional."""
        self.rows.append(row)
        return len(self.rows) - 1

    def tell(self) -> None:
        """Compute all functionals."""
        told = self.fit.posterior.told(np.stack(self.rows), moved=True)
        self.mean, self.covariance, self.freedom = told


def covered_angles(shafts: Sequence[Shafts]) -> Float[np.ndarray, " cells"]:
    """Return the middle of every degree of φ₁ that both flanks of all logs covered, rad."""
    found: dict[int, set[int]] = {1: set(), -1: set()}
    for one in shafts:
        for start, stop, side in one.runs:
            cells = np.unique(np.floor(one.driving[start:stop] / DEG).astype(int))
            found[side].update(cells.tolist())
    return (np.array(sorted(found[1] & found[-1]), float) + 0.5) * DEG


def gap_row(fit: MixedFit, angles: Float[np.ndarray, " k"]) -> Row:
    """Return the functional of the gap TE_B − TE_A, averaged over driving angles."""
    posterior = fit.posterior
    row, index = posterior.row(("gap",)), posterior.problem.index
    slope, level = fit.shafts[0].nominal
    for wave in fit.waves:
        phase = wave.driving * angles + wave.driven * (slope * angles + level)
        for part, value in (("cos", np.cos(phase)), ("sin", np.sin(phase))):
            name = (wave.shaft, wave.order, part, True, 0)
            if name in index:
                row[index[name]] = value.mean()
    return row


def shaft_turns(fit: MixedFit) -> dict[str, float]:
    """Return the turns of each shaft on the flank that covers less, of the best log."""
    sides = {run[2] for one in fit.shafts for run in one.runs}
    found = 0.0
    for one in fit.shafts:
        travel = [
            np.ptp(np.concatenate([one.driving[a:b] for a, b, s in one.runs if s == side]))
            for side in sides
            if any(s == side for _, _, s in one.runs)
        ]
        found = max(found, min(travel, default=0.0) / REV)
    return {"driving": found, "driven": found * abs(float(fit.shafts[0].ratio))}


def scalar(
    name: str, unit: str, scale: float, mean: float, variance: float, freedom: float
) -> Parameter:
    """Return a determined parameter; it is significant beyond three standard errors."""
    value, std = mean / scale, math.sqrt(max(variance, 0.0)) / scale
    half = float(stdtrit(freedom, 0.975)) * std
    significant = abs(value) >= SIGNIFICANT * std
    return Parameter(
        name,
        unit,
        value,
        std,
        value - half,
        value + half,
        True,
        significant,
        None if significant else BELOW,
    )


def polar(
    names: tuple[str, str],
    unit: str,
    scale: float,
    mean: Float[np.ndarray, "2"],
    spread: Float[np.ndarray, "2 2"],
    freedom: float,
) -> tuple[Parameter, Parameter]:
    """Return amplitude and phase of x + jy = amplitude exp(j phase)."""
    amplitude, std, phase, phase_std = polar_spread(mean / scale, spread / scale**2)
    quantile = float(stdtrit(freedom, 0.975))
    if amplitude < SIGNIFICANT * std:
        upper = upper_limit(amplitude, spread / scale**2)
        reason = "below three standard errors: an upper limit only"
        return (
            Parameter(
                names[0], unit, amplitude, std, 0.0, upper, True, reason=reason, upper95=upper
            ),
            Parameter(
                names[1],
                "deg",
                determined=True,
                reason=f"{names[0]} is below three standard errors",
            ),
        )
    return tuple(
        Parameter(name, u, v, s, v - quantile * s, v + quantile * s, True, True)
        for name, u, v, s in (
            (names[0], unit, amplitude, std),
            (names[1], "deg", phase, phase_std),
        )
    )  # pyright: ignore[reportReturnType]


def parameters_of(fit: MixedFit, pair: GearPair | Drive) -> dict[str, Parameter]:
    """Return all parameters of a fit by name, and the gap over the angles covered."""
    posterior, index = fit.posterior, fit.posterior.problem.index
    both = ("gap",) in index
    turns = shaft_turns(fit)
    side = 0 if any(run[2] > 0 for one in fit.shafts for run in one.runs) else 1
    gears = None
    if isinstance(pair, GearPair):
        gears = fitted_gears(pair, posterior, fit.waves, both=both, side=side)
    reader = Reader(fit)
    delay = reader.ask(posterior.row(("delay",)))
    gap = covered = None
    if both:
        angles = covered_angles(fit.shafts)
        gap = reader.ask(posterior.row(("gap",)))
        covered = reader.ask(gap_row(fit, angles)) if len(angles) else None
    polars: dict[str, list[int]] = {}
    if gears is None:
        for shaft in SHAFTS:
            names = [(shaft, 1, part, False, 0) for part in ("sin", "cos")]
            if names[0] in index:
                polars[shaft] = [reader.ask(posterior.row(name)) for name in names]
    else:
        for place in range(0, len(gears.values), 2):
            source = gears.relation.names[place].removesuffix("_x")
            polars[source] = [reader.ask(gears.rows[place + k]) for k in (0, 1)]
    reader.tell()
    drive = isinstance(pair, Drive)
    largest = LARGEST if drive else LARGEST | {"mm": float(pair.centre_distance_mm)}
    found: list[Parameter] = []
    for kind in ("", "_encoder"):
        for shaft in SHAFTS:
            source = f"{shaft}{kind}"
            name, unit, scale = f"{source}_arcsec", "arcsec", ARCSEC
            if not kind:
                name, unit, scale = (
                    (f"{shaft}_amplitude_arcsec", "arcsec", ARCSEC)
                    if drive
                    else (f"{shaft}_eccentricity_mm", "mm", 1.0)
                )
            names = (name, f"{source}_phase_deg")
            reason = None
            if source not in polars:
                reason = "not in the model of this log"
            elif turns[shaft] < FULL_TURN:
                reason = f"the {shaft} shaft turned only {turns[shaft]:.2g} times"
            if reason is None:
                at = polars[source]
                mean = reader.mean[at] if gears is None else gears.values[_places(gears, source)]
                spread = reader.covariance[np.ix_(at, at)]
                column = posterior.problem.columns[index[shaft, 1, "cos", False, 0]]
                if drive and column.prior == KNOWN and np.sqrt(spread.max()) > 0.5 * column.width:
                    reason = OPEN
                else:
                    freedom = float(min(reader.freedom[at]))
                    one, two = polar(names, unit, scale, mean, spread, freedom)
                    if (one.high95 or 0.0) <= largest[unit]:
                        found += [one, two]
                        continue
                    reason = OPEN
            found += [undetermined(names[0], unit, reason), undetermined(names[1], "deg", reason)]
        if not kind:
            found.append(_backlash(reader, gap, gears, turns))
    found.append(_delay(fit, reader, delay))
    if covered is not None:
        one = scalar(
            "gap_over_angles_covered",
            "deg",
            DEG,
            float(reader.mean[covered]),
            float(reader.covariance[covered, covered]),
            float(reader.freedom[covered]),
        )
        found.append(one)
    return {parameter.name: parameter for parameter in found}


def _places(gears: Gears, source: str) -> list[int]:
    return [gears.relation.names.index(f"{source}_{axis}") for axis in "xy"]


def _backlash(
    reader: Reader, gap: int | None, gears: Gears | None, turns: dict[str, float]
) -> Parameter:
    name = "constant_backlash_deg"
    if gap is None:
        return undetermined(name, "deg", "one direction: one flank alone shows no gap")
    if short := [shaft for shaft in SHAFTS if turns[shaft] < FULL_TURN]:
        reason = (
            f"the {' and the '.join(short)} shaft turned too little to tell its variable backlash"
            " from the constant one"
        )
        return undetermined(name, "deg", reason)
    moved = 0.0 if gears is None else float(gears.constants[-1])
    mean, variance = reader.mean[gap] - moved, reader.covariance[gap, gap]
    return scalar(name, "deg", DEG, float(mean), float(variance), float(reader.freedom[gap]))


def _delay(fit: MixedFit, reader: Reader, place: int) -> Parameter:
    column = fit.posterior.problem.columns[fit.posterior.problem.index["delay",]]
    mean, variance = float(reader.mean[place]), float(reader.covariance[place, place])
    if math.sqrt(variance) > 0.5 * column.width:
        reason = f"the log does not tell it: within ± {1e3 * column.width:.3g} ms as assumed"
        return undetermined("delay_s", "s", reason)
    one = scalar("delay_s", "s", 1.0, mean, variance, float(reader.freedom[place]))
    one = one.moved(fit.delay_s)
    significant = abs(one.value or 0.0) >= SIGNIFICANT * (one.std or 0.0)
    return replace(one, significant=significant, reason=None if significant else BELOW)
