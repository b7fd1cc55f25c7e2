"""Run folders: what the command line writes, for Python too."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .fit_run import save_fit as save_fit
    from .posterior_run import save_posterior as save_posterior
    from .run import Run as Run
    from .run import open_run as open_run

_HOMES = {
    "Run": "run",
    "open_run": "run",
    "save_fit": "fit_run",
    "save_posterior": "posterior_run",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
