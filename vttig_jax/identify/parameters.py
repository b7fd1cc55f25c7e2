"""From Cartesian parameters to what people quote: amplitudes, phases, intervals, upper limits."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..base.angles import amplitude_phase
from ..base.units import ARCSEC, DEG
from .solve import Solution

NORMAL_95 = 1.959963984540054
SIGNIFICANT = 3.0
BELOW = "below three standard errors"
ROUNDING = 1e-11
"""Angles below this, rad, are rounding and never significant."""


@dataclass(frozen=True)
class Parameter:
    """One number of the result, with everything needed to trust it or not.

    `determined` is False where the data cannot fix it; then `value` is None and `reason` says
    why. An amplitude or backlash below three standard errors is not `significant`: an amplitude
    then has an upper limit `upper95` and its phase no value. `low95` and `high95` are equal-tailed
    (Laplace); those of a phase lie around the value and may leave [0°, 360°).
    """

    name: str
    unit: str
    value: float | None = None
    std: float | None = None
    low95: float | None = None
    high95: float | None = None
    determined: bool = False
    significant: bool = False
    reason: str | None = None
    upper95: float | None = None

    def moved(self, by: float) -> "Parameter":
        """The same with `by` added to value and interval."""
        if self.value is None or self.low95 is None or self.high95 is None:
            return self
        return replace(self, value=self.value + by, low95=self.low95 + by, high95=self.high95 + by)

    def to_json(self) -> dict:
        """Fields of the contract; `upper95` only where there is one."""
        record = {
            key: getattr(self, key)
            for key in (
                "value",
                "std",
                "low95",
                "high95",
                "unit",
                "determined",
                "significant",
                "reason",
            )
        }
        return record | ({} if self.upper95 is None else {"upper95": self.upper95})


def undetermined(name: str, unit: str, reason: str) -> Parameter:
    """A parameter the data cannot fix."""
    return Parameter(name, unit, reason=reason)


def scalar(solution: Solution, source: str, name: str, unit: str, scale: float) -> Parameter:
    """A parameter that is one Cartesian coordinate; `scale` is internal units per `unit`."""
    index = solution.names.index(source)
    value = float(solution.values[index]) / scale
    std = math.sqrt(float(solution.covariance[index, index])) / scale
    significant = abs(value) >= max(SIGNIFICANT * std, ROUNDING / scale)
    return Parameter(
        name,
        unit,
        value,
        std,
        value - NORMAL_95 * std,
        value + NORMAL_95 * std,
        determined=True,
        significant=significant,
        reason=None if significant else BELOW,
    )


def polar(
    solution: Solution, source: str, names: tuple[str, str], unit: str, scale: float
) -> tuple[Parameter, Parameter]:
    """Amplitude and phase of the Cartesian pair `source`_x, `source`_y."""
    index = [solution.names.index(f"{source}_{axis}") for axis in "xy"]
    offset = solution.values[index] / scale
    spread = solution.covariance[np.ix_(index, index)] / scale**2
    amplitude, amplitude_std, phase_deg, phase_std_deg = polar_spread(offset, spread)
    significant = amplitude >= SIGNIFICANT * amplitude_std
    if not significant:
        reason = f"{names[0]} is below three standard errors"
        upper = _upper_limit(amplitude, spread)
        return (
            Parameter(
                names[0],
                unit,
                amplitude,
                amplitude_std,
                0.0,
                upper,
                determined=True,
                reason="below three standard errors: an upper limit only",
                upper95=upper,
            ),
            Parameter(names[1], "deg", determined=True, reason=reason),
        )
    return (
        _interval(names[0], unit, amplitude, amplitude_std),
        _interval(names[1], "deg", phase_deg, phase_std_deg),
    )


def polar_spread(
    offset: Float[np.ndarray, "2"], spread: Float[np.ndarray, "2 2"]
) -> tuple[float, float, float, float]:
    """Amplitude and its standard error, phase in degrees and its standard error, to first order."""
    amplitude, phase_deg = (float(part) for part in amplitude_phase(offset[1], offset[0]))
    if amplitude == 0:
        return 0.0, float(np.sqrt(np.max(np.linalg.eigvalsh(spread)))), 0.0, 180.0
    along = offset / amplitude
    across = np.array([-along[1], along[0]])
    phase_std = float(np.sqrt(across @ spread @ across)) / amplitude
    return amplitude, float(np.sqrt(along @ spread @ along)), phase_deg, phase_std / DEG


def _interval(name: str, unit: str, value: float, std: float) -> Parameter:
    margin = NORMAL_95 * std
    return Parameter(
        name, unit, value, std, value - margin, value + margin, determined=True, significant=True
    )


def _upper_limit(amplitude: float, spread: Float[np.ndarray, "2 2"]) -> float:
    """95 % quantile of the length of a plane Gaussian vector, its spread taken as a circle."""
    variance = float(np.trace(spread)) / 2
    from scipy.special import chndtrix  # slow to import, and seldom needed

    return math.sqrt(variance * float(chndtrix(0.95, 2, amplitude**2 / variance)))


UNITS = {"mm": 1.0, "deg": DEG, "arcsec": ARCSEC}
"""Internal units (mm, rad) per unit at the border."""
