"""Posterior of a fit: sampling, bands, calibration, and the plan of a run."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
