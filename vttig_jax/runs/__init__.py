"""Run folders, which the command line writes: writing and reading them from Python too."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
