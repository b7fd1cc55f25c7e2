"""All parameters of the contract, each with a value or the reason why it has none."""

import math
from dataclasses import replace

from ..base.units import ARCSEC, DEG
from ..logs.encoder_log import EncoderLog
from ..pair.gears import Drive, GearPair
from .choices import Choices
from .delay import Delay
from .parameters import (
    BELOW,
    NORMAL_95,
    ROUNDING,
    SIGNIFICANT,
    Parameter,
    polar,
    scalar,
    undetermined,
)
from .result import Outcome
from .scope import Scope
from .solve import Solution

SHAFTS = ("driving", "driven")
_ONE_DIRECTION = "one direction: encoder and gear eccentricity are one number"
_PERFECT = "not fitted: the encoders are taken to be perfect"
_PERFECT_GEARS = "not fitted: the gears are taken to be perfect"
_NO_GEOMETRY = "a drive has no gear geometry that could tell encoder from gear"
_REGRESSORS = {
    "torque": ("torque_arcsec_per_unit", "arcsec/unit of torque", ARCSEC),
    "acceleration": ("acceleration_arcsec_s2_per_rad", "arcsec/(rad/s²)", ARCSEC),
    "speed": ("speed_s", "s", 1.0),
    "ratio": ("ratio", "1", 1.0),
}
"""Own column → name, unit, and internal units per unit of its coefficient."""


def parameters_of(
    pair: GearPair | Drive,
    scope: Scope,
    solution: Solution,
    choices: Choices,
    delay: Delay,
) -> dict[str, Parameter]:
    """Every name of the contract → `Parameter`, in its order."""
    drive = isinstance(pair, Drive)
    found: list[Parameter] = []
    for shaft in SHAFTS:
        name, unit, scale = (
            (f"{shaft}_amplitude_arcsec", "arcsec", ARCSEC)
            if drive
            else (f"{shaft}_eccentricity_mm", "mm", 1.0)
        )
        names = (name, f"{shaft}_phase_deg")
        reason = scope.reasons.get(shaft) if choices.gear_terms else _PERFECT_GEARS
        found += _polar_or_reason(solution, shaft, names, unit, scale, reason)
    found.append(_constant_backlash(solution, scope.short, delay))
    for shaft in SHAFTS:
        reason = scope.reasons.get(shaft)
        if not choices.gear_terms:
            pass
        elif drive:
            reason = _NO_GEOMETRY
        elif not choices.encoder_terms:
            reason = _PERFECT
        elif len(scope.flanks) == 1:
            reason = _ONE_DIRECTION
        names = (f"{shaft}_encoder_arcsec", f"{shaft}_encoder_phase_deg")
        found += _polar_or_reason(solution, f"{shaft}_encoder", names, "arcsec", ARCSEC, reason)
    found.append(_delay(solution, delay))
    return {parameter.name: parameter for parameter in found}


def outcome_of(parameters: dict[str, Parameter], converged: bool, choices: Choices) -> Outcome:
    """One word for the whole fit; parameters that were not asked for do not count."""
    if not converged:
        return "not_converged"
    left_out = (_NO_GEOMETRY, _PERFECT, _PERFECT_GEARS)
    asked = [
        p
        for p in parameters.values()
        if p.name != "delay_s"
        and p.reason not in left_out
        and (choices.encoder_terms or "encoder" not in p.name)
        and (choices.gear_terms or p.name != "constant_backlash_deg")
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
) -> tuple[Parameter, Parameter]:
    if reason is None:
        index = [solution.names.index(f"{source}_{axis}") for axis in "xy"]
        if all(solution.determined[index]):
            return polar(solution, source, names, unit, scale)
        reason = "the data leave it open: " + _companions(solution, index)
    return undetermined(names[0], unit, reason), undetermined(names[1], "deg", reason)


def _companions(solution: Solution, index: list[int]) -> str:
    others = [
        name.replace("_", " ")
        for place, name in enumerate(solution.names)
        if not solution.determined[place] and place not in index
    ]
    return "it cannot be told from " + ", ".join(others) if others else "no sample depends on it"


def apparent_gap(solution: Solution) -> dict | None:
    """By how much flank B stands above flank A on average over the angles covered.

    Equal to the constant backlash where that is determined; where a shaft turned too little to tell
    its variable part it is all that is known. A gap below zero is no backlash.
    """
    if "constant_backlash" not in solution.names:
        return None
    place = solution.names.index("constant_backlash")
    if not solution.determined[place]:
        return None
    value = float(solution.values[place])
    std = math.sqrt(float(solution.covariance[place, place]))
    return {
        "value_deg": value / DEG,
        "std_deg": std / DEG,
        "significant": value >= max(SIGNIFICANT * std, ROUNDING),
    }


def regressors_of(solution: Solution, log: EncoderLog) -> tuple[Parameter, ...]:
    """Coefficients of torque, acceleration, speed and ratio, as far as they were fitted."""
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
    """The delay: shift of the driving angle and what the last step added to it."""
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
        margin = NORMAL_95 * delay.std_s
        return Parameter(
            "delay_s",
            "s",
            delay.step_s,
            delay.std_s,
            delay.step_s - margin,
            delay.step_s + margin,
            determined=True,
            reason=delay.reason,
        )
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
    if delay.state == "open" and delay.forced:
        reason = "at one steady speed it cannot be told from the delay that is free"
        return undetermined(name, "deg", reason)
    index = solution.names.index("constant_backlash")
    if not solution.determined[index]:
        reason = "the data leave it open: " + _companions(solution, [index])
        return undetermined(name, "deg", reason)
    found = scalar(solution, "constant_backlash", name, "deg", DEG)
    if found.significant and (found.value or 0.0) < 0:
        reason = "negative, which no gap is: friction or wind-up ahead of the gap, or a wrong sign"
        return replace(found, significant=False, reason=reason)
    return found


def variable_backlash_deg(
    pair: GearPair, parameters: dict[str, Parameter], driving_deg: float, driven_deg: float
) -> float:
    """Variable backlash (21) of the fitted eccentricities that have a phase, degrees.

    `driving_deg`, `driven_deg`: angles of both shafts, from the zeros of their phases.
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
