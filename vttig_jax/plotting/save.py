"""The pictures of a fit as PNG files."""

from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from ..base.files.run_folder import RunFolder
from ..identify.fit_result import Fit
from ..kinematics.backlash_map import BacklashMap
from ..posterior.summary.bands import BandedMap
from ..posterior.summary.posterior import Posterior
from ..posterior.summary.predictive import Predictive
from .backlash_map import plot_band_map, plot_map
from .corner_picture import plot_corner
from .fit import plot_fit
from .order_spectrum import plot_orders
from .predictive import plot_predictive
from .residual import plot_residual
from .trace_picture import plot_trace

_DPI = 150


def png(figure: Figure) -> bytes:
    """A figure as PNG at 150 dpi: the same figure gives the same bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": "vttig_jax"})
    return buffer.getvalue()


def figures(fit: Fit, grid: BacklashMap | None) -> dict[str, bytes]:
    """PNG of every picture of a fit by file name.

    `te_fit.png`, `orders.png`, `residual.png`, and `backlash_map.png` where there is a map.

    **Arguments**
    - `fit`: the result of a fit.
    - `grid`: its backlash map; None leaves that picture out.
    """
    drawn = {
        "te_fit.png": plot_fit(fit),
        "orders.png": plot_orders(fit),
        "residual.png": plot_residual(fit),
    }
    if grid is not None:
        drawn["backlash_map.png"] = plot_map(grid)
    return {name: png(figure) for name, figure in drawn.items()}


def posterior_figures(
    posterior: Posterior, predicted: Predictive, banded: BandedMap | None
) -> dict[str, bytes]:
    """PNG of every picture of a posterior by file name.

    `corner.png`, `trace.png`, `predictive.png`, and `band.png` where there is a map.
    """
    drawn = {
        "corner.png": plot_corner(posterior),
        "trace.png": plot_trace(posterior),
        "predictive.png": plot_predictive(predicted),
    }
    if banded is not None:
        drawn["band.png"] = plot_band_map(banded)
    return {name: png(figure) for name, figure in drawn.items()}


def save_figures(
    fit: Fit, grid: BacklashMap | None, folder: str | Path, *, overwrite: bool = False
) -> list[str]:
    """Write `figures(fit, grid)` into a folder, all of them or none, and return their names.

    **Raises** `UsageError` for files that exist unless `overwrite`, `InputError` where the folder
    cannot be written.
    """
    drawn = figures(fit, grid)
    with RunFolder(folder, overwrite=overwrite) as run:
        for name, data in drawn.items():
            run.write_bytes(name, data)
    return list(drawn)
