"""Common tools: units, angles, errors, files, text tables, numerics and process settings."""

from .facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
