"""From an object to its picture and to the bytes of files."""

import struct
import subprocess
import sys

import numpy as np
import pytest

from vttig_jax.geometry import Deviations, tooth_of
from vttig_jax.geometry.contact_report import Contacts
from vttig_jax.kinematics import BacklashMap
from vttig_jax.plotting import plot, plot_contact, plot_deviations, plot_map, png
from vttig_jax.plotting.save import figures


def loads_pyplot(statement: str) -> bool:
    code = f"import sys\n{statement}\nprint('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {"True": True, "False": False}[done.stdout.strip()]


def test_the_picture_follows_the_object_and_a_name(make_curve, make_fit, paper_pair):
    fit = make_fit()
    grid = BacklashMap(fit.model, None, paper_pair)
    assert plot(make_curve("A")).axes[0].get_ylabel() == "transmission error [arcsec]"
    assert plot(fit).axes[-1].get_ylabel() == "residual [arcsec]"
    (ax,), (direct,) = plot(grid, turns=3).axes, plot_map(grid, turns=3).axes
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), direct.lines[0].get_ydata())
    figure = plot(tooth_of(paper_pair, "driving"), name="of the paper")
    assert figure.get_suptitle() == "tooth of 45 · of the paper"
    assert plot.dispatch(Contacts) is plot_contact
    assert plot.dispatch(Deviations) is plot_deviations
    assert fit.plot("orders").get_suptitle().startswith("order spectrum")
    assert fit.plot("residual").get_suptitle().startswith("residual")
    with pytest.raises(ValueError, match="`name` must be one of te, orders, residual"):
        fit.plot("trace")


def test_options_reach_the_picture_and_wrong_ones_are_refused(make_curve, make_fit):
    curve = make_curve("A")
    assert plot(curve, unit="deg").axes[0].get_ylabel() == "transmission error [°]"
    assert plot(make_fit(), span_deg=(100.0, 200.0)).axes[0].get_xlim() == (100.0, 200.0)
    with pytest.raises(TypeError, match="turns"):
        plot(curve, turns=3)
    words = r"`obj` must be an EncoderLog, .* Deviations, but is int\."
    with pytest.raises(ValueError, match=words):
        plot(3)


def test_pyplot_is_never_imported():
    modules = "dispatch", "save", "order_spectrum", "residual"
    draw = "from vttig_jax.plotting.save import png; from matplotlib.figure import Figure;"
    draw += "figure = Figure(); figure.subplots(); png(figure)"
    imports = ";".join(f"import vttig_jax.plotting.{module}" for module in modules)
    assert not loads_pyplot(f"{imports}\n{draw}")
    assert loads_pyplot("import matplotlib.pyplot")  # the check can fail


NAMES = ["te_fit.png", "orders.png", "residual.png", "backlash_map.png"]


@pytest.fixture(scope="module")
def grid(make_fit, paper_pair) -> BacklashMap:
    return BacklashMap(make_fit().model, None, paper_pair)


@pytest.fixture(scope="module")
def drawn(make_fit, grid) -> dict[str, bytes]:
    return figures(make_fit(), grid)


def test_pictures_are_1200_pixels_wide_and_the_same_for_the_same_fit(drawn, make_fit, grid):
    assert list(drawn) == NAMES
    for data in drawn.values():
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">I", data[16:20]) == (1200,)
    assert figures(make_fit(), grid) == drawn
    other = figures(make_fit(residual_arcsec=5.0), None)
    assert other["te_fit.png"] != drawn["te_fit.png"]
    assert other["orders.png"] == drawn["orders.png"]


def test_the_bytes_hold_no_date_and_one_direction_has_no_map(make_curve, worm_fit):
    data = png(plot(make_curve("A")))
    assert b"vttig_jax" in data
    assert b"Matplotlib" not in data and b"tIME" not in data
    assert list(figures(worm_fit, None)) == NAMES[:3]
