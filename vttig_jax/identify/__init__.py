"""From the log to parameters: harmonic summary, noise, least squares, rank in words."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
