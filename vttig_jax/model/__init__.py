"""The linear mixed model of two encoder channels: rows, one density, functionals."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
