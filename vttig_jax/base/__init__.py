"""Common tools: units, angles, errors, files, text tables, numerics and process settings."""

from typing import TYPE_CHECKING

from .facade import lazy_names

if TYPE_CHECKING:
    from .errors import InputError as InputError
    from .errors import LogError as LogError
    from .errors import NoAnswerError as NoAnswerError
    from .errors import NotConvergedError as NotConvergedError
    from .errors import PairError as PairError
    from .errors import ScenarioError as ScenarioError
    from .errors import UsageError as UsageError
    from .errors import VttigError as VttigError
    from .files.text_tables import text_table as text_table
    from .runtime import enable_x64 as enable_x64
    from .runtime import prepare_cpu as prepare_cpu
    from .units import ARCSEC as ARCSEC
    from .units import DEG as DEG
    from .units import REV as REV

_HOMES = {
    "ARCSEC": "units",
    "DEG": "units",
    "InputError": "errors",
    "LogError": "errors",
    "NoAnswerError": "errors",
    "NotConvergedError": "errors",
    "PairError": "errors",
    "REV": "units",
    "ScenarioError": "errors",
    "UsageError": "errors",
    "VttigError": "errors",
    "enable_x64": "runtime",
    "prepare_cpu": "runtime",
    "text_table": "files.text_tables",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
