"""Plants, controllers and the scenario file that names them: one simulated reversal, or many."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
