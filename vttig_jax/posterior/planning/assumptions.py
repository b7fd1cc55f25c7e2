"""Amplitudes and phases that a plan assumes, because the standard errors depend on them."""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ...base.units import ARCSEC, DEG
from ...identify.fit_settings import LONGEST_DELAY_S
from ...pair.gear_pair import Drive, Eccentricities, GearPair

ECCENTRICITY_MM = 0.02  # default eccentricity of a gear (chosen)
ENCODER_ARCSEC = 10.0  # default encoder error (chosen)
AMPLITUDE_ARCSEC = 60.0  # default first order of a drive (chosen)
SHAFTS = ("driving", "driven")
DELAY = "delay_s"

_UNITS = {"mm": 1.0, "arcsec": ARCSEC}


def assumed_values(
    pair: GearPair | Drive,
    eccentricities: Eccentricities | None,
    given: Mapping[str, float] | None,
) -> dict[str, float]:
    """Return parameter name of a fit → assumed value, for amplitudes, phases and the delay.

    The defaults are 0.02 mm for an eccentricity, the accuracy of the encoder (10″ if it is unknown)
    for an encoder error, 60″ for the amplitude of a drive, and zero for a phase. `given` replaces
    defaults. The delay `delay_s` has no default.

    **Raises** `ValueError` for other names and for invalid numbers.
    """
    values: dict[str, float] = {}
    drive = isinstance(pair, Drive)
    for shaft in SHAFTS:
        size = AMPLITUDE_ARCSEC if drive else ECCENTRICITY_MM
        values |= zip(_parameter_names(shaft, drive), (size, 0.0), strict=True)
    for shaft in () if drive else SHAFTS:
        accuracy = getattr(pair, shaft).encoder.accuracy_arcsec
        values |= {
            f"{shaft}_encoder_arcsec": ENCODER_ARCSEC if accuracy is None else float(accuracy),
            f"{shaft}_encoder_phase_deg": 0.0,
        }
    if eccentricities is not None:
        if drive:
            raise ValueError(
                "Argument `eccentricities` must be None for a drive, which has no gear geometry;"
                " give amplitudes in `assumed`."
            )
        for shaft in SHAFTS:
            values[f"{shaft}_eccentricity_mm"] = float(getattr(eccentricities, f"{shaft}_mm"))
            values[f"{shaft}_phase_deg"] = float(getattr(eccentricities, f"{shaft}_phase_deg"))
    known = (*values, DELAY)
    for name, value in (given or {}).items():
        if name not in known:
            raise ValueError(
                f"Argument `assumed` must hold names of {', '.join(known)}, but holds {name!r}."
            )
        if name == DELAY:
            if not abs(value) <= LONGEST_DELAY_S:
                raise ValueError(
                    f"Argument `assumed` must hold a {DELAY} within ±{LONGEST_DELAY_S:g} s, but it"
                    f" is {value!r}."
                )
            values[name] = float(value)
            continue
        if not math.isfinite(value) or ("phase" not in name and value < 0):
            raise ValueError(
                f"Argument `assumed` must hold finite amplitudes that are not negative, but"
                f" {name} is {value!r}."
            )
        values[name] = float(value)
    return values


def cartesian(names: tuple[str, ...], values: Mapping[str, float]) -> Float[np.ndarray, " p"]:
    """Return the parameters `names` of a forward model, in mm and rad, from amplitudes and phases.

    x + jy = amplitude · exp(j phase); all other parameters are zero. The delay is zero too, because
    a fit removes it from the driving angle before it estimates the parameters.
    """
    parameters = dict.fromkeys(names, 0.0)
    for name, size in values.items():
        source, _, unit = name.rpartition("_")
        if unit == "deg" or name == DELAY:
            continue
        phase = f"{source}_phase_deg" if source.endswith("encoder") else None
        source = source.removesuffix("_eccentricity").removesuffix("_amplitude")
        angle = values[phase or f"{source}_phase_deg"] * DEG
        for axis, part in (("x", math.cos(angle)), ("y", math.sin(angle))):
            if f"{source}_{axis}" in parameters:
                parameters[f"{source}_{axis}"] = size * _UNITS[unit] * part
    return np.array(list(parameters.values()))


def _parameter_names(shaft: str, drive: bool) -> tuple[str, str]:
    size = f"{shaft}_amplitude_arcsec" if drive else f"{shaft}_eccentricity_mm"
    return size, f"{shaft}_phase_deg"
