"""Synthetic rig: motion, exact kinematics, play and encoders that produce an encoder log."""

from ..base.facade import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__)
