"""PNG files of the pictures of a fit and of a posterior."""

from io import BytesIO

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..identify.result import Fit
from ..kinematics.backlash_map import BacklashMap
from ..posterior.summary.bands import BandedMap
from ..posterior.summary.posterior import Posterior
from .backlash_map import plot_band_map, plot_map
from .corner_picture import plot_corner
from .fit import plot_fit
from .order_spectrum import plot_orders
from .residual import plot_residual
from .trace_picture import plot_trace

_DPI = 150
_COMPRESSION = 2  # of zlib, 1 to 9; chosen: half of the time of 6, and 9 % more bytes


def png(figure: Figure, *, run: str = "") -> bytes:
    """Return a figure as PNG at 150 dpi; equal figures give equal bytes.

    `run` is the digest of the run of the picture; if it is given, it is written to the metadata.
    """
    buffer = BytesIO()
    metadata = {"Software": "vttig_jax"} | ({"Source": f"run {run}"} if run else {})
    canvas, dpi = figure.canvas, figure.dpi
    try:
        figure.set_dpi(_DPI)
        # `savefig` draws every figure twice, once to find places that only some formats need.
        FigureCanvasAgg(figure).print_png(
            buffer, metadata=metadata, pil_kwargs={"compress_level": _COMPRESSION}
        )
    finally:
        figure.set_canvas(canvas)
        figure.set_dpi(dpi)
    return buffer.getvalue()


def figures(fit: Fit, grid: BacklashMap | None, *, run: str = "") -> dict[str, bytes]:
    """Return the PNG data of every picture of a fit by file name.

    The names are `te_fit.png`, `orders.png`, `residual.png`, and `backlash_map.png` with a map.

    **Arguments**
    - `fit`: result of a fit.
    - `grid`: its backlash map; None omits that picture.
    - `run`: digest of the run, for the metadata of the pictures.
    """
    drawn = {
        "te_fit.png": plot_fit(fit),
        "orders.png": plot_orders(fit),
        "residual.png": plot_residual(fit),
    }
    if grid is not None:
        drawn["backlash_map.png"] = plot_map(grid)
    return {name: png(figure, run=run) for name, figure in drawn.items()}


def posterior_figures(
    posterior: Posterior, banded: BandedMap | None, *, run: str = ""
) -> dict[str, bytes]:
    """Return the PNG data of every picture of a posterior by file name.

    The names are `corner.png`, `trace.png`, and `band.png` with a map. `run` is the digest of the
    run, for the metadata of the pictures.
    """
    drawn = {
        "corner.png": plot_corner(posterior),
        "trace.png": plot_trace(posterior),
    }
    if banded is not None:
        drawn["band.png"] = plot_band_map(banded)
    return {name: png(figure, run=run) for name, figure in drawn.items()}
