"""What changes a number is told first: before the parameters and before all other notes."""

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.base.units import DEG
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.notes import _ratio_notes
from vttig_jax.identify.report.parameters import Parameter
from vttig_jax.logs.encoder_log import EncoderLog

ORDERS = tuple(range(1, 9))


@pytest.fixture(scope="module")
def one_speed() -> Fit:
    """Back and forth at one speed at 1:1: all orders coincide, and a delay looks like a gap."""
    pair = drive("1", orders=ORDERS)
    log = drive_log(pair, there_and_back([60.0] * 3, 3.0, 0.02), gap=level(600.0))
    return fit(log, pair, delay="auto")


def test_the_note_that_changes_a_number_comes_first(one_speed):
    (warning,) = one_speed.warnings
    assert warning.startswith("one speed does not tell a delay from the backlash")
    assert one_speed.notes[0] == warning
    assert one_speed.to_json()["warnings"] == [warning]
    text = str(one_speed)
    assert text.index(warning) < text.index("parameter ") < text.index("notes:")
    assert text.count(warning) == 1


def test_equal_sentences_on_orders_are_one(one_speed):
    (note,) = [note for note in one_speed.notes if "driven order" in note]
    assert note.startswith("driven orders 1 to 8 have the frequencies of driving orders 1 to 8")


def test_a_fit_without_warnings_has_no_such_section(quick_fit):
    assert quick_fit.warnings == () and "\nwarnings" not in str(quick_fit)


def test_sections_with_errors_say_what_they_are(quick_fit):
    parts = str(quick_fit).split("\n\n")
    (checks,) = (part for part in parts if part.startswith("checks"))
    assert " ± " in checks and checks.startswith("checks (± is one standard error):\n")
    told = [part for part in parts if part.startswith(("checks", "notes", "warnings"))]
    assert all((" (± is one standard error):" in one) == (" ± " in one[26:]) for one in told)


def test_a_ratio_that_the_log_doubts_is_a_warning():
    """With a slope of 300 ppm the gap still holds, but the reader must know."""
    pair = drive("9/16")
    motion = there_and_back([60.0, 90.0], 30.0)
    for off, told in ((0.0, 0), (3e-4, 1)):
        log = drive_log(pair, motion, gap=level(600.0), ratio=9 / 16 * (1 + off))
        found = fit(log, pair)
        assert sum("standard errors above the given 9/16" in one for one in found.warnings) == told
        assert not told or "standard errors above the given 9/16" in found.warnings[0]


@pytest.mark.parametrize("amplitude_arcsec", [0.0, 0.5])
def test_a_column_that_was_computed_is_a_warning(amplitude_arcsec):
    """An angle of the driven shaft that is the ratio times the other one says nothing of gears."""
    time = np.arange(0.0, 40.0, 0.01)
    driving = 100.0 * np.minimum(time, 40.0 - time) * DEG
    driven = 9 / 16 * driving + amplitude_arcsec / 3600 * DEG * np.sin(driving)
    log = EncoderLog.from_arrays(time, driving, driven, unit="rad", pair=drive("9/16"))
    told = [one for one in fit(log, drive("9/16")).warnings if "was computed from the other" in one]
    assert len(told) == (amplitude_arcsec == 0)


def test_nothing_is_said_of_a_sum_that_is_open():
    """One forward and one backward log with one zero: offset of the second log and gap are one."""
    pair = drive("9/16")
    motion = there_and_back([90.0], 30.0)
    waves = lambda angle, _: 300.0 * np.sin(angle + 1.0)  # noqa: E731
    log = drive_log(pair, motion, gap=level(100.0), error=waves, noise_arcsec=5.0)
    speed = np.gradient(log.driving_angle, log.time)
    ahead, back = (sign * speed > 0.98 * speed.max() for sign in (1, -1))

    def part(chosen: np.ndarray) -> EncoderLog:
        angles = (log.driving_angle[chosen], log.driven_angle[chosen])
        return EncoderLog.from_arrays(log.time[chosen], *angles, unit="rad", pair=pair)

    told = "sum of backlash and delay is below zero"
    for first, second in ((ahead, back), (back, ahead)):
        apart = fit([part(first), part(second)], pair, same_zero=True)
        assert apart.parameters["constant_backlash_deg"].value is None
        assert not any(told in one for one in apart.warnings)


def test_a_microsecond_of_delay_looks_like_its_travel_on_both_flanks():
    """At one turn a second the driven shaft moves 360° · 3/4 · 1e-6 in it, on either flank."""
    pair = drive("3/4")
    log = drive_log(pair, there_and_back([60.0] * 3, 4.0, 0.02), gap=level(600.0))
    found = fit(log, pair, delay="auto")
    (warning,) = [one for one in found.warnings if "every microsecond" in one]
    assert f"every microsecond looks like {2 * 360 * 3 / 4 * 1e-6:.2g}° of backlash" in warning


@pytest.mark.parametrize(
    ("turns", "direct", "cure"),
    [
        (3.0, False, "check the teeth and counts_per_rev"),
        (0.9, False, "looks the same over a part of a turn"),
        (3.0, True, "looks the same over a part of a turn"),
    ],
)
def test_the_cure_of_a_wrong_ratio_follows_the_turns_of_the_driven_shaft(
    quick_fit, turns, direct, cure
):
    """A log of the transmission error itself shows no turn of the driven shaft."""
    pair, driving = drive("1/2"), np.linspace(0.0, 2 * turns, 400)
    off = 3e-4 * driving
    log = EncoderLog.from_arrays(
        np.linspace(0.0, 9.0, 400),
        driving,
        None if direct else driving / 2 + off,
        pair=pair,
        unit="rev",
        transmission_error=360 * 3600 * off if direct else None,
    )
    ratio = Parameter("ratio", "", value=0.5 * (1 + 3e-4), std=5e-6, significant=True)
    (note,) = _ratio_notes((ratio,), quick_fit.checks, log)
    assert "comes out +300 ± 10 ppm off 1/2" in note and cure in note
