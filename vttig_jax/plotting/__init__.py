"""Pictures of the objects of all rooms."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .backlash_map import plot_map as plot_map
    from .contact import plot_contact as plot_contact
    from .deviations import plot_deviations as plot_deviations
    from .dispatch import plot as plot
    from .fit import plot_te as plot_te
    from .order_spectrum import plot_orders as plot_orders
    from .residual import plot_residual as plot_residual
    from .save import png as png
    from .tooth import plot_tooth as plot_tooth

_HOMES = {
    "plot": "dispatch",
    "plot_contact": "contact",
    "plot_deviations": "deviations",
    "plot_map": "backlash_map",
    "plot_orders": "order_spectrum",
    "plot_residual": "residual",
    "plot_te": "fit",
    "plot_tooth": "tooth",
    "png": "save",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
