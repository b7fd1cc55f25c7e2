"""Encoder logs: reading, unwrapping, segments and inspection; imports no jax."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .checks.slip import find_slip as find_slip
    from .encoder_log import EncoderLog as EncoderLog
    from .inspection import Inspection as Inspection
    from .inspection import inspect_log as inspect_log
    from .lines.rows import Stretch as Stretch
    from .lines.search import find_lines as find_lines
    from .motion.segments import find_segments as find_segments
    from .read import read_log as read_log
    from .readers.backlash_readings import BacklashReadings as BacklashReadings
    from .readers.backlash_readings import read_backlash_readings as read_backlash_readings

_HOMES = {
    "BacklashReadings": "readers.backlash_readings",
    "EncoderLog": "encoder_log",
    "Inspection": "inspection",
    "Stretch": "lines.rows",
    "find_lines": "lines.search",
    "find_segments": "motion.segments",
    "find_slip": "checks.slip",
    "inspect_log": "inspection",
    "read_backlash_readings": "readers.backlash_readings",
    "read_log": "read",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
