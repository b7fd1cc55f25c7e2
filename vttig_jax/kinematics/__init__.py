"""Flank models: transmission error and backlash of an eccentric gear pair as pure functions."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
