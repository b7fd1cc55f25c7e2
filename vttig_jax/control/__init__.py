"""Simulation of one reversal or of many: plants, controllers, and scenario files that name them."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
