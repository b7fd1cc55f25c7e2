"""From the log to parameters: harmonic summary, noise, least squares, rank in words."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .backlash import backlash_map as backlash_map
    from .fit_result import Fit as Fit
    from .fitting import fit as fit
    from .report.checks import Checks as Checks
    from .report.parameters import Parameter as Parameter
    from .settings import FitSettings as FitSettings
    from .store import read_fit as read_fit

_HOMES = {
    "Checks": "report.checks",
    "Fit": "fit_result",
    "FitSettings": "settings",
    "Parameter": "report.parameters",
    "backlash_map": "backlash",
    "fit": "fitting",
    "read_fit": "store",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
