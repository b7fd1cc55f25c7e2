"""Encoder logs: reading, unwrapping, segments and inspection; imports no jax."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
