"""Gears, gear pairs and drives with their nominal data, eccentricities, and the pair file."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .eccentricities import Eccentricities as Eccentricities
    from .encoder_reading import ShaftReading as ShaftReading
    from .encoder_reading import shaft_reading as shaft_reading
    from .gear_pair import Drive as Drive
    from .gear_pair import Gear as Gear
    from .gear_pair import GearPair as GearPair
    from .load import load_pair as load_pair
    from .pair_file import load_pair_spec as load_pair_spec
    from .pair_file import parse_pair_spec as parse_pair_spec
    from .schema import Encoder as Encoder
    from .schema import HarmonicOrders as HarmonicOrders
    from .schema import PairSpec as PairSpec
    from .schema import StatedTable as StatedTable

_HOMES = {
    "Drive": "gear_pair",
    "Eccentricities": "eccentricities",
    "Encoder": "schema",
    "Gear": "gear_pair",
    "GearPair": "gear_pair",
    "HarmonicOrders": "schema",
    "PairSpec": "schema",
    "ShaftReading": "encoder_reading",
    "StatedTable": "schema",
    "load_pair": "load",
    "load_pair_spec": "pair_file",
    "parse_pair_spec": "pair_file",
    "shaft_reading": "encoder_reading",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
