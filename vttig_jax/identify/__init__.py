"""From the log to parameters: harmonic summary, noise, least squares, rank in words."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .backlash import backlash_map as backlash_map
    from .fit_result import Fit as Fit
    from .fitting import fit as fit
    from .many.batch_model import BatchModel as BatchModel
    from .many.codes import Code as Code
    from .many.fit_arrays import ArrayFit as ArrayFit
    from .many.fit_arrays import fit_arrays as fit_arrays
    from .many.fit_arrays import fit_batch as fit_batch
    from .many.fit_many import fit_many as fit_many
    from .many.log_arrays import LogArrays as LogArrays
    from .many.preparation import prepared as prepared
    from .many.table import FitTable as FitTable
    from .report.checks import Checks as Checks
    from .report.parameters import Parameter as Parameter
    from .settings import FitSettings as FitSettings
    from .store import read_fit as read_fit

_HOMES = {
    "ArrayFit": "many.fit_arrays",
    "BatchModel": "many.batch_model",
    "Checks": "report.checks",
    "Code": "many.codes",
    "Fit": "fit_result",
    "FitSettings": "settings",
    "FitTable": "many.table",
    "LogArrays": "many.log_arrays",
    "Parameter": "report.parameters",
    "backlash_map": "backlash",
    "fit": "fitting",
    "fit_arrays": "many.fit_arrays",
    "fit_batch": "many.fit_arrays",
    "fit_many": "many.fit_many",
    "prepared": "many.preparation",
    "read_fit": "store",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
