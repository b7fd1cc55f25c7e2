"""Transmission error and backlash of gear pairs, identified from encoder logs, in JAX.

The names below are the stable ones. Each is imported when first used, so `import vttig_jax` itself
imports neither jax nor numpy and configures nothing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .base.precision import enable_x64 as enable_x64
    from .identify.fit import fit as fit
    from .identify.mapping import backlash_map as backlash_map
    from .kinematics.functions import axial_displacement as axial_displacement
    from .kinematics.functions import backlash as backlash
    from .kinematics.functions import exact_backlash as exact_backlash
    from .kinematics.functions import exact_transmission_error as exact_transmission_error
    from .kinematics.functions import transmission_error as transmission_error
    from .logs.encoder_log import EncoderLog as EncoderLog
    from .logs.read import read_log as read_log
    from .pair.eccentricities import Eccentricities as Eccentricities
    from .pair.gears import Drive as Drive
    from .pair.gears import Gear as Gear
    from .pair.gears import GearPair as GearPair
    from .pair.gears import load_pair as load_pair

    __version__: str

_HOMES = {
    "Drive": "pair.gears",
    "Eccentricities": "pair.eccentricities",
    "EncoderLog": "logs.encoder_log",
    "Gear": "pair.gears",
    "GearPair": "pair.gears",
    "axial_displacement": "kinematics.functions",
    "backlash": "kinematics.functions",
    "backlash_map": "identify.mapping",
    "enable_x64": "base.precision",
    "exact_backlash": "kinematics.functions",
    "exact_transmission_error": "kinematics.functions",
    "fit": "identify.fit",
    "load_pair": "pair.gears",
    "read_log": "logs.read",
    "transmission_error": "kinematics.functions",
}
"""The module of each public name, below the package."""


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("vttig-jax")
    elif name in _HOMES:
        from importlib import import_module

        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*_HOMES, "__version__"])
