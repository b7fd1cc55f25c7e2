"""Orders that are no whole number: harmonics of their own, and no part of the flank model."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from tests.identify.test_evidence import again
from vttig_jax.base.angles import difference_deg
from vttig_jax.base.errors import UsageError
from vttig_jax.base.files.json_io import dumps, load_schema
from vttig_jax.base.units import ARCSEC
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.result import Fit
from vttig_jax.identify.identification import fit
from vttig_jax.identify.model.harmonics import harmonic_of, plan_terms
from vttig_jax.identify.archive import fit_arrays, read_fit
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.posterior.sampler import sample

PAIR = replace(drive("9/16"), fit=HarmonicOrders((1, 2, 3, 3.087), (1, 1.7), 0))
MOTION = there_and_back([40, 60], 15)


def logged(seed: int = 0, amplitude: float = 25.0, line: float = 3.087):
    """Twelve turns and back, with a line of 0.7 rad and a driven order 1.7 of 12″."""

    def error(angle, _):
        first = 20 * np.sin(angle + 0.3) + 30 * np.sin(angle * 9 / 16 + 1)
        hidden = amplitude * np.sin(line * angle + 0.7)
        return first + hidden + 12 * np.sin(1.7 * 9 / 16 * angle - 1)

    return drive_log(
        PAIR, MOTION, gap=level(200.0), error=error, rate_hz=80.0, seed=seed, start_turns=0.0
    )


@pytest.fixture(scope="module")
def fitted() -> Fit:
    return fit(logged(), PAIR, delay="off")


@pytest.mark.parametrize(
    ("shaft", "order", "amplitude", "phase"),
    [("driving", 3.087, 25.0, 0.7), ("driven", 1.7, 12.0, -1.0)],
)
def test_each_flank_has_its_amplitude_and_phase(fitted, shaft, order, amplitude, phase):
    rows = [o for o in fitted.orders if (o.shaft, o.order) == (shaft, order)]
    assert [one.flank for one in rows] == ["A", "B"]
    for one in rows:
        assert abs(one.amplitude_arcsec - amplitude) < 4 * one.std_arcsec < 0.5
        assert one.significant
        assert abs(difference_deg(one.phase_deg, np.degrees(phase))) < 1.0


def test_nothing_is_left_of_them(fitted):
    """The residual of single samples needs the whole turns of the angles."""
    assert fitted.residual_rms_deg * 3600 == pytest.approx(0.5, rel=0.03)
    assert not fitted.checks.lines and not fitted.checks.joined_lines


def test_an_order_that_is_not_there_leaves_the_model(fitted):
    """A resolution away from the line, which a fit of both would tell as insignificant."""
    assert not [o for o in fitted.orders if (o.shaft, o.order) == ("driving", 3)]
    reason = "driving order 3 is left out: the log does not support it beside driving order 3.087"
    assert reason in fitted.notes


def test_a_wrong_frequency_leaves_a_residual():
    result = fit(logged(line=3.187), PAIR, delay="off", lines="report")
    assert result.residual_rms_deg * 3600 > 5
    assert result.checks.lines[0].cycles_per_rev == pytest.approx(3.187, abs=1e-3)


def test_the_flank_model_has_no_fractional_order(fitted):
    assert fitted.model.terms == ((2, 0), (1, 0), (0, 1))
    grid = backlash_map(fitted)
    gap = np.asarray(grid.over(np.linspace(0, 80, 400))) / ARCSEC
    assert np.allclose(gap, 200.0, atol=2.0)
    (note,) = [text for text in fitted.notes if "no fixed position on the gears" in text]
    assert note.startswith("driving order 3.087, driven order 1.7 have")


def test_the_evidence_and_the_run_folder_keep_it(fitted, tmp_path):
    summary = fitted.evidence.summary
    found = again(fitted.evidence).summary
    assert found.terms.free == summary.terms.free and found.columns == summary.columns
    assert harmonic_of("driving", 3.087) in found.terms.free
    record = fitted.to_json()
    jsonschema.validate(record, load_schema("vttig.fit/1"))
    (tmp_path / "fit.json").write_text(dumps(record), encoding="utf-8")
    np.savez(tmp_path / "summary.npz", allow_pickle=False, **fit_arrays(fitted))
    read = read_fit(tmp_path, PAIR)
    assert read.to_json() == json.loads(dumps(record)) and read.model.terms == fitted.model.terms


def test_it_is_sampled(fitted):
    draws = sample(fitted, steps=200)
    assert draws.cosine.shape[1:] == (2, len(fitted.model.terms))
    mean = draws.cosine.mean(axis=0)
    np.testing.assert_allclose(mean, np.asarray(fitted.model.cosine), atol=0.1 * ARCSEC)


def test_logs_without_a_common_zero_are_refused():
    logs = [logged(0), logged(1)]
    with pytest.raises(UsageError, match=r"driving order 3\.087 has another phase in every log"):
        fit(logs, PAIR, delay="off")
    together = fit(logs, PAIR, delay="off", same_zero=True)
    (one, _) = [o for o in together.orders if o.order == 3.087]
    assert one.amplitude_arcsec == pytest.approx(25.0, abs=0.2)
    whole = HarmonicOrders((1, 2), (1,), 0)
    assert len(fit(logs, PAIR, delay="off", orders=whole).logs) == 2


@pytest.mark.smoke
def test_a_whole_number_is_an_integer():
    orders = HarmonicOrders(driving_orders=(1.0, np.float64(2), 3.5), driven_orders=())
    assert orders == HarmonicOrders(driving_orders=(1, 2, 3.5), driven_orders=())
    assert [type(k) for k in orders.driving_orders] == [int, int, float]


@pytest.mark.smoke
@pytest.mark.parametrize("order", [0, -1.5, float("nan"), float("inf"), 1001, "3", True, None])
def test_an_order_is_a_positive_number(order):
    with pytest.raises(ValueError, match="`driven_orders` must hold positive numbers up to 1000"):
        HarmonicOrders(driven_orders=(1, order))


@pytest.mark.smoke
def test_its_frequency_is_exact_and_takes_no_whole_order():
    plan = plan_terms(PAIR.ratio, (1, 3, 3.087), (1, 0.5), 0, None, turns=5.0)
    third, fractional, half = plan.free
    assert str(plan.frequency(fractional.term)) == "3087/1000"
    assert (third.order, half.order) == (3, 0.5) and not plan.dropped
    short = plan_terms(PAIR.ratio, (1, 3, 0.05), (1,), 0, None, turns=5.0)
    assert "driving order 0.05 is left out" in short.dropped[0]
    same = plan_terms(PAIR.ratio, (1, 3, 4.5), (1, 8), 0, None)
    assert "driven order 8 has the frequency of driving order 4.5" in same.dropped[0]
