"""Function `plot`, which draws the picture of any object that has one."""

from functools import singledispatch
from typing import Any

from matplotlib.figure import Figure

from ..control.simulation.result import Simulation
from ..control.sweeps.table import SweepTable
from ..geometry.contact_report import Contacts
from ..geometry.deviations import Deviations
from ..geometry.tooth import Tooth
from ..identify.result import Fit
from ..kinematics.backlash_map import BacklashMap
from ..kinematics.te_curve import TECurve
from ..posterior.summary.bands import BandedMap
from ..posterior.summary.posterior import Posterior
from .backlash_map import plot_band_map, plot_map
from .contact import plot_contact
from .corner_picture import plot_corner
from .deviations import plot_deviations
from .fit import plot_fit, plot_te
from .simulation import plot_simulation
from .sweep import plot_sweep
from .tooth import plot_tooth


@singledispatch
def plot(obj: object, **options: Any) -> Figure:
    """Draw an object in a matplotlib figure without a pyplot window.

    The options depend on the type of the object:

    - `TECurve`: transmission error over driving angle; `ax`, `unit`.
    - `Fit`: measured and fitted values of each flank, and the residual; `unit`, `span_deg`.
    - `BacklashMap`: backlash over the hunting period; `ax`, `turns`.
    - `Posterior`: every pair of coordinates (`plot_trace` draws them step by step); `names`.
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
        "Argument `obj` must be a TECurve, Fit, BacklashMap, Posterior, BandedMap,"
        f" Simulation, SweepTable, Tooth, Contacts or Deviations, but is {type(obj).__name__}."
    )


plot.register(TECurve, plot_te)
plot.register(Fit, plot_fit)
plot.register(BacklashMap, plot_map)
plot.register(Posterior, plot_corner)
plot.register(BandedMap, plot_band_map)
plot.register(Simulation, plot_simulation)
plot.register(SweepTable, plot_sweep)
plot.register(Tooth, plot_tooth)
plot.register(Contacts, plot_contact)
plot.register(Deviations, plot_deviations)
