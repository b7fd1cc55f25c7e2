"""Pictures of the objects of all rooms."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
