"""All parameters of the contract, each with a value or the reason why it has none."""

import math

from ..base.units import ARCSEC, DEG
from ..pair.gears import Drive, GearPair
from .parameters import Parameter, polar, scalar, undetermined
from .result import Outcome
from .scope import Scope
from .solve import Solution

SHAFTS = ("driving", "driven")
_ONE_DIRECTION = "one direction: encoder and gear eccentricity are one number"
_PERFECT = "not fitted: the encoders are taken to be perfect"
_NO_GEOMETRY = "a drive has no gear geometry that could tell encoder from gear"
_DELAY = "not fitted: both channels are taken to be sampled at the same instant"


def parameters_of(
    pair: GearPair | Drive, scope: Scope, solution: Solution, encoder_terms: bool
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
        found += _polar_or_reason(solution, shaft, names, unit, scale, scope.reasons.get(shaft))
    found.append(_constant_backlash(solution, scope.short))
    for shaft in SHAFTS:
        reason = scope.reasons.get(shaft)
        if drive:
            reason = _NO_GEOMETRY
        elif not encoder_terms:
            reason = _PERFECT
        elif len(scope.flanks) == 1:
            reason = _ONE_DIRECTION
        names = (f"{shaft}_encoder_arcsec", f"{shaft}_encoder_phase_deg")
        found += _polar_or_reason(solution, f"{shaft}_encoder", names, "arcsec", ARCSEC, reason)
    found.append(undetermined("delay_s", "s", _DELAY))
    return {parameter.name: parameter for parameter in found}


def outcome_of(parameters: dict[str, Parameter], converged: bool, encoder_terms: bool) -> Outcome:
    """One word for the whole fit; parameters that were not asked for do not count."""
    if not converged:
        return "not_converged"
    asked = [
        p
        for p in parameters.values()
        if p.name != "delay_s"
        and p.reason != _NO_GEOMETRY
        and (encoder_terms or "encoder" not in p.name)
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


def _constant_backlash(solution: Solution, short: tuple[str, ...]) -> Parameter:
    name = "constant_backlash_deg"
    if "constant_backlash" not in solution.names:
        return undetermined(name, "deg", "one direction: one flank alone shows no gap")
    if short:
        reason = f"the variable backlash of the {' and the '.join(short)} shaft is not resolved"
        return undetermined(name, "deg", reason)
    index = solution.names.index("constant_backlash")
    if not solution.determined[index]:
        reason = "the data leave it open: " + _companions(solution, [index])
        return undetermined(name, "deg", reason)
    return scalar(solution, "constant_backlash", name, "deg", DEG)


def variable_backlash_deg(
    pair: GearPair, parameters: dict[str, Parameter], driving_angle_deg: float
) -> float:
    """Variable backlash (21) of the fitted eccentricities that have a phase, degrees."""
    total = 0.0
    for shaft, sign, speed in (("driven", 1.0, float(pair.ratio)), ("driving", -1.0, 1.0)):
        eccentricity = parameters[f"{shaft}_eccentricity_mm"].value
        phase = parameters[f"{shaft}_phase_deg"].value
        if eccentricity is not None and phase is not None:
            total += sign * eccentricity * math.cos((speed * driving_angle_deg + phase) * DEG)
    alphas = [float(alpha) for alpha in pair.working_pressure_angles]
    radii = [float(radius) for radius in pair.base_radii[1]]
    gain = sum(math.sin(a) / r for a, r in zip(alphas, radii, strict=True))
    return gain * total / DEG
