import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.container import BarContainer
from matplotlib.patches import Rectangle

from vttig_jax.identify.orders import Order
from vttig_jax.plotting import plot_orders

pytestmark = pytest.mark.smoke


def bars(ax: Axes) -> list[tuple[float, float, float, bool]]:
    """Place, height, standard error and whether it is filled, of every bar from the left."""
    found = []
    for container in ax.containers:
        if not isinstance(container, BarContainer):
            continue
        bar = container.patches[0]
        assert isinstance(bar, Rectangle) and container.errorbar is not None
        segment = container.errorbar.lines[2][0].get_segments()[0]
        place = bar.get_x() + bar.get_width() / 2
        filled = to_rgba(bar.get_facecolor())[3] > 0
        found.append((place, bar.get_height(), np.ptp(segment[:, 1]) / 2, filled))
    return sorted(found)


@pytest.mark.parametrize("log", [True, False])
def test_bars_are_the_orders(make_fit, log):
    fit = make_fit()
    axes = plot_orders(fit, log=log).axes
    for ax, shaft in zip(axes, ("driving", "driven", "mesh"), strict=True):
        orders = [o for o in fit.orders if o.shaft == shaft]
        drawn = bars(ax)
        assert [bar[1] for bar in drawn] == [o.amplitude_arcsec for o in orders]
        assert [bar[2] for bar in drawn] == pytest.approx([o.std_arcsec for o in orders])
        assert [bar[3] for bar in drawn] == [o.significant for o in orders]
        low, high = ax.get_ylim()
        assert low < min(o.amplitude_arcsec for o in fit.orders)
        assert high > max(o.amplitude_arcsec + o.std_arcsec for o in fit.orders)
        assert ax.get_yscale() == ("log" if log else "linear") and (log or low == 0)
    # Flanks stand side by side.
    assert [bar[0] for bar in bars(axes[0])] == pytest.approx([-0.19, 0.19, 0.81, 1.19])


def test_the_largest_is_told_and_one_flank_stands_alone(make_fit, worm_fit):
    figure = plot_orders(make_fit())
    assert "driven 1, 92″" in figure.get_suptitle()
    assert [text.get_text() for text in figure.axes[0].get_xticklabels()] == ["1", "3"]
    figure = plot_orders(worm_fit)
    figure.draw_without_rendering()
    (ax,) = figure.axes
    assert bars(ax) == [(pytest.approx(0.0), 3.8, pytest.approx(0.05), True)]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["flank A"]


def test_noise_takes_no_room_and_names_stay_apart(make_fit):
    """An amplitude far below its standard error does not stretch the axis."""
    sizes = ((1.550484, 20.0, 0.1), (3.089837, 1.9, 0.1), (4, 0.001, 0.03))
    orders = tuple(Order("driving", n, "A", size, std, 0.0) for n, size, std in sizes)
    figure = plot_orders(make_fit(orders=orders))
    figure.draw_without_rendering()
    (ax,) = figure.axes
    assert ax.get_ylim()[0] == pytest.approx(0.01)
    assert [text.get_text() for text in ax.texts] == ["20"]  # no number on bars under a tenth
    names = [text.get_text() for text in ax.get_xticklabels()]
    assert names == ["1.5505", "3.0898", "4"]
    box = ax.texts[0].get_window_extent()
    assert box.y1 < ax.bbox.y1 and len(bars(ax)) == 3


def test_nothing_fitted_is_said_and_amplitudes_of_zero_can_be_drawn(make_fit):
    (ax,) = plot_orders(make_fit(orders=())).axes
    assert [text.get_text() for text in ax.texts] == ["no order was fitted"]
    figure = plot_orders(make_fit(orders=(Order("driving", 1, "A", 0.0, 0.1, 0.0),)))
    figure.draw_without_rendering()
    assert figure.axes[0].get_yscale() == "linear"
