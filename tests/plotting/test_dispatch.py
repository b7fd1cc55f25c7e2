import subprocess
import sys

import numpy as np
import pytest

from vttig_jax.geometry.contact_report import Contacts
from vttig_jax.geometry.deviations import Deviations
from vttig_jax.geometry.tooth import tooth_of
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.plotting.backlash_map import plot_map
from vttig_jax.plotting.contact import plot_contact
from vttig_jax.plotting.deviations import plot_deviations
from vttig_jax.plotting.dispatch import plot


def loads_pyplot(statement: str) -> bool:
    code = f"import sys\n{statement}\nprint('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {"True": True, "False": False}[done.stdout.strip()]


def test_the_picture_follows_the_object(make_curve, make_fit, paper_pair):
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


def test_a_name_chooses_the_picture(make_fit):
    fit = make_fit()
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
