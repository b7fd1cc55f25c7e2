"""Flank models: transmission error and backlash of an eccentric gear pair as pure functions."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .backlash_map import BacklashMap as BacklashMap
    from .exact import exact_model as exact_model
    from .first_order import closed_model as closed_model
    from .flank_model import FlankModel as FlankModel
    from .functions import axial_displacement as axial_displacement
    from .functions import backlash as backlash
    from .functions import exact_backlash as exact_backlash
    from .functions import exact_transmission_error as exact_transmission_error
    from .functions import transmission_error as transmission_error
    from .harmonic import OrderModel as OrderModel
    from .te_curve import TECurve as TECurve
    from .turn_location import locate as locate

_HOMES = {
    "BacklashMap": "backlash_map",
    "FlankModel": "flank_model",
    "OrderModel": "harmonic",
    "TECurve": "te_curve",
    "axial_displacement": "functions",
    "backlash": "functions",
    "closed_model": "first_order",
    "exact_backlash": "functions",
    "exact_model": "exact",
    "exact_transmission_error": "functions",
    "locate": "turn_location",
    "transmission_error": "functions",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
