"""PNG files of the pictures of a fit and of a posterior."""

from collections.abc import Callable
from io import BytesIO

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..identify.result import Fit
from ..kinematics.backlash_map import BacklashMap
from ..posterior.summary.bands import BandedMap
from ..posterior.summary.posterior import Posterior
from .backlash_map import plot_band_map, plot_map
from .fit import plot_fit
from .order_spectrum import plot_orders
from .posterior_pictures import plot_corner, plot_trace
from .residual import plot_residual

_PICTURES: dict[type, dict[str, Callable[..., Figure]]] = {
    Fit: {
        "te_fit": plot_fit,
        "orders": plot_orders,
        "residual": plot_residual,
        "backlash_map": plot_map,
    },
    Posterior: {"corner": plot_corner, "trace": plot_trace, "band": plot_band_map},
}
"""Pictures of a run by the names of their files; the last one of each is that of the map."""

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


def figures(
    found: Fit | Posterior, grid: BacklashMap | BandedMap | None, *, run: str = ""
) -> dict[str, bytes]:
    """Return the PNG data of every picture of a fit, or of a posterior, by file name.

    The names are `te_fit.png`, `orders.png`, `residual.png`, and `backlash_map.png` with a map; of
    a posterior `corner.png`, `trace.png`, and `band.png` with a map.

    **Arguments**
    - `found`: result of a fit, or a posterior.
    - `grid`: its backlash map, that of a posterior with bands; None omits that picture.
    - `run`: digest of the run, for the metadata of the pictures.
    """
    *pictures, of_map = _PICTURES[type(found)].items()
    drawn = [(name, draw(found)) for name, draw in pictures]
    if grid is not None:
        name, draw = of_map
        drawn.append((name, draw(grid)))
    return {f"{name}.png": png(figure, run=run) for name, figure in drawn}
