"""Whole orders above the listed ones join the model if the log shows them."""

import re

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit

PAIR = drive("9/16", orders=tuple(range(1, 9)))
MOTION = there_and_back([60, 40], 10)


def fitted(
    parts: dict[float, float],
    *,
    of_gap: dict[float, float] | None = None,
    motion=MOTION,
    rate_hz: float = 200.0,
    **options,
) -> Fit:
    """A fit of a log with lines {cycles per driving turn: arcsec} in TE and gap."""

    def curve(lines, angle):
        return np.sum([0 * angle, *(a * np.sin(c * angle + 0.7) for c, a in lines.items())], axis=0)

    log = drive_log(
        PAIR,
        motion,
        gap=lambda angle, _: 200.0 + curve(of_gap or {}, angle),
        error=lambda angle, _: curve({1: 20.0, 9 / 16: 30.0, **parts}, angle),
        noise_arcsec=1.0,
        rate_hz=rate_hz,
    )
    return fit(log, PAIR, delay="off", **options)


def of(result: Fit, shaft: str, order: int) -> list[float]:
    rows = [one for one in result.orders if (one.shaft, one.order) == (shaft, order)]
    return [one.amplitude_arcsec for one in rows if one.significant]


def joined(result: Fit) -> list[str]:
    return [note for note in result.notes if "join" in note]


def test_an_order_above_the_listed_ones_joins_on_both_flanks():
    result = fitted({12: 15.0}, of_gap={12: 10.0})
    assert of(result, "driving", 12) == pytest.approx([15.0, 25.0], abs=0.5)
    assert result.residual_rms_deg * 3600 == pytest.approx(1.0, rel=0.1)
    (note,) = joined(result)
    assert note.startswith("driving order 12 is not listed, but the log shows it and it joins")
    gap = result.parameters["constant_backlash_deg"]
    assert gap.value == pytest.approx(200 / 3600, abs=3 * (gap.std or 0.0))


def test_the_map_contains_it():
    result = fitted({12: 15.0}, of_gap={12: 10.0})
    grid = backlash_map(result)
    angle = np.radians(np.arange(0.0, 360.0, 1.0))
    seen = np.degrees([float(grid.at(one)) for one in angle]) * 3600
    wave = 2 * abs(np.mean(seen * np.exp(-12j * angle)))
    assert wave == pytest.approx(10.0, abs=0.5)


def test_orders_of_the_driven_shaft_join_too():
    result = fitted({11 * 9 / 16: 15.0, 20: 8.0})
    assert of(result, "driven", 11) == pytest.approx([15.0, 15.0], abs=0.5)
    assert of(result, "driving", 20) == pytest.approx([8.0, 8.0], abs=0.5)


def test_it_joins_on_one_flank():
    one_way = [0.3, 0.2, 11.0, 0.2, 0.3], [0.0, 60.0, 60.0, 0.0, 0.0]
    result = fitted({12: 15.0}, motion=one_way)
    assert result.flanks == ("A",)
    assert of(result, "driving", 12) == pytest.approx([15.0], abs=0.5)


def test_lines_report_names_it_and_leaves_it_out():
    result = fitted({12: 15.0}, lines="report")
    assert not of(result, "driving", 12)
    (note,) = joined(result)
    assert re.search(r": 1[45](\.\d)?″ at driving order 12 \(", note)
    assert "% of the variance that the listed orders leave" in note
    assert "fit with --lines join" in note
    assert result.model.terms == fitted({}).model.terms


@pytest.mark.parametrize("parts", [{}, {12.31: 15.0}, {12: 0.05}])
def test_noise_other_lines_and_small_orders_do_not_join(parts: dict[float, float]):
    result = fitted(parts)
    assert not joined(result)
    assert max(one.order for one in result.orders) == 8


def test_an_order_that_the_samples_do_not_resolve_does_not_join():
    assert not joined(fitted({24: 15.0}, rate_hz=100.0))


def test_a_driven_order_with_the_frequency_of_a_driving_order_is_one_line():
    result = fitted({9: 15.0})  # driven order 16
    assert of(result, "driving", 9) and not of(result, "driven", 16)


def test_logs_without_a_common_zero_are_searched_one_by_one():
    def made(seed: int, start_turns: float):
        return drive_log(
            PAIR,
            MOTION,
            gap=level(200.0),
            error=lambda angle, _: (
                20 * np.sin(angle) + 30 * np.sin(angle * 9 / 16) + 15 * np.sin(12 * angle)
            ),
            noise_arcsec=1.0,
            rate_hz=200.0,
            seed=seed,
            start_turns=start_turns,
        )

    result = fit([made(0, 0.0), made(1, 0.37)], PAIR, delay="off")
    assert of(result, "driving", 12) == pytest.approx([15.0, 15.0], abs=0.5)
