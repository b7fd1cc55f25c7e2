import numpy as np
import pytest
from matplotlib.figure import Figure

from vttig_jax.plotting.curves import MOST_POINTS
from vttig_jax.plotting.fit import plot_te
from vttig_jax.plotting.style import FLANK_COLOURS, unit_size

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize(
    ("unit", "per_rad", "sign"), [("arcsec", 648000 / np.pi, "arcsec"), ("deg", 180 / np.pi, "°")]
)
def test_the_line_is_the_curve_with_its_words(make_curve, unit, per_rad, sign):
    curve = make_curve("B")
    (ax,) = plot_te(curve, unit=unit).axes
    (line,) = ax.lines
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    np.testing.assert_allclose(x, np.degrees(curve.driving_angle), rtol=1e-13)
    np.testing.assert_allclose(y, curve.transmission_error * per_rad, rtol=1e-13)
    assert ax.get_xlabel() == "driving angle [°]"
    assert ax.get_ylabel() == f"transmission error [{sign}]"
    assert ax.get_title(loc="left") == "transmission error, flank B"
    assert line.get_color() == FLANK_COLOURS["B"] != FLANK_COLOURS["A"]
    with pytest.raises(ValueError, match="`unit` must be arcsec or deg, but is 'mm'"):
        unit_size("mm")


def test_several_turns_have_ticks_at_whole_turns(make_curve):
    (ax,) = plot_te(make_curve("A", 0.0, 7560.0)).axes
    assert np.all(np.asarray(ax.get_xticks()) % 360 == 0)
    assert 5 <= len(ax.get_xticks()) <= 12
    (ax,) = plot_te(make_curve("A", 0.0, 90.0)).axes
    assert np.any(np.asarray(ax.get_xticks()) % 360 != 0)


def test_it_draws_on_given_axes_and_long_curves_are_thinned(make_curve):
    figure, curve = Figure(), make_curve("A", points=3 * MOST_POINTS)
    upper, lower = figure.subplots(2)
    assert plot_te(curve, ax=lower, unit="deg") is figure
    assert len(lower.lines) == 1 and not upper.lines
    y = np.asarray(lower.lines[0].get_ydata())
    assert len(y) <= MOST_POINTS
    assert np.ptp(y) == pytest.approx(np.degrees(curve.peak_to_peak), rel=1e-14)
