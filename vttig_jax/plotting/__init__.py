"""Pictures of fits, backlash maps, posteriors, simulations, sweeps, teeth and contacts."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
