"""Synthetic rig: motion, exact kinematics, play and encoders that produce an encoder log."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .fixed_gear import fixed_gear_readings as fixed_gear_readings
    from .imperfections import EncoderError as EncoderError
    from .motion import PassMotion as PassMotion
    from .paper import paper_eccentricities as paper_eccentricities
    from .paper import paper_pair as paper_pair
    from .paper import paper_rig as paper_rig
    from .synthetic import SyntheticRig as SyntheticRig

_HOMES = {
    "EncoderError": "imperfections",
    "PassMotion": "motion",
    "SyntheticRig": "synthetic",
    "fixed_gear_readings": "fixed_gear",
    "paper_eccentricities": "paper",
    "paper_pair": "paper",
    "paper_rig": "paper",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
