"""Run folders: what the command line writes, for Python too."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
