"""`plot`: the picture of an object, whatever the object is."""

from functools import singledispatch
from typing import Any

from matplotlib.figure import Figure

from ..control.simulation.result import Simulation
from ..control.sweeps.table import SweepTable
from ..geometry.contact.deviations import Deviations
from ..geometry.contact.report import Contacts
from ..geometry.tooth.tooth import Tooth
from ..identify.fit_result import Fit
from ..kinematics.backlash_map import BacklashMap
from ..kinematics.te_curve import TECurve
from ..posterior.summary.bands import BandedMap
from ..posterior.summary.posterior import Posterior
from ..posterior.summary.predictive import Predictive
from .backlash_map import plot_band_map, plot_map
from .contact import plot_contact
from .corner_picture import plot_corner
from .deviations import plot_deviations
from .fit import plot_fit, plot_te
from .predictive import plot_predictive
from .simulation import plot_simulation
from .sweep import plot_sweep
from .tooth import plot_tooth


@singledispatch
def plot(obj: object, **options: Any) -> Figure:
    """Draw an object; the figure is matplotlib's own and belongs to no pyplot window.

    - a `TECurve`: transmission error over driving angle; options `ax`, `unit`.
    - a `Fit`: measured and fitted, flank by flank, and the residual; `unit`, `span_deg`.
    - a `BacklashMap`: backlash over the hunting period; `ax`, `turns`.
    - a `Posterior`: every pair of coordinates (`plot_trace` draws them step by step); `names`.
    - a `BandedMap`: backlash with its bands; `ax`, `turns`.
    - a `Predictive`: a log beside what its posterior predicts; `unit`, `turns`.
    - a `Simulation` with a trace: the run, and its reversal close up; `unit`, `span_s`.
    - a `SweepTable`: what is left and closed too far, over one of its axes; `axis`, `by`.
    - a `Tooth`: its sections at both ends and in the middle, its thickness between; `name`.
    - `Contacts`: the gears in mesh and the lines in which they touch; `pair`, `place`.
    - `Deviations`: profile, helix and pitch of measured flanks; `pair`.

    The options are those of `plot_te`, `plot_fit`, `plot_map`, `plot_corner`, `plot_band_map`,
    `plot_predictive`, `plot_simulation`, `plot_sweep`, `plot_tooth`, `plot_contact` and
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
        f"Argument `obj` must be a TECurve, Fit or BacklashMap, but is {type(obj).__name__}; what a"
        " Posterior, BandedMap, Predictive, Simulation or SweepTable says has a picture too, and so"
        " have a Tooth, Contacts and Deviations."
    )


plot.register(TECurve, plot_te)
plot.register(Fit, plot_fit)
plot.register(BacklashMap, plot_map)
plot.register(Posterior, plot_corner)
plot.register(BandedMap, plot_band_map)
plot.register(Predictive, plot_predictive)
plot.register(Simulation, plot_simulation)
plot.register(SweepTable, plot_sweep)
plot.register(Tooth, plot_tooth)
plot.register(Contacts, plot_contact)
plot.register(Deviations, plot_deviations)
