"""Lines of the residual join the model; the likelihood tells them from the orders beside them."""

from pathlib import Path

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.logs import read_log
from vttig_jax.pair import load_pair
from vttig_jax.pair.schema import HarmonicOrders

PAIR = drive("9/16", orders=(1, 2, 3, 4))
MOTION = there_and_back([60, 40], 10)  # ten turns: the resolution is 0.1


seeds = pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)


def logged(parts: dict[float, float], *, seed: int = 0, start_turns: float = 0.0, other: float = 1):
    """A log with lines {cycles: arcsec}; on flank B they have `other` times the amplitude."""

    def error(angle, _):
        first = 20 * np.sin(angle + 0.3) + 30 * np.sin(angle * 9 / 16 + 1)
        return first + sum(a * np.sin(c * angle + 0.7 + c) for c, a in parts.items())

    def gap(angle, _):
        more = [(other - 1) * a * np.sin(c * angle + 0.7 + c) for c, a in parts.items()]
        return 200.0 + np.sum([0 * angle, *more], axis=0)

    return drive_log(
        PAIR,
        MOTION,
        gap=gap,
        error=error,
        noise_arcsec=1.0,
        rate_hz=80.0,
        seed=seed,
        start_turns=start_turns,
    )


def fitted(parts: dict[float, float], seed: int = 0, **options) -> Fit:
    return fit(logged(parts, seed=seed), PAIR, delay="off", **options)


def of(result: Fit, order: float) -> list[float]:
    """Amplitudes of an order of the driving shaft that are significant."""
    rows = [o for o in result.judged_orders() if (o.shaft, o.order) == ("driving", order)]
    return [one.amplitude_arcsec for one in rows if one.significant]


@seeds
@pytest.mark.parametrize("apart", [0.087, 0.06])
def test_a_line_takes_the_place_of_the_order_beside_it(apart, seed):
    """Both are closer than the resolution."""
    result = fitted({3 + apart: 20.0}, seed)
    (line,) = result.checks.joined_lines
    assert line.replaced == ("driving order 3",)
    assert abs(line.cycles_per_rev - 3 - apart) < 4 * line.cycles_std < 0.01
    assert of(result, line.order) == pytest.approx([20.0, 20.0], abs=0.5)
    assert not of(result, 3) and not result.checks.lines
    assert f"joined the model as driving order {line.order}" in str(result)
    assert "driving order 3 is left out" in str(result)
    assert result.residual_rms_deg * 3600 == pytest.approx(1.0, rel=0.05)


def test_the_digits_are_those_that_the_log_tells():
    faint, strong = (fitted({3.46: a}).checks.joined_lines[0] for a in (1.0, 100.0))
    places = [len(str(line.order).partition(".")[2]) for line in (faint, strong)]
    assert places[0] < places[1]
    for line in (faint, strong):
        assert abs(line.order - line.cycles_per_rev) <= line.cycles_std


def test_an_order_that_is_there_stays():
    """A line and an order less than one resolution apart."""
    result = fitted({3.0: 15.0, 3.087: 20.0})
    (line,) = result.checks.joined_lines
    assert line.replaced == ()
    assert of(result, 3) == pytest.approx([15.0, 15.0], abs=1.0)
    assert of(result, line.order) == pytest.approx([20.0, 20.0], abs=1.0)


@seeds
@pytest.mark.parametrize(
    "parts",
    [
        {},
        {3.0: 20.0},
        {5.0: 20.0},  # an order that is not listed
        {7 * 9 / 16: 20.0},
    ],
)
def test_whole_orders_and_noise_do_not_join(parts, seed):
    result = fitted(parts, seed)
    assert not result.checks.joined_lines
    listed = not parts or 3.0 in parts
    assert listed == (not result.checks.lines)
    assert result.model.terms == fitted(parts, seed, lines="report").model.terms


def test_lines_may_only_be_reported():
    result = fitted({3.46: 20.0}, lines="report")
    assert not result.checks.joined_lines and len(result.checks.lines) == 1
    assert all(isinstance(one.order, int) for one in result.orders)


def test_a_line_of_changing_amplitude_makes_no_order():
    """Its amplitude doubles over the log, so that a line of one amplitude leaves sidebands."""

    def error(angle, _):
        line = 30 * (1 + 0.03 * angle / np.pi) * np.sin(3.12 * angle)
        return 20 * np.sin(angle + 0.3) + 30 * np.sin(angle * 9 / 16 + 1) + line

    log = drive_log(PAIR, MOTION, gap=level(200.0), error=error, rate_hz=80.0)
    result = fit(log, PAIR, delay="off")
    (line, *_) = result.checks.joined_lines
    assert abs(line.order - 3.12) < 0.01 and not of(result, 3)


def test_a_given_order_takes_the_place_of_its_neighbour_too():
    orders = HarmonicOrders((1, 2, 3, 3.06), (1,), 0)
    result = fitted({3.06: 20.0}, orders=orders)
    assert not of(result, 3) and of(result, 3.06) == pytest.approx([20.0, 20.0], abs=0.5)
    assert 3 not in [one.order for one in result.orders if one.shaft == "driving"]
    other = fitted({3.0: 20.0}, orders=HarmonicOrders((1, 2, 3, 3.06), (1,), 0))
    assert of(other, 3) == pytest.approx([20.0, 20.0], abs=1.5) and not of(other, 3.06)


def test_a_line_may_differ_between_the_flanks():
    result = fit(logged({3.46: 10.0}, other=2.0), PAIR, delay="off")
    (line,) = result.checks.joined_lines
    assert of(result, line.order) == pytest.approx([10.0, 20.0], abs=0.5)


def test_a_line_beside_a_first_order_is_only_reported():
    result = fitted({0.85: 20.0})
    assert not result.checks.joined_lines and result.checks.lines


def test_lines_of_logs_without_a_common_zero_are_only_reported():
    logs = [logged({3.46: 20.0}), logged({3.46: 20.0}, seed=1, start_turns=0.37)]
    result = fit(logs, PAIR, delay="off")
    assert not result.checks.joined_lines
    assert {line.log for line in result.checks.lines} == {1, 2}


def test_a_hidden_shaft_is_named():
    parts = {1.5437: 4.0, 3.0874: 20.0, 4.6311: 5.0}
    result = fitted(parts)
    (shaft,) = result.checks.hidden_shafts
    assert shaft.orders == (1, 2, 3)
    assert abs(shaft.turns_per_rev - 1.5437) < 4 * shaft.turns_std < 0.002
    assert "a hidden shaft turns 1.54" in str(result)
    other = fitted({1.61: 4.0, 3.0874: 20.0, 4.6311: 5.0})
    assert not other.checks.hidden_shafts


@pytest.mark.parametrize("log", ["A", pytest.param("B", marks=pytest.mark.slow)])
def test_a_robot_axis_has_a_hidden_shaft(data_dir, log):
    """Its lines beside slow errors are too rough to be multiples; the spectrum at them tells."""
    pair = load_pair(Path(__file__).parents[3] / "fits" / "kuka_kr300" / "axis2.toml")
    table = data_dir / "kuka_kr300" / f"kr300_{log}_axes123.csv"
    (shaft,) = fit(read_log(table, pair), pair).checks.hidden_shafts
    assert shaft.orders == (1, 2, 3, 4) and shaft.coincidence < 1e-4
    assert shaft.turns_per_rev == pytest.approx(1.5448, abs=2e-4)
