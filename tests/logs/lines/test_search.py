"""Lines found blind: planted ones with their numbers, none in noise, and those of measured logs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from vttig_jax.base.angles import difference_deg
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.logs.lines.rows import (
    APART,
    Stretch,
    filter_of_order,
    orthonormal,
    stack,
    transposed,
    whitened,
)
from vttig_jax.logs.lines.search import (
    Line,
    Spectrum,
    false_alarm_probability,
    find_lines,
    may_be_highest,
    noise_level,
    relative_height,
)


def powers(rows: int, highest: int = 2) -> np.ndarray:
    return np.vander(np.linspace(-1, 1, rows), highest + 1)


def coloured(rows: int, poles: list[float], seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(rows + 500)
    return np.asarray(lfilter([1.0], poles, noise))[500:]


def run_of(angle, arcsec, nuisance=None, group="") -> Stretch:
    columns = powers(len(angle)) if nuisance is None else nuisance
    return Stretch(angle, arcsec * ARCSEC, columns, group)


def sine(angle: np.ndarray, cycles: float, amplitude: float, phase_deg: float) -> np.ndarray:
    return amplitude * np.sin(cycles * angle + phase_deg * DEG)


def assert_is(line: Line, cycles: float, amplitude: float, phase_deg: float) -> None:
    """Within four standard errors, the phase at driving angle zero roughly."""
    assert abs(line.cycles_per_rev - cycles) < 4 * line.cycles_std
    assert abs(line.amplitude_arcsec - amplitude) < 4 * line.amplitude_std_arcsec
    assert abs(difference_deg(line.phase_deg, phase_deg)) < 30.0


STEADY = REV * np.linspace(3.0, 23.0, 1500)


@pytest.mark.parametrize("poles", [[1.0], [1.0, -0.8], [1.0, -1.6, 0.7]])
@pytest.mark.parametrize("cycles", [0.37, 3.09, 17.3])
def test_a_planted_line_is_found_with_its_numbers(poles, cycles):
    noise = coloured(1500, poles, 1)
    gain = abs(1 / np.polyval(poles[::-1], np.exp(-1j * REV * cycles * 20.0 / 1499)))
    amplitude = 0.4 * gain
    values = sine(STEADY, cycles, amplitude, 40.0) + noise
    [line] = find_lines([run_of(STEADY, values)], highest=25.0)
    assert_is(line, cycles, amplitude, 40.0)
    # The bound for white noise of the same density: σ_a = σ √(2/n), σ_f = √6 σ/(π a T √n).
    assert line.amplitude_std_arcsec == pytest.approx(gain * np.sqrt(2 / 1500), rel=0.25)
    expected = np.sqrt(6 / 1500) * gain / (np.pi * amplitude * 20.0)
    assert line.cycles_std == pytest.approx(expected, rel=0.3)
    assert line.false_alarm < 1e-6


def test_a_run_without_rows_changes_nothing():
    run = run_of(STEADY, sine(STEADY, 3.09, 0.4, 40.0) + coloured(1500, [1.0], 1))
    empty = Stretch(np.zeros(0), np.zeros(0), np.zeros((0, run.nuisance.shape[1])))
    assert find_lines([run, empty, run], highest=25.0) == find_lines([run, run], highest=25.0)


@pytest.mark.usefixtures("unchecked")
def test_standard_errors_are_those_of_many_draws():
    """Amplitude and frequency over their standard errors have unit spread."""
    angle, scores = STEADY[:600], []
    for seed in range(40):
        values = sine(angle, 3.3, 3.0, 10.0) + coloured(600, [1.0, -0.7], seed)
        [line] = find_lines([run_of(angle, values)], highest=12.0, most=1)
        amplitude = (line.amplitude_arcsec - 3.0) / line.amplitude_std_arcsec
        scores.append((amplitude, (line.cycles_per_rev - 3.3) / line.cycles_std))
    assert np.all(np.abs(np.mean(scores, axis=0)) < 0.5)
    assert np.all(np.abs(np.std(scores, axis=0) - 1) < 0.35)


@pytest.mark.parametrize("ratio", [2.0, 20.0, 2000.0])
def test_a_strong_line_is_not_taken_for_colour(ratio):
    """The autoregression beside no line turns it into noise; the unwhitened scan does not."""
    noise = coloured(1500, [1.0], 2)
    [line] = find_lines([run_of(STEADY, sine(STEADY, 3.09, ratio, 300.0) + noise)], highest=20.0)
    assert_is(line, 3.09, ratio, 300.0)


WHITE, SWING = STEADY[:400], REV * 5 * (1 - np.cos(np.linspace(0, 3 * np.pi, 800)))
PACE = np.abs(np.gradient(SWING)) / np.abs(np.gradient(SWING)).max()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("angle", "poles", "size", "highest"),
    [
        *((WHITE, [1.0, *more], 1.0, 15.0) for more in ([], [-0.9], [-0.98], [-1.76, 0.94])),
        (SWING, [1.0, -0.6], 0.2 + PACE, 8.0),  # noise that grows with speed
    ],
)
def test_noise_alone_shows_no_line(angle, poles, size, highest):
    """At one false alarm in a hundred, 40 logs of each kind show two at most."""
    alarms = 0
    for seed in range(40):
        run = run_of(angle, coloured(len(angle), poles, seed) * size)
        alarms += bool(find_lines([run], highest=highest, false_alarm=0.01, most=1))
    assert alarms <= 2


def test_the_level_at_some_frequencies_is_that_of_the_whole_spectrum():
    """And the rough choice of frequencies contains the highest, however strong the lines are."""
    turns = np.linspace(0.0, 900.0, 9000)
    for seed in range(3):
        noise = coloured(9000, [1.0, -0.9], seed)
        value = noise + sum(sine(REV * turns, c, 0.5 * 10**seed, 0.0) for c in (1.234, 3.07))
        rows = stack([run_of(REV * turns, value, np.ones((9000, 1)))], 4.0)
        spectrum = Spectrum.of(rows, 4.0)
        height = spectrum.height(rows.value - rows.value.mean(), np.ones(1))
        lines = np.array([1.234])
        level, freedom = noise_level(spectrum, height, lines, spectrum.cycles)
        some = spectrum.cycles[np.random.default_rng(seed).integers(0, len(level), 40)]
        near = noise_level(spectrum, height, lines, some)
        np.testing.assert_allclose(near[0], np.interp(some, spectrum.cycles, level), rtol=1e-4)
        places = np.flatnonzero(np.abs(spectrum.cycles - 1.234) * 900 >= 1)
        score = relative_height(height / level, freedom)[places]
        kept = may_be_highest(spectrum, height, lines, places)
        assert kept[np.argmax(score)] and kept.mean() < 0.2


@pytest.mark.parametrize(
    "poles", [[1.0, -0.5], [1.0, -1.76, 0.94], [1.0, -2.994, 2.988011, -0.994010994]]
)
def test_the_filter_is_the_regression_on_predecessors(poles):
    """Against least squares over every row with enough predecessors, for smooth noise as well."""
    rows = stack([run_of(STEADY, coloured(1500, poles, k), None, "AB"[k]) for k in (0, 1)], 25.0)
    order = len(poles) + 2
    lines, right = [], []
    for run in rows.runs:
        values = rows.value[run]
        for k in range(order, len(values)):
            lines.append(values[k - order : k][::-1])
            right.append(values[k])
    exact = np.linalg.lstsq(np.array(lines), np.array(right), rcond=None)[0]
    taps = filter_of_order(rows, rows.value, order)
    np.testing.assert_allclose(taps, [1.0, *-exact], rtol=1e-5, atol=1e-6)
    white = whitened(rows, rows.value, taps)
    for run in rows.runs:
        expected = np.convolve(rows.value[run], taps)[order : run.stop - run.start]
        np.testing.assert_allclose(white[run][order:], expected, atol=1e-14 * abs(rows.value).max())
        assert not white[run][:order].any()
    probe, other = np.random.default_rng(1).standard_normal((2, len(white)))
    other[white == 0] = 0.0
    left, back = whitened(rows, probe, taps) @ other, probe @ transposed(other, taps)
    np.testing.assert_allclose(left, back, rtol=1e-9)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("share", [1e-3, 1e-1])
def test_the_probability_is_that_of_noise(share):
    """Independent check: the maximum of the spectrum over many draws of white noise."""
    angle = REV * np.linspace(0.0, 10.0, 200)
    columns = np.ones((200, 1))
    generator = np.random.default_rng(0)
    chances = []
    for _ in range(400):
        rows = stack([Stretch(angle, generator.standard_normal(200), columns)], 8.0)
        spectrum = Spectrum.of(rows, 8.0)
        height = spectrum.height(rows.without_regressors(rows.value), np.ones(1)).max()
        bandwidth = float(np.ptp(spectrum.cycles))
        chances.append(false_alarm_probability(float(height), rows.turns, bandwidth))
    assert np.mean(np.array(chances) < share) <= share + 3 * np.sqrt(share / 400)
    # Sharp for small probabilities, a bound elsewhere.
    assert share < 0.05 or np.mean(np.array(chances) < share) > 0.4 * share


def test_two_close_lines():
    """Two resolutions apart, of unequal strength."""
    truth = [(5.0, 3.0, 20.0), (5.1, 1.5, 200.0)]
    values = sum(sine(STEADY, *line) for line in truth) + coloured(1500, [1.0, -0.5], 3)
    lines = find_lines([run_of(STEADY, values)], highest=20.0)
    for line, expected in zip(sorted(lines, key=lambda x: x.cycles_per_rev), truth, strict=True):
        assert_is(line, *expected)


def test_lines_do_not_merge():
    """A line that comes and goes: neighbours, but none of absurd amplitude."""
    envelope = np.cos(np.linspace(-1, 1, 1500) * 3.0)
    values = envelope * sine(STEADY, 3.1, 6.0, 0.0) + coloured(1500, [1.0], 4)
    lines = find_lines([run_of(STEADY, values)], highest=10.0, most=4)
    found = np.sort([line.cycles_per_rev for line in lines])
    assert len(found) > 1 and np.min(np.diff(found)) > 0.999 * APART / 20.0
    assert max(line.amplitude_arcsec for line in lines) < 6.0


def test_drift_is_no_line_and_hides_none():
    u = np.linspace(-1, 1, 1500)
    drift = 300 * u + 200 * u**2 + np.cumsum(np.random.default_rng(5).standard_normal(1500)) * 0.5
    noise = coloured(1500, [1.0], 5) + drift
    assert find_lines([run_of(STEADY, noise)], highest=20.0) == ()
    line, *more = find_lines([run_of(STEADY, noise + sine(STEADY, 0.4, 30.0, 120.0))], highest=20.0)
    assert more == []
    assert_is(line, 0.4, 30.0, 120.0)


def test_gaps_runs_and_groups():
    """Runs of two groups share the line; each group has a drift of its own."""
    pieces = [(0.0, 5.0, "A"), (5.5, 6.0, "B"), (9.0, 15.0, "B"), (15.2, 22.0, "A")]
    pieces, runs = [*pieces, (22.1, 22.2, "B")], []
    for number, (first, last, group) in enumerate(pieces):
        angle = REV * np.arange(first, last, 0.01)
        noise = coloured(len(angle), [1.0, -0.7], number)
        drift = {"A": 100 + 2 * angle, "B": -50 - 3 * angle}[group]
        columns = np.column_stack([np.ones(len(angle)), angle])
        runs.append(run_of(angle, sine(angle, 2.71, 2.0, 70.0) + noise + drift, columns, group))
    [line] = find_lines(runs, highest=10.0)
    assert_is(line, 2.71, 2.0, 70.0)


def test_groups_may_have_different_columns():
    angle = REV * np.arange(0.0, 8.0, 0.01)
    values = sine(angle, 2.71, 2.0, 70.0) + coloured(800, [1.0], 0)
    runs = [run_of(angle, values, np.ones((800, 1)), "A"), run_of(-angle, values, group="B")]
    assert len(find_lines(runs, highest=4.0)) >= 1


def test_reversing_motion_counts_cycles_of_the_angle():
    """The line is no line in time, where nothing periodic is left at constant frequency."""
    phase = np.linspace(0.0, 2 * np.pi, 3000)
    angle = REV * 10 * np.sin(phase)
    time = np.linspace(0.0, 6.0, 3000)
    columns = np.column_stack([np.ones(3000), np.cos(phase), np.sin(phase)])
    values = sine(angle, 3.09, 1.0, 250.0) + coloured(3000, [1.0, -0.6], 7)
    [line] = find_lines([run_of(angle, values, columns)], highest=8.0)
    assert_is(line, 3.09, 1.0, 250.0)
    wrong = find_lines([run_of(REV * time, values, columns)], highest=60.0, most=1)
    assert not wrong or wrong[0].false_alarm > line.false_alarm


def test_dense_rows_are_averaged_and_amplitudes_keep_their_size():
    rows = 70_000
    angle = REV * np.linspace(0.0, 60.0, rows)
    noise = np.random.default_rng(9).standard_normal(rows)
    runs = [run_of(angle, sine(angle, 5.3, 1.0, 30.0) + noise, powers(rows, 1))]
    [line] = find_lines(runs, highest=6.0)
    assert stack(runs, 6.0).starts[-1] < 3000
    assert_is(line, 5.3, 1.0, 30.0)


def test_thousands_of_turns_are_searched():
    """A weak line of a log of 4500 turns each way."""
    turns = np.concatenate([np.linspace(0, 4500, 90_000), np.linspace(4500, 0, 90_000)])
    values = sine(REV * turns, 3.0871, 0.3, 60.0) + coloured(180_000, [1.0, -0.9], 3)
    parts = zip(np.split(REV * turns, 2), np.split(values, 2), "AB", strict=True)
    halves = [run_of(x, y, np.ones((90_000, 1)), name) for x, y, name in parts]
    [line] = find_lines(halves, highest=6.0)
    assert_is(line, 3.0871, 0.3, 60.0)


@settings(max_examples=6)
@given(
    cycles=st.floats(0.5, 9.0),
    phase_deg=st.floats(0.0, 359.0),
    start=st.floats(-1e4, 1e4),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_any_line_without_noise(cycles, phase_deg, start, sign):
    """Numbers of a clean line are those planted, wherever the angle starts and however it runs."""
    angle = sign * REV * (start + np.linspace(0.0, 12.0, 400))
    noise = 1e-4 * coloured(400, [1.0], 0)
    values = sine(angle, cycles, 5.0, phase_deg) + noise
    line = find_lines([run_of(angle, values)], highest=10.0, most=1)[0]
    assert line.cycles_per_rev == pytest.approx(cycles, abs=1e-5)
    assert line.amplitude_arcsec == pytest.approx(5.0, rel=1e-3)
    error_deg = float(difference_deg(line.phase_deg, phase_deg))
    assert abs(error_deg) < 0.1 + 4 * 360 * line.cycles_std * (abs(start) + 12.0)


def test_nothing_to_find():
    noise, few = coloured(1500, [1.0], 0), run_of(STEADY[:10], np.ones(10), np.ones((10, 1)))
    for values in (np.zeros(1500), 1e3 * powers(1500)[:, 0]):
        assert find_lines([run_of(STEADY, values)], highest=20.0) == ()
    assert find_lines([run_of(np.zeros(1500), noise)], highest=20.0) == ()
    assert find_lines([few], highest=2.0) == ()
    assert find_lines([run_of(STEADY, noise)], highest=0.01) == ()
    assert find_lines([run_of(STEADY, sine(STEADY, 3.0, 9.0, 0.0))], highest=20.0, most=0) == ()


def test_columns_that_repeat_each_other_count_once():
    doubled = np.column_stack([powers(1500), powers(1500), np.zeros(1500)])
    basis, mixing = orthonormal(doubled)
    assert basis.shape == (1500, 3)
    np.testing.assert_allclose(doubled @ mixing, basis, atol=1e-12)
    values = sine(STEADY, 3.0, 2.0, 0.0) + coloured(1500, [1.0], 0)
    assert len(find_lines([run_of(STEADY, values, doubled)], highest=20.0)) == 1


def test_regressors_that_hide_low_frequencies_hide_no_line_above():
    """Where most trials of a stretch coincide with regressors their usual power is unknown."""
    turns = np.linspace(0.0, 4.4, 300)
    angle = 2 * np.pi * turns
    orders = (0.4375, 0.5625, 1.0, 1.125, 1.5625, 2.0)
    harmonics = [wave(order * angle) for order in orders for wave in (np.cos, np.sin)]
    nuisance = np.stack([np.ones(300), turns, turns**2, *harmonics], axis=1)
    noise = np.random.default_rng(4).normal(0.0, 1e-5, 300)
    run = Stretch(angle, 1e-4 * np.sin(3.0 * angle) + noise, nuisance)
    [line] = find_lines([run], highest=10.0)
    assert line.cycles_per_rev == pytest.approx(3.0, abs=0.01)
