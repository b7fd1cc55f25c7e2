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
    path = tmp_path / "dial.csv"
    rows = zip(PLACES.tolist(), gap.tolist(), strict=True)
    path.write_text("driving_deg,backlash_deg\n" + "".join(f"{a},{g:.6f}\n" for a, g in rows))
    return path


def test_mean_and_first_order(dial, vttig_json):
    code, found = vttig_json("fit", "--readings", dial, "--ratio", "45:1")
    assert code == 0
    assert found["schema"] == "vttig.readings/1" and found["count"] == 12
    assert found["low95_deg"] < 0.1 < found["high95_deg"]
    assert found["std_deg"] < 5e-4
    first = found["orders"][0]
    assert (first["shaft"], first["order"], first["significant"]) == ("driving", 1, True)
    assert abs(first["amplitude_deg"] - 0.02) < 4 * first["std_deg"]
    assert first["phase_deg"] == pytest.approx(50.0, abs=5.0)
    assert found["largest"]["driving_deg"] == pytest.approx(40.0, abs=10.0)


def test_a_dial_gauge_at_a_radius(dial, vttig_json, vttig):
    """At 50 mm one degree is 873 µm; the gap is told in degrees, and in µm in words."""
    _, expected = vttig_json("fit", "--readings", dial, "--ratio", "45:1")
    angles, gaps = np.loadtxt(dial, delimiter=",", skiprows=1).T
    rows = zip(angles, 50e3 * np.radians(gaps), strict=True)
    dial.write_text("driving_deg,backlash_um\n" + "".join(f"{a},{g}\n" for a, g in rows))
    words = ("fit", "--readings", dial, "--ratio", "45:1")
    code, found = vttig_json(*words, "--radius-mm", "50")
    assert code == 0 and found["backlash_deg"] == pytest.approx(expected["backlash_deg"])
    _, told, _ = vttig(*words, "--radius-mm", "50")
    assert f"{50e3 * np.radians(found['backlash_deg']):.4g} ±" in told
    code, _, refusal = vttig(*words)
    assert code == 3 and "--radius-mm" in refusal
    assert vttig(*words, "--radius-mm", "50", "--lead-mm", "314")[0] == 2


def test_the_rounding_of_a_display_does_not_average_out(dial, vttig_json):
    """Five equal readings at each place tell what one does: q/√12 at twelve places."""
    step = 0.01
    shown = step * np.round((0.053 + 0.02 * np.sin(np.radians(PLACES + 50.0))) / step)
    rows = "".join(f"{a:g},{g:.2f}\n" for a, g in zip(PLACES, shown, strict=True))
    dial.write_text("driving_deg,backlash_deg\n" + 5 * rows)
    code, found = vttig_json("fit", "--readings", dial, "--ratio", "45:1")
    assert code == 0 and found["count"] == 60
    assert found["std_deg"] >= 0.99 * step / 12
    assert found["low95_deg"] < 0.053 < found["high95_deg"]
    first = found["orders"][0]
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
        found = fit_readings(BacklashReadings.from_arrays(angle, shown), drive)
        first = found.orders[0]
        assert found.low95_deg is not None and found.high95_deg is not None
        near = abs(first.amplitude_deg - size * step) < 2 * first.std_deg
        held.append([found.low95_deg < mean < found.high95_deg, near])
    assert np.all(np.mean(held, axis=0) >= 0.92)


@pytest.mark.parametrize(
    "names", ["motor [°];Spiel [°]", "input_deg;lash_deg", "entrée (deg);jeu (deg)"]
)
def test_names_that_a_log_knows(dial, names, vttig_json):
    text = dial.read_text().replace(",", ";").replace("driving_deg;backlash_deg", names)
    dial.write_text(text, encoding="utf-8")
    code, found = vttig_json("fit", "--readings", dial, "--ratio", "45:1")
    assert code == 0 and found["low95_deg"] < 0.1 < found["high95_deg"]


def test_one_reading_has_no_error(dial, vttig_json):
    dial.write_text("driving_deg,backlash_deg\n0,0.1\n")
    code, found = vttig_json("fit", "--readings", dial, "--ratio", "45:1")
    assert code == 0 and found["orders"] == []
    assert found["backlash_deg"] == pytest.approx(0.1) and found["std_deg"] is None


@pytest.mark.parametrize("options", [(), ("--ratio", "45:1", "--out", "run")])
def test_what_is_missing_or_makes_no_sense_is_said(dial, options, vttig):
    code, _, said = vttig("fit", "--readings", dial, *options)
    assert code == 2 and said.count("\n") == 1


def test_a_first_order_that_the_places_show_little_is_not_taken_for_a_third():
    """The wheel stands in two opposite parts of its turn, 17° wide: order 3 looks like order 1."""
    angle = np.add.outer(960.0 * np.arange(6), 330.0 * np.arange(4)).ravel()
    turned = np.radians(angle)
    gap = 0.04 + 0.01 * np.sin(turned) + 0.0095 * np.sin(45 / 80 * turned + 2.0)
    gap = gap + np.random.default_rng(5).normal(0.0, 1e-3, len(gap))
    drive = pair_from_spec(parse_pair_spec({"drive": {"ratio": "45/80"}}))
    found = fit_readings(BacklashReadings.from_arrays(angle, gap), drive)
    orders = {(one.shaft, one.order): one for one in found.orders}
    assert ("driven", 3) not in orders
    one = orders["driven", 1]
    assert abs(one.amplitude_deg - 0.0095) < 3 * one.std_deg < 0.0095
