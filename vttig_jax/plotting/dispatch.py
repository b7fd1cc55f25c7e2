"""Function `plot`, which draws the picture of any object that has one."""

from collections.abc import Callable
from functools import singledispatch
from typing import Any

from matplotlib.figure import Figure

from ..control.simulation.result import Simulation
from ..control.sweeps.table import SweepTable
from ..geometry.contact_report import Contacts
from ..geometry.deviations import Deviations
from ..geometry.tooth import Tooth
from ..identify.backlash import backlash_map
from ..identify.result import Fit
from ..kinematics.backlash_map import BacklashMap
from ..kinematics.te_curve import TECurve
from ..logs.encoder_log import EncoderLog
from ..posterior.summary.bands import BandedMap
from ..posterior.summary.posterior import Posterior
from .backlash_map import plot_band_map, plot_map
from .contact import plot_contact
from .deviations import plot_deviations
from .fit import plot_fit, plot_te
from .order_spectrum import plot_orders
from .posterior_pictures import plot_corner, plot_trace
from .residual import plot_log, plot_residual
from .simulation import plot_simulation
from .sweep import plot_sweep
from .tooth import plot_tooth


@singledispatch
def plot(obj: object, *name: str, **options: Any) -> Figure:
    """Draw an object in a matplotlib figure without a pyplot window.

    The options depend on the type of the object:

    - `EncoderLog`: transmission error as it was read, before any fit, and its spectrum.
    - `TECurve`: transmission error over driving angle; `ax`, `unit`.
    - `Fit`: measured and fitted values of each flank, and the residual; `unit`, `span_deg`. With
      the name "orders", "residual" or "map": its orders, its residual, or its backlash.
    - `BacklashMap`: backlash over the hunting period; `ax`, `turns`.
    - `Posterior`: every pair of coordinates; `names`. With the name "trace": step by step.
    - `BandedMap`: backlash with its bands; `ax`, `turns`.
    - `Simulation` with a trace: the whole run, and its reversal enlarged; `unit`, `span_s`.
    - `SweepTable`: residual backlash and interference over one of its axes; `axis`, `by`.
    - `Tooth`: sections at both ends and in the middle, and thickness along the face; `name`.
    - `Contacts`: the gears in mesh and their contact lines; `pair`, `place`.
    - `Deviations`: profile, helix and pitch of measured flanks; `pair`.

    The options are those of `plot_te`, `plot_fit`, `plot_map`, `plot_corner`, `plot_band_map`,
    `plot_simulation`, `plot_sweep`, `plot_tooth`, `plot_contact` and
    `plot_deviations`.

    **Raises** `ValueError` for an object without a picture.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.kinematics import TECurve
    >>> from vttig_jax.plotting import plot
    >>> angle = np.linspace(0.0, 10.0, 200)
    >>> figure = plot(TECurve("A", angle, 1e-4 * np.sin(angle), angle), unit="deg")
    >>> figure.axes[0].get_ylabel()
    'transmission error [°]'

    ```
    """
    raise ValueError(
        "Argument `obj` must be an EncoderLog, TECurve, Fit, BacklashMap, Posterior, BandedMap,"
        f" Simulation, SweepTable, Tooth, Contacts or Deviations, but is {type(obj).__name__}."
    )


def _named(**pictures: Callable[..., Figure]) -> Callable[..., Figure]:
    """Return the function that draws a picture of an object by its name, the first by default."""

    def draw(obj: Any, name: str = next(iter(pictures)), **options: Any) -> Figure:
        if name not in pictures:
            known = ", ".join(pictures)
            raise ValueError(f"Argument `name` must be one of {known}, but is {name!r}.")
        return pictures[name](obj, **options)

    return draw


plot.register(TECurve, plot_te)
plot.register(EncoderLog, plot_log)
_OF_FIT = {"te": plot_fit, "orders": plot_orders, "residual": plot_residual}
plot.register(Fit, _named(**_OF_FIT, map=lambda fit, **more: plot_map(backlash_map(fit), **more)))
plot.register(BacklashMap, plot_map)
plot.register(Posterior, _named(corner=plot_corner, trace=plot_trace))
plot.register(BandedMap, plot_band_map)
plot.register(Simulation, plot_simulation)
plot.register(SweepTable, plot_sweep)
plot.register(Tooth, plot_tooth)
plot.register(Contacts, plot_contact)
plot.register(Deviations, plot_deviations)
