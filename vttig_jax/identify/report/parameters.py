"""Parameters of a fit, each with its value and interval, or with the reason why it has none."""

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from ...base.numerics.polar_spread import polar_spread, upper_limit
from ...base.numerics.quantiles import NORMAL_95
from ...base.units import ARCSEC, DEG
from ...logs.encoder_log import EncoderLog
from ...model.parameter import BELOW, LARGEST, OPEN, Parameter, undetermined
from ...pair.gear_pair import Drive, GearPair
from ..model.identifiability import Identifiability
from ..preliminary.delay import Delay
from ..settings import FitSettings
from ..solve.least_squares import Solution

Outcome = Literal["ok", "partly_determined", "not_determined", "not_converged", "contradicts"]


SIGNIFICANT = 3.0  # standard errors above which a value is significant; chosen value
BESIDE_FREE_DELAY = "at one steady speed it cannot be told from the delay that is free"
_OPEN_MM = OPEN.replace("one revolution", "the centre distance")
ROUNDING = 1e-11
"""Angle, rad, below which a value is rounding and never significant."""


def scalar(solution: Solution, source: str, name: str, unit: str, scale: float) -> Parameter:
    """Return the parameter `name` from the value `source` of the solution.

    `scale` is the number of internal units (mm or rad) per `unit`.
    """
    index = solution.names.index(source)
    value = float(solution.values[index]) / scale
    std = math.sqrt(float(solution.covariance[index, index])) / scale
    significant = abs(value) >= max(SIGNIFICANT * std, ROUNDING / scale)
    found = interval_of(name, unit, value, std)
    return found if significant else replace(found, significant=False, reason=BELOW)


def polar(
    solution: Solution, source: str, names: tuple[str, str], unit: str, scale: float
) -> tuple[Parameter, Parameter]:
    """Return amplitude and phase from the values `source`_x and `source`_y of the solution."""
    index = [solution.names.index(f"{source}_{axis}") for axis in "xy"]
    offset = solution.values[index] / scale
    spread = solution.covariance[np.ix_(index, index)] / scale**2
    amplitude, amplitude_std, phase_deg, phase_std_deg = polar_spread(offset, spread)
    significant = amplitude >= SIGNIFICANT * amplitude_std
    if not significant:
        reason = f"{names[0]} is below three standard errors"
        upper = upper_limit(amplitude, spread)
        return (
            Parameter(
                name=names[0],
                unit=unit,
                value=amplitude,
                std=amplitude_std,
                low95=0.0,
                high95=upper,
                determined=True,
                reason="below three standard errors: an upper limit only",
                upper95=upper,
            ),
            Parameter(names[1], "deg", determined=True, reason=reason),
        )
    return (
        interval_of(names[0], unit, amplitude, amplitude_std),
        interval_of(names[1], "deg", phase_deg, phase_std_deg),
    )


def interval_of(name: str, unit: str, value: float, std: float) -> Parameter:
    """Return a determined parameter with its 95 % interval."""
    margin = NORMAL_95 * std
    return Parameter(
        name=name,
        unit=unit,
        value=value,
        std=std,
        low95=value - margin,
        high95=value + margin,
        determined=True,
        significant=True,
    )


UNITS = {"mm": 1.0, "deg": DEG, "arcsec": ARCSEC}
"""Internal units (mm, rad) per unit of input and output."""


SHAFTS = ("driving", "driven")
_ONE_DIRECTION = "one direction: encoder and gear eccentricity are one number"
_PERFECT = "not fitted: the encoders are taken to be perfect"
_PERFECT_GEARS = "not fitted: the gears are taken to be perfect"
GIVEN_INSTEAD = "not fitted: the given flank model takes the place of the exact relation"
_NO_GEOMETRY = "a drive has no gear geometry that could tell encoder from gear"
_REGRESSORS = {
    "torque": ("torque_arcsec_per_unit", "arcsec/unit of torque", ARCSEC),
    "acceleration": ("acceleration_arcsec_s2_per_rad", "arcsec/(rad/s²)", ARCSEC),
    "speed": ("speed_s", "s", 1.0),
    "ratio": ("ratio", "1", 1.0),
}
"""Regressor column → name and unit of its coefficient, and internal units per this unit."""


def parameters_of(
    pair: GearPair | Drive,
    identifiable: Identifiability,
    solution: Solution,
    settings: FitSettings,
    delay: Delay,
) -> dict[str, Parameter]:
    """Return name → `Parameter` for all parameters of a fit, in the order of its JSON object.

    If the logs determine only the sum of the backlash and 2 ω₂ times the delay, the sum is a
    parameter too.
    """
    drive = isinstance(pair, Drive)
    largest = LARGEST if drive else LARGEST | {"mm": float(pair.centre_distance_mm)}
    found: list[Parameter] = []
    for shaft in SHAFTS:
        name, unit, scale = (
            (f"{shaft}_amplitude_arcsec", "arcsec", ARCSEC)
            if drive
            else (f"{shaft}_eccentricity_mm", "mm", 1.0)
        )
        names = (name, f"{shaft}_phase_deg")
        reason = identifiable.reasons.get(shaft) if not settings.perfect_gears else _PERFECT_GEARS
        found += _polar_or_reason(
            solution,
            source=shaft,
            names=names,
            unit=unit,
            scale=scale,
            reason=reason,
            largest=largest[unit],
        )
    found.append(_constant_backlash(solution, identifiable.short, delay))
    for shaft in SHAFTS:
        reason = identifiable.reasons.get(shaft)
        if settings.perfect_gears or reason == GIVEN_INSTEAD:
            pass
        elif drive:
            reason = _NO_GEOMETRY
        elif settings.perfect_encoders:
            reason = _PERFECT
        elif len(identifiable.flanks) == 1:
            reason = _ONE_DIRECTION
        names = (f"{shaft}_encoder_arcsec", f"{shaft}_encoder_phase_deg")
        found += _polar_or_reason(
            solution,
            source=f"{shaft}_encoder",
            names=names,
            unit="arcsec",
            scale=ARCSEC,
            reason=reason,
            largest=largest["arcsec"],
        )
    found.append(_delay(solution, delay))
    if delay.bound_s and len(identifiable.flanks) == 2:
        found.append(_sum(solution, identifiable.short))
    return {parameter.name: parameter for parameter in found}


def outcome_of(
    parameters: dict[str, Parameter],
    converged: bool,
    settings: FitSettings,
    *,
    contradiction: bool = False,
) -> Outcome:
    """Return the outcome of the fit; parameters that the settings exclude do not count.

    `contradiction` is True if the gap is clearly negative, which is physically impossible.
    """
    if not converged:
        return "not_converged"
    if contradiction:
        return "contradicts"
    left_out = (_NO_GEOMETRY, _PERFECT, _PERFECT_GEARS, GIVEN_INSTEAD)
    asked = [
        p
        for p in parameters.values()
        if p.name != "delay_s"
        and p.reason not in left_out
        and (not settings.perfect_encoders or "encoder" not in p.name)
        and (not settings.perfect_gears or p.name != "constant_backlash_deg")
    ]
    if not any(p.determined for p in asked):
        return "not_determined"
    return "ok" if all(p.determined for p in asked) else "partly_determined"


def _polar_or_reason(
    solution: Solution,
    source: str,
    names: tuple[str, str],
    unit: str,
    scale: float,
    reason: str | None,
    largest: float,
) -> tuple[Parameter, Parameter]:
    if reason is None:
        index = [solution.names.index(f"{source}_{axis}") for axis in "xy"]
        if all(solution.determined[index]):
            amplitude, phase = polar(solution, source, names, unit, scale)
            if (amplitude.high95 or 0.0) <= largest:
                return amplitude, phase
            reason = _OPEN_MM if unit == "mm" else OPEN
        else:
            reason = "the data leave it open: " + _companions(solution, index)
    return undetermined(names[0], unit, reason), undetermined(names[1], "deg", reason)


def _companions(solution: Solution, index: list[int]) -> str:
    others = [
        name.replace("_", " ")
        for place, name in enumerate(solution.names)
        if not solution.determined[place] and place not in index
    ]
    return "it cannot be told from " + ", ".join(others) if others else "no sample depends on it"


def regressors_of(solution: Solution, log: EncoderLog) -> tuple[Parameter, ...]:
    """Return the fitted coefficients of torque, acceleration, speed and ratio."""
    found = []
    for source in solution.names:
        if source.split("_")[0] in _REGRESSORS:
            name, unit, scale = _REGRESSORS[source.split("_")[0]]
            if not solution.determined[solution.names.index(source)]:
                index = [solution.names.index(source)]
                reason = "the data leave it open: " + _companions(solution, index)
                found.append(undetermined(name, unit, reason))
                continue
            one = scalar(solution, source, name, unit, scale)
            if source == "ratio":
                agrees = f"within three standard errors of {log.ratio} as given"
                reason = None if one.significant else agrees
                one = replace(one.moved(float(log.ratio)), reason=reason)
            found.append(one)
    return tuple(found)


def _delay(solution: Solution, delay: Delay) -> Parameter:
    """Return the parameter `delay_s`: the delay removed before the fit plus the fitted rest, s."""
    if delay.state == "fitted":
        place = solution.names.index("delay")
        if not solution.determined[place]:
            reason = "the data leave it open: " + _companions(solution, [place])
            return undetermined("delay_s", "s", reason)
        found = scalar(solution, "delay", "delay_s", "s", 1.0).moved(delay.seconds)
        if abs(found.value or 0.0) >= SIGNIFICANT * (found.std or 0.0):
            return replace(found, significant=True, reason=None)
        return replace(found, significant=False, reason=BELOW)
    if delay.state == "insignificant":
        found = interval_of("delay_s", "s", delay.step_s, delay.std_s)
        return replace(found, significant=False, reason=delay.reason)
    return undetermined("delay_s", "s", delay.reason)


def _constant_backlash(solution: Solution, short: tuple[str, ...], delay: Delay) -> Parameter:
    name = "constant_backlash_deg"
    if "constant_backlash" not in solution.names:
        return undetermined(name, "deg", "one direction: one flank alone shows no gap")
    if short:
        reason = (
            f"the {' and the '.join(short)} shaft turned too little to tell its variable backlash"
            " from the constant one"
        )
        return undetermined(name, "deg", reason)
    if delay.is_unbounded:
        return undetermined(name, "deg", BESIDE_FREE_DELAY)
    index = solution.names.index("constant_backlash")
    if not solution.determined[index]:
        reason = "the data leave it open: " + _companions(solution, [index])
        return undetermined(name, "deg", reason)
    found = scalar(solution, "constant_backlash", name, "deg", DEG)
    if NORMAL_95 * (found.std or 0.0) > LARGEST["deg"]:
        return undetermined(name, "deg", OPEN)
    if found.significant and (found.value or 0.0) < 0:
        reason = "negative, which no gap is: friction or wind-up ahead of the gap, or a wrong sign"
        return replace(found, significant=False, reason=reason)
    return found


def _sum(solution: Solution, short: tuple[str, ...]) -> Parameter:
    """Return the parameter that is the sum of the backlash and 2 ω₂ times the delay, degrees."""
    name = "backlash_plus_delay_deg"
    if short:
        reason = f"the {' and the '.join(short)} shaft turned too little"
        return undetermined(name, "deg", reason)
    index = solution.names.index("constant_backlash")
    if not solution.determined[index]:
        reason = "the data leave it open: " + _companions(solution, [index])
        return undetermined(name, "deg", reason)
    return scalar(solution, "constant_backlash", name, "deg", DEG)


def variable_backlash_deg(
    pair: GearPair, parameters: dict[str, Parameter], driving_deg: float, driven_deg: float
) -> float:
    """Return the variable backlash, equation (21), of the fitted eccentricities, degrees.

    An eccentricity without value or phase counts as zero. `driving_deg` and `driven_deg` are the
    shaft angles, counted from the zeros of the phases.
    """
    total = 0.0
    for shaft, sign, angle_deg in (("driven", 1.0, driven_deg), ("driving", -1.0, driving_deg)):
        eccentricity = parameters[f"{shaft}_eccentricity_mm"].value
        phase = parameters[f"{shaft}_phase_deg"].value
        if eccentricity is not None and phase is not None:
            total += sign * eccentricity * math.cos((angle_deg + phase) * DEG)
    alphas = [float(alpha) for alpha in pair.working_pressure_angles]
    radii = [float(radius) for radius in pair.base_radii[1]]
    gain = sum(math.sin(a) / r for a, r in zip(alphas, radii, strict=True))
    return gain * total / DEG
