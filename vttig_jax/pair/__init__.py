"""Gears, gear pairs and drives with their nominal data, eccentricities, and the pair file."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
