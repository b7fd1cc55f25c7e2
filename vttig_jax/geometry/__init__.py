"""Gear geometry: tooth surfaces, measures of a gear, backlash and contact of a pair, solids."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
