"""Fits of tables of readings at standstill."""

from pathlib import Path

import numpy as np
import pytest

import vttig_jax
from vttig_jax.base import NoAnswerError

ARCSEC = 1 / 3600
CORPUS = Path(__file__).parents[1] / "corpus"


def sines(phase: np.ndarray, *waves: tuple[float, float, float]) -> np.ndarray:
    """Sum of waves, each with its size, order and phase in °, over an angle in °."""
    parts = [size * np.sin(np.radians(order * phase + at)) for size, order, at in waves]
    return np.sum(parts, axis=0)


def written(path, head, *columns, form="%.18e"):
    np.savetxt(path, np.column_stack(columns), form, ",", header=head, comments="")
    return path


def readings(tmp_path, angle, error, *, ratio=1, noise=1.0, seed=1, turn=np.inf):
    """A file with readings of a reference and of an encoder with this error, ″."""
    noisy = error + np.random.default_rng(seed).normal(0.0, noise, len(angle))
    driven = (angle / ratio + noisy * ARCSEC) % turn
    return written(tmp_path / "table.csv", "reference_deg,encoder_deg", angle, driven)


def table(tmp_path, angle, *, ratio=1, **options):
    """Readings of an encoder that has orders 1 and 2."""
    error = sines(angle / ratio, (1800, 1, 40), (300, 2, 0))
    return readings(tmp_path, angle, error, ratio=ratio, noise=2.0, **options)


def fitted(path, ratio="1:1", *, perfect_gears=True, **options):
    columns = {"driving": "reference_deg", "driven": "encoder_deg"}
    log = vttig_jax.read_log(path, ratio=ratio, columns=columns, sample_rate_hz=1.0)
    return vttig_jax.fit(log, perfect_gears=perfect_gears, **options)


def near(order, true):
    assert abs(order.amplitude_arcsec - true) < 4 * order.std_arcsec
    assert order.std_arcsec < 4.0


@pytest.mark.parametrize(("step", "ratio", "turn"), [(10, 1, np.inf), (5, 1, 360), (15, 20, 360)])
def test_n_places_are_one_turn(tmp_path, step, ratio, turn):
    """n steps of 360°/n tell the first orders; a single-turn encoder wraps as it likes."""
    angle = ratio * np.tile(np.arange(0.0, 360.0, step), 2)
    result = fitted(table(tmp_path, angle, ratio=ratio, turn=turn), f"{ratio}:1")
    shaft = "driving" if ratio == 1 else "driven"
    found = {(one.shaft, one.order): one for one in result.orders}
    near(found[shaft, 1], 1800)
    near(found[shaft, 2], 300)
    assert result.parameters[f"{shaft}_encoder_arcsec"].determined
    assert not result.parameters["delay_s"].determined
    assert "no_delay" in result.conditional_on


@pytest.mark.parametrize(("step", "told"), [(3.25, True), (2.25, True), (2.5, False)])
def test_orders_that_look_alike_at_the_places(tmp_path, step, told):
    """The worm's first order is told before high orders of the table that look like it.

    In 2.5 turns from place to place it only changes its sign, which tells one of its two parts.
    """
    turns = step * np.arange(round(72 / step) + 1)
    places = 360 * np.tile(np.append(turns, turns[::-1]), 2)
    true = {("driving", 1): (18.0, 1.0), ("driven", 1): (25.0, 1 / 72)}
    error = sines(places, *((*one, 45.0) for one in true.values()))
    result = fitted(readings(tmp_path, places, error, ratio=72, seed=3), "72:1")
    found = {(one.shaft, one.order): one for one in result.orders if one.flank == "A"}
    assert (("driving", 1) in found) == told
    for name in [*true][0 if told else 1 :]:
        assert abs(found[name].amplitude_arcsec - true[name][0]) < 4 * found[name].std_arcsec < 3


@pytest.mark.parametrize(("step", "alike"), [(1.025, "nearly"), (36 / 37, "exactly")])
def test_two_first_orders_that_look_alike_are_told_with_their_spread(tmp_path, step, alike):
    """Neither takes over what the other one does: left out, driven 1 made driving 1 29″ ± 0.4″."""
    turns = step * np.arange(round(36 / step))
    places = 360 * np.tile(np.append(turns, turns[::-1]), 6)
    path = readings(tmp_path, places, sines(places, (8, 1, -10), (20, 1 / 36, 30)), ratio=36)
    found = fitted(path, "36:1", perfect_gears=False).parameters
    for shaft, true in (("driving", 8), ("driven", 20)):
        one = found[f"{shaft}_amplitude_arcsec"]
        assert one.determined == (alike == "nearly")
        if alike == "nearly":
            high = one.high95 or one.upper95
            assert one.std is not None and high is not None
            assert one.std > 1.0 and (one.low95 or 0.0) < true < high


def test_what_alternates_from_place_to_place_is_no_error_of_the_ratio(tmp_path):
    """A free ratio and five orders have all values at twelve places: told as 4.4″ ± 0.08″."""
    places = 360 * 7.5 * np.arange(12)
    draw, error = np.random.default_rng(3), sines(places, (2.5, 1, 60), (8.5, 1 / 90, 45))
    passes = [error + 7 * (-1) ** k + draw.normal(0.0, 0.5, 12) for k in range(10)]
    head = ",".join(
        ["worm [deg]", *(f"{way}{k} [arcsec]" for k in range(5) for way in ("up", "down"))]
    )
    path = written(tmp_path / "table.csv", head, places, *passes)
    log = vttig_jax.read_log(path, ratio="90:1", columns={"driving": "worm [deg]"})
    found = vttig_jax.fit(log)
    one = found.parameters["driven_amplitude_arcsec"]
    assert one.low95 is not None and one.high95 is not None
    assert one.low95 < 8.5 < one.high95 < 9.0
    assert "the_stated_ratio" in found.conditional_on


def test_a_first_order_with_the_values_of_another_one_is_told(tmp_path):
    """At eight places 11.25 driving turns apart driving 1 has those of driven 2."""
    steps = 11.25 * np.arange(8)
    places = 90 + 360 * np.tile(np.append(steps, steps[::-1]), 5)
    path = readings(tmp_path, places, sines(places, (8, 1 / 90, 0), (3, 1, 0)), ratio=90)
    found = fitted(path, "90:1", perfect_gears=False)
    severities = {one.severity for one in found.findings if one.slug == "orders-equal"}
    assert "warning" in severities


POSITION = {"driving": "position_deg", "driven": "measured_deg"}
TABLES = [
    ("still_signs_at_each_place", "1:1", POSITION),
    ("still_words_ccw_rises", "1:1", POSITION),
    ("passes_side_by_side", "1:1", {}),
    ("passes_of_errors", "1:1", {"driving": "target [°]"}),
    ("still_motor_wraps", "20:1", {}),
]


@pytest.mark.parametrize(("name", "ratio", "columns"), TABLES)
def test_directions_in_words_or_columns_and_wraps(name, ratio, columns):
    """The tables of the corpus have a gap of 0.05° and a first order of 60″, with a noise of 1″."""
    path = CORPUS / f"{name}.csv"
    log = vttig_jax.read_log(path, ratio=ratio, columns=columns, sample_rate_hz=1.0)
    result = vttig_jax.fit(log)
    gap = result.checks.gap_over_angles_covered
    assert gap.value is not None and gap.std is not None
    assert abs(gap.value - 0.05) < 4 * gap.std < 0.002
    first = [one for one in result.orders if (one.shaft, one.order) == ("driving", 1)]
    assert {one.flank for one in first} == {"A", "B"}
    for one in first:
        assert abs(one.amplitude_arcsec - 60) < 4 * one.std_arcsec < 8.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_readings_that_repeat_their_rounding_are_no_surer(tmp_path, seed):
    """Three passes of a display of 0.01° at twelve places tell no more than one of them."""
    generator = np.random.default_rng(seed)
    start, gap = generator.uniform(0, 0.01), generator.uniform(0.04, 0.06)
    up = np.arange(0.0, 360.0, 30.0)
    driven = up + start + 0.02 * np.sin(np.radians(up) + generator.uniform(0, 6))
    passes = [100 * (driven + gap * (k % 2) + generator.normal(0, 5e-4, 12)) for k in range(6)]
    head = ",".join(f"{way}{k}_deg" for k in (1, 2, 3) for way in ("up", "down"))
    columns = up, *np.round(passes) / 100
    path = written(tmp_path / "table.csv", f"position_deg,{head}", *columns, form="%.2f")
    result = vttig_jax.fit(vttig_jax.read_log(path, ratio="1:1", sample_rate_hz=1.0))
    one, covered = result.parameters["driving_amplitude_arcsec"], result.checks
    assert one.low95 is not None and one.high95 is not None and one.low95 < 72 < one.high95
    low, high = (getattr(covered.gap_over_angles_covered, f"{end}95") for end in ("low", "high"))
    assert low < gap < high


def test_few_places_leave_out_high_orders_and_standstill_is_the_users_word(tmp_path):
    """Twelve places cannot tell order 8 from order 4; half of the readings tell the noise."""
    result = fitted(table(tmp_path, np.arange(0.0, 361.0, 30.0)))
    assert {one.order for one in result.orders} == {1, 2}
    assert "orders-equal" in {one.slug for one in result.findings}
    quarter = fitted(table(tmp_path, np.arange(0.0, 90.0, 5.0)))
    assert not quarter.orders and not quarter.parameters["driving_encoder_arcsec"].determined
    with pytest.raises(NoAnswerError):
        fitted(table(tmp_path, np.arange(0.0, 360.0, 45.0)))
    path = table(tmp_path, np.arange(0.0, 1080.0, 5.0))
    assert fitted(path).core.shafts[0].still
    assert not fitted(path, standstill=False).core.shafts[0].still


@pytest.mark.parametrize("moves", [False, True])
def test_the_samples_of_a_stop_are_one_reading(tmp_path, moves):
    """What scatters from stop to stop is no noise of single samples, and moves are no stops."""
    random = np.random.default_rng(4)
    there = np.arange(0.0, 361.0, 9.0)
    stops = np.concatenate([[-9.0], there, [369.0], there[::-1], [-9.0]])
    way = np.concatenate([[1.0], np.diff(stops)])
    scatter, held, rows = 4.0, 15, []
    for before, stop, sense in zip(np.roll(stops, 1), stops, way, strict=True):
        if moves and rows:
            between = np.linspace(before, stop, 6)[1:-1]
            rows += [(50 * a, a + random.normal(0, 5) * ARCSEC) for a in between]
        off = sines(np.array([stop]), (26, 1, 64), (9, 50, 20))[0] + 60 * (sense < 0)
        off += random.normal(0, scatter) + random.normal(0, 0.8, held)
        rows += [(50 * stop, stop + one * ARCSEC) for one in off]
    driving, driven = np.transpose(rows)
    time = 0.1 * np.arange(len(rows))
    path = written(tmp_path / "bench.csv", "time_s,driving_deg,driven_deg", time, driving, driven)
    result = vttig_jax.fit(vttig_jax.read_log(path, ratio="50:1"))
    expected = scatter * np.sqrt(2 / len(stops))
    for name, true in (("driving_amplitude_arcsec", 9.0), ("driven_amplitude_arcsec", 26.0)):
        std = result.parameters[name].std
        assert std is not None and 0.7 * expected < std < 2 * expected
        assert abs(result.value(name) - true) < 3 * std
    gap = result.parameters["constant_backlash_deg"]
    assert abs(result.value(gap.name) - 60 * ARCSEC) < 4 * (gap.std or 0.0)
    assert f"a table of {len(stops)} readings" in " ".join(one.sentence for one in result.findings)
