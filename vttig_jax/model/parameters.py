"""Parameters of a fit as functionals of its coefficients.

Every number of a fit is a functional c b + a of the coefficients b. `quantities_of` lists them in
Cartesian form, and `parameters_of` says them as amplitudes, phases, gap and delay, or why the logs
do not tell one.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ..base.numerics.polar_spread import polar_spread, upper_limit
from ..base.units import ARCSEC, DEG, duration_text
from ..logs.motion.segments import FULL_TURN
from ..pair.gear_pair import Drive, GearPair
from .columns import DELAY, GAP, KNOWN, RATIO, TORQUE, ColumnName
from .functionals import Posterior
from .gears import KINDS, Gears, fitted_gears
from .mixed_fit import MixedFit
from .parameter import BELOW, LARGEST, OPEN, UPPER, Parameter
from .rows import SHAFTS, RowName

SIGNIFICANT = 3.0
TOLD = 0.5
"""Largest standard deviation of a number that the logs tell, in those of its prior."""

Row = Float[np.ndarray, " columns"]
Angles = Float[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class Quantities:
    """Numbers of a fit: `rows` @ coefficients + `shift`, where the rows act on moved coefficients.

    **Arguments**
    - `names`: such as "driving_x", "driving_encoder_y", "constant_backlash", "delay", "offset",
      "gap_over_angles_covered"; mm for eccentricities of gears, s for the delay, else rad.
    - `gears`: eccentricities that the first orders follow from; None for a drive.
    """

    posterior: Posterior
    names: tuple[str, ...]
    rows: Float[np.ndarray, "n columns"]
    shift: Float[np.ndarray, " n"]
    gears: Gears | None

    @cached_property
    def _told(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.posterior.told(self.rows, moved=True)

    @property
    def mean(self) -> Float[np.ndarray, " n"]:
        """Means of the numbers."""
        return self._told[0] + self.shift

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the numbers."""
        return self._told[1]

    @property
    def freedom(self) -> Float[np.ndarray, " n"]:
        """Student degrees of freedom of the numbers."""
        return self._told[2]

    def joined(
        self, names: Sequence[str], rows: Iterable[Row], shift: Sequence[float] | np.ndarray
    ) -> "Quantities":
        """Return the numbers with further ones."""
        shift, whole = np.append(self.shift, shift), np.stack([*self.rows, *rows])
        return replace(self, names=(*self.names, *names), rows=whole, shift=shift)

    def at(self, *names: str) -> list[int]:
        """Return the places of names."""
        return [self.names.index(name) for name in names]

    def std(self, name: str) -> float:
        """Return the standard deviation of a number."""
        return math.sqrt(max(float(self.covariance[*self.at(name, name)]), 0.0))

    def scalar(self, name: str, unit: str, scale: float = 1.0, *, label: str = "") -> Parameter:
        """Return a number in a unit of `scale`, as a determined parameter.

        It is significant beyond three standard errors. `label` names it in place of its own name.
        """
        (at,) = self.at(name)
        value, freedom = float(self.mean[at]) / scale, float(self.freedom[at])
        std = self.std(name) / scale
        half = float(stdtrit(freedom, 0.975)) * std
        told = value, std, value - half, value + half, True
        if abs(value) >= SIGNIFICANT * std:
            return Parameter(label or name, unit, *told, True, freedom=freedom)
        return Parameter(label or name, unit, *told, reason=BELOW, freedom=freedom)


def gap_row(fit: MixedFit, angles: Angles) -> Row:
    """Return the functional of the gap TE_B − TE_A, averaged over angles of the first log."""
    posterior = fit.posterior
    row, index = posterior.row(GAP), posterior.problem.index
    slope, level = fit.scope.nominal
    for wave in fit.waves:
        phase = wave.driving * angles + wave.driven * (slope * angles + level)
        for part, value in (("cos", np.mean(np.cos(phase))), ("sin", np.mean(np.sin(phase)))):
            if (name := ColumnName(wave.row(part), 0, differs=True)) in index:
                row[index[name]] = value
    return row


def quantities_of(
    fit: MixedFit, pair: GearPair | Drive, kinds: Sequence[str] = KINDS
) -> Quantities:
    """Return the numbers of a fit; gears or encoders that are not in `kinds` are perfect."""
    posterior, index, scope = fit.posterior, fit.posterior.problem.index, fit.scope
    both = GAP in index
    told: dict[str, tuple[Row, float]] = {}
    found = fitted_gears(pair, fit, kinds) if isinstance(pair, GearPair) else None
    if found is not None:
        for name, value, row in zip(found.relation.names, found.values, found.rows, strict=True):
            told[name] = row, float(value - row @ posterior.moved)
    elif isinstance(pair, Drive):
        # Without gears the first order is that of the encoder, E₂ sin(φ₂ + ε₂) − i E₁ sin(φ₁ + ε₁).
        for shaft, gain in zip(SHAFTS, (-1 / scope.ratio if kinds[0] else 1.0, 1.0), strict=True):
            for axis, part in (("x", "sin"), ("y", "cos")):
                if (name := ColumnName(RowName(shaft, 1, part), 0)) in index:
                    told[f"{shaft}{kinds[0]}_{axis}"] = gain * posterior.row(name), 0.0
    late = posterior.row(DELAY) if DELAY in index else None
    if both:
        constant = 0.0 if found is None else float(found.constants[-1])
        told["constant_backlash"] = posterior.row(GAP), -constant
        if len(scope.covered):
            covered = gap_row(fit, scope.covered)
            told["gap_over_angles_covered"] = covered, 0.0
            if late is not None:
                gain = abs(scope.ratio) * sum(scope.speeds)
                told["backlash_plus_delay"] = covered + gain * late, gain * fit.delay_s
    for name, by in ((DELAY, fit.delay_s), (TORQUE, 0.0), (RATIO, scope.ratio)):
        if name in index:
            told[str(name)] = posterior.row(name), by
    # Without orders, gap, delay and ratio there is no number, or only those of an own flank model.
    whole = len(told), len(posterior.problem.columns)
    rows = np.reshape([row for row, _ in told.values()], whole)
    shift = np.array([by for _, by in told.values()])
    return Quantities(posterior, tuple(told), rows, shift, found)


def polar(
    names: tuple[str, str],
    unit: str,
    scale: float,
    mean: Float[np.ndarray, "2"],
    spread: Float[np.ndarray, "2 2"],
    freedom: float,
) -> list[Parameter]:
    """Return amplitude and phase of x + jy = amplitude exp(j phase)."""
    amplitude, std, phase, phase_std = polar_spread(mean / scale, spread / scale**2)
    quantile = float(stdtrit(freedom, 0.975))
    if amplitude < SIGNIFICANT * std:
        upper = upper_limit(amplitude, spread / scale**2)
        more = {"reason": UPPER, "upper95": upper}
        one = Parameter(names[0], unit, amplitude, std, 0.0, upper, True, **more)
        reason = f"{names[0]} is below three standard errors"
        return [one, Parameter(names[1], "deg", determined=True, reason=reason)]
    return [
        Parameter(name, u, v, s, v - quantile * s, v + quantile * s, True, True, freedom=freedom)
        for name, u, v, s in ((names[0], unit, amplitude, std), (names[1], "deg", phase, phase_std))
    ]


ONE_DIRECTION = "one direction: encoder and gear eccentricity are one number"
PERFECT = "not fitted: the encoders are taken to be perfect"
PERFECT_GEARS = "not fitted: the gears are taken to be perfect"
NO_GEOMETRY = "a drive has no gear geometry that could tell encoder from gear"
LEFT_OUT = (PERFECT, PERFECT_GEARS, NO_GEOMETRY)
"""Reasons of parameters that the settings or the pair exclude."""


def parameters_of(
    fit: MixedFit,
    pair: GearPair | Drive,
    told: Quantities | None = None,
    kinds: Sequence[str] = KINDS,
) -> dict[str, Parameter]:
    """Return all parameters of a fit by name, and the gap over the angles covered."""
    told = quantities_of(fit, pair, kinds) if told is None else told
    drive = isinstance(pair, Drive)
    largest = LARGEST if drive else LARGEST | {"mm": float(pair.centre_distance_mm)}
    found: list[Parameter] = []
    for kind in KINDS:
        for shaft in SHAFTS:
            source = f"{shaft}{kind}"
            name, unit, scale = f"{source}_arcsec", "arcsec", ARCSEC
            if not kind and drive:
                name = f"{shaft}_amplitude_arcsec"
            elif not kind:
                name, unit, scale = f"{shaft}_eccentricity_mm", "mm", 1.0
            names = (name, f"{source}_phase_deg")
            reason = _reason(fit, told, shaft, kind, kinds, drive=drive)
            both: list[Parameter] = []
            if reason is None:
                at = told.at(f"{source}_x", f"{source}_y")
                spread, freedom = told.covariance[np.ix_(at, at)], float(min(told.freedom[at]))
                both = polar(names, unit, scale, told.mean[at], spread, freedom)
                reason = OPEN if (both[0].high95 or 0.0) > largest[unit] else None
            if reason is not None:
                units = zip(names, (unit, "deg"), strict=True)
                both = [Parameter(name, its, reason=reason) for name, its in units]
            found += both
        if not kind:
            found.append(_backlash(fit, told))
    found.append(_delay(fit, told))
    if "gap_over_angles_covered" in told.names:
        found.append(told.scalar("gap_over_angles_covered", "deg", DEG))
        if "backlash_plus_delay" in told.names and not found[-2].determined:
            label = "backlash_plus_delay_deg"
            found.append(told.scalar("backlash_plus_delay", "deg", DEG, label=label))
    return {parameter.name: parameter for parameter in found}


def _reason(
    fit: MixedFit, told: Quantities, shaft: str, kind: str, kinds: Sequence[str], *, drive: bool
) -> str | None:
    """Return why the first order of a shaft or of its encoder is no parameter, or None."""
    source, index = f"{shaft}{kind}", fit.posterior.problem.index
    beside = kind != KINDS[0] and KINDS[0] in kinds  # an encoder beside its gear
    if beside and drive:
        return NO_GEOMETRY
    if kind not in kinds:
        return PERFECT if kind else PERFECT_GEARS
    if beside and GAP not in index:
        return ONE_DIRECTION
    if (first := ColumnName(RowName(shaft, 1, "cos"), 0)) not in index:
        return f"the first order of the {shaft} shaft is not in the model of this log"
    if (turns := fit.scope.turns[shaft]) < FULL_TURN:
        return f"the {shaft} shaft turned only {turns:.2g} times"
    if f"{source}_x" not in told.names:
        return OPEN
    column = fit.posterior.problem.columns[index[first]]
    at = told.at(f"{source}_x", f"{source}_y")
    std = float(np.sqrt(np.diag(told.covariance)[at].max()))
    if drive and column.prior == KNOWN and std > TOLD * column.width:
        return f"the log does not tell it: within ± {column.width / ARCSEC:.3g}″ as assumed"
    return None


def _backlash(fit: MixedFit, told: Quantities) -> Parameter:
    name = "constant_backlash_deg"
    if "constant_backlash" not in told.names:
        return Parameter(name, "deg", reason="one direction: one flank alone shows no gap")
    if short := [shaft for shaft in SHAFTS if fit.scope.turns[shaft] < FULL_TURN]:
        reason = (
            f"the {' and the '.join(short)} shaft turned too little to tell its variable backlash"
            " from the constant one"
        )
        return Parameter(name, "deg", reason=reason)
    return told.scalar("constant_backlash", "deg", DEG, label=name)


def _delay(fit: MixedFit, told: Quantities) -> Parameter:
    reason, columns = "", {column.name: column for column in fit.posterior.problem.columns}
    if all(one.still for one in fit.shafts):
        reason = "readings at standstill have no delay"
    elif "delay" not in told.names:
        reason = f"not fitted: {1e3 * fit.delay_s:.4g} ms, as stated"
    elif not fit.settled:
        reason = "the search ended before it stood still"
    elif told.std("delay") > TOLD * (width := columns[DELAY].width):
        reason = f"the log does not tell it: within ± {duration_text(width)} as assumed"
    if reason:
        return Parameter("delay_s", "s", reason=reason)
    return told.scalar("delay", "s", label="delay_s")
