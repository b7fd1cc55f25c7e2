"""The report of one run or of two: a page that can be read, sent and printed, and a comparison."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
