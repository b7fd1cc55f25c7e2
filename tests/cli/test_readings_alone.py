"""`vttig fit --readings FILE` without a log: backlash by a dial gauge at n places."""

import numpy as np
import pytest

from vttig_jax.identify.readings import fit_readings
from vttig_jax.logs import BacklashReadings
from vttig_jax.pair import parse_pair_spec
from vttig_jax.pair.gear_pair import pair_from_spec

PLACES = np.arange(0.0, 360.0, 30.0)


@pytest.fixture
def dial(tmp_path):
    gap = 0.1 + 0.02 * np.sin(np.radians(PLACES + 50.0))
    gap = gap + np.random.default_rng(0).normal(0.0, 5e-4, len(PLACES))
    return write(tmp_path / "dial.csv", "driving_deg,backlash_deg", PLACES, gap)


def write(path, head: str, *columns):
    np.savetxt(path, np.stack(columns, axis=1), "%.6f", ",", header=head, comments="")
    return path


@pytest.fixture
def fitted(dial, found):
    """Function that fits the readings."""
    return lambda *options: found("fit", "--readings", dial, "--ratio", "45:1", *options)


def test_mean_and_first_order(fitted):
    record = fitted()
    assert record["schema"] == "vttig.readings/1" and record["count"] == 12
    assert record["low95_deg"] < 0.1 < record["high95_deg"] and record["std_deg"] < 5e-4
    first = record["orders"][0]
    assert (first["shaft"], first["order"], first["significant"]) == ("driving", 1, True)
    assert abs(first["amplitude_deg"] - 0.02) < 4 * first["std_deg"]
    assert first["phase_deg"] == pytest.approx(50.0, abs=5.0)
    assert record["largest"]["driving_deg"] == pytest.approx(40.0, abs=10.0)


def test_a_dial_gauge_at_a_radius(dial, fitted, told, refused):
    """At 50 mm one degree is 873 µm; the gap is told in degrees, and in µm in words."""
    expected = fitted()["backlash_deg"]
    angles, gaps = np.loadtxt(dial, delimiter=",", skiprows=1).T
    write(dial, "driving_deg,backlash_um", angles, 50e3 * np.radians(gaps))
    words, radius = ("fit", "--readings", dial, "--ratio", "45:1"), ("--radius-mm", "50")
    backlash = fitted(*radius)["backlash_deg"]
    assert backlash == pytest.approx(expected)
    assert f"{50e3 * np.radians(backlash):.4g} ±" in told(*words, *radius)
    refused(3, "--radius-mm", *words)
    refused(2, "--lead-mm", *words, *radius, "--lead-mm", "314")
    refused(2, "", *words[:3])
    refused(2, "", *words, "--out", "run")


def test_the_rounding_of_a_display_does_not_average_out(dial, fitted):
    """Five equal readings at each place tell what one does: q/√12 at twelve places."""
    step = 0.01
    shown = step * np.round((0.053 + 0.02 * np.sin(np.radians(PLACES + 50.0))) / step)
    rows = "".join(f"{a:g},{g:.2f}\n" for a, g in zip(PLACES, shown, strict=True))
    dial.write_text("driving_deg,backlash_deg\n" + 5 * rows)
    record = fitted()
    assert record["count"] == 60 and record["std_deg"] >= 0.99 * step / 12
    assert record["low95_deg"] < 0.053 < record["high95_deg"]
    first = record["orders"][0]
    assert first["std_deg"] >= 0.99 * step / 72**0.5
    assert abs(first["amplitude_deg"] - 0.02) < 2 * first["std_deg"]


@pytest.mark.parametrize(("places", "size"), [(36, 0.6), (36, 1.0), (24, 1.0), (12, 4.0)])
def test_a_single_pass_of_a_coarse_display_is_no_surer(places, size):
    """A first order of `size` steps of the display and little noise: intervals hold the truth."""
    generator, step, held = np.random.default_rng(places), 0.01, []
    drive = pair_from_spec(parse_pair_spec({"drive": {"ratio": "1/45"}}))
    angle = np.arange(places) * 360 / places
    for _ in range(50):
        mean, phase = 0.1 + generator.uniform(0, step), generator.uniform(0, 2 * np.pi)
        true = mean + size * step * np.sin(np.radians(angle) + phase)
        shown = step * np.round((true + generator.normal(0, 0.05 * step, places)) / step)
        result = fit_readings(BacklashReadings.from_arrays(angle, shown), drive)
        first = result.orders[0]
        assert result.low95_deg is not None and result.high95_deg is not None
        near = abs(first.amplitude_deg - size * step) < 2 * first.std_deg
        held.append([result.low95_deg < mean < result.high95_deg, near])
    assert np.all(np.mean(held, axis=0) >= 0.92)


def test_names_that_a_log_knows_and_one_reading(dial, fitted):
    plain = dial.read_text().replace(",", ";")
    for names in ("motor [°];Spiel [°]", "input_deg;lash_deg", "entrée (deg);jeu (deg)"):
        text = plain.replace("driving_deg;backlash_deg", names)
        dial.write_text(text, encoding="utf-8")
        record = fitted()
        assert record["low95_deg"] < 0.1 < record["high95_deg"]
    dial.write_text("driving_deg,backlash_deg\n0,0.1\n")
    record = fitted()
    assert record["orders"] == [] and record["std_deg"] is None
    assert record["backlash_deg"] == pytest.approx(0.1)


def test_a_first_order_that_the_places_show_little_is_not_taken_for_a_third():
    """The wheel stands in two opposite parts of its turn, 17° wide: order 3 looks like order 1."""
    angle = np.add.outer(960.0 * np.arange(6), 330.0 * np.arange(4)).ravel()
    turned = np.radians(angle)
    gap = 0.04 + 0.01 * np.sin(turned) + 0.0095 * np.sin(45 / 80 * turned + 2.0)
    gap = gap + np.random.default_rng(5).normal(0.0, 1e-3, len(gap))
    drive = pair_from_spec(parse_pair_spec({"drive": {"ratio": "45/80"}}))
    result = fit_readings(BacklashReadings.from_arrays(angle, gap), drive)
    orders = {(one.shaft, one.order): one for one in result.orders}
    one = orders["driven", 1]
    assert ("driven", 3) not in orders
    assert abs(one.amplitude_deg - 0.0095) < 3 * one.std_deg < 0.0095
