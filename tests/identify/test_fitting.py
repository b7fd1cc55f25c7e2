"""The fit as a whole: truth on noise-free rigs, every argument, refusals, and its JSON."""

import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import jsonschema
import numpy as np
import pytest

from tests.schemas import load_schema
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.identification import fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.rig.imperfections import EncoderError, OrderError
from vttig_jax.rig.motion import PassMotion

SHARED = (
    "driving_phase_deg",
    "driven_phase_deg",
    "constant_backlash_deg",
    "driving_encoder_arcsec",
    "driving_encoder_phase_deg",
    "driven_encoder_arcsec",
    "driven_encoder_phase_deg",
    "delay_s",
)
PAIR_NAMES = {*SHARED, "driving_eccentricity_mm", "driven_eccentricity_mm"}
DRIVE_NAMES = {*SHARED, "driving_amplitude_arcsec", "driven_amplitude_arcsec"}
TRUTH = {
    "driving_eccentricity_mm": 0.0226,
    "driving_phase_deg": 49.5,
    "driven_eccentricity_mm": 0.0273,
    "driven_phase_deg": 79.3,
    "constant_backlash_deg": 0.038,
}
FIRST_ORDERS = HarmonicOrders(driving_orders=(1,), driven_orders=(1,), mesh_orders=0)


def _as_drive(rig) -> Drive:
    return Drive(Fraction(45, 80), fit=rig.pair.fit)


def _copy(log: EncoderLog, pair) -> EncoderLog:
    """The same readings for another pair."""
    return EncoderLog.from_arrays(
        log.time,
        np.asarray(log.driving_angle) / DEG,
        np.asarray(log.driven_angle) / DEG,
        pair=pair,
        unit="deg",
    )


def test_truth_is_found_without_noise(clean_fit):
    for name, value in TRUTH.items():
        assert clean_fit.parameters[name].value == pytest.approx(value, rel=3e-3), name
    assert clean_fit.outcome == "ok"
    assert clean_fit.residual_rms_deg < 1e-5
    for shaft in ("driving", "driven"):
        encoder = clean_fit.parameters[f"{shaft}_encoder_arcsec"]
        assert encoder.value == pytest.approx(0.0, abs=0.3)


def test_encoder_errors_are_told_from_the_gears(clean_rig):
    rig = replace(
        clean_rig,
        driving_encoder=EncoderError(18.0, 30.0),
        driven_encoder=EncoderError(12.0, 200.0),
        motion=PassMotion(speed_rpm=180.0, reversal_deg=3600.0),
    )
    result = fit(rig.log(), rig.pair)
    found = {
        "driving_encoder_arcsec": 18.0,
        "driving_encoder_phase_deg": 30.0,
        "driven_encoder_arcsec": 12.0,
        "driven_encoder_phase_deg": 200.0,
    }
    for name, value in found.items():
        assert result.parameters[name].value == pytest.approx(value, rel=3e-2), name
    # The zero of gear 2 moves with its encoder's reading: 12″ sin 200° of phase.
    for name, value in TRUTH.items():
        assert result.parameters[name].value == pytest.approx(value, rel=5e-3), name


def test_orders_carry_their_amplitude_and_phase(clean_rig):
    errors = (
        OrderError("driving", 3, "A", 0.002, 40.0),
        OrderError("driven", 2, "B", 0.001, 250.0),
        OrderError("mesh", 1, "B", 0.003, 10.0),
    )
    rig = replace(clean_rig, orders=errors, motion=PassMotion(speed_rpm=180.0, reversal_deg=3600.0))
    table = {(o.shaft, o.order, o.flank): o for o in fit(rig.log(), rig.pair).orders}
    for error in errors:
        order = table[error.shaft, error.order, error.flank]
        assert order.amplitude_arcsec == pytest.approx(error.amplitude_deg * 3600, rel=0.1)
        assert order.phase_deg == pytest.approx(error.phase_deg, abs=6.0)
        other = table[error.shaft, error.order, "A" if error.flank == "B" else "B"]
        assert other.amplitude_arcsec < 0.15 * order.amplitude_arcsec
    # Without noise the product of two orders is seen as a line.
    assert {(o.shaft, o.order) for o in table.values() if float(o.order).is_integer()} == {
        *((shaft, k) for shaft in ("driving", "driven") for k in range(1, 9)),
        ("mesh", 1),
    }


def test_names_of_the_contract_are_always_there(noisy_fit, noisy_rig, noisy_log):
    assert set(noisy_fit.parameters) == PAIR_NAMES
    assert set(fit(noisy_log, noisy_rig.pair, flank="B").parameters) == PAIR_NAMES
    drive = _as_drive(noisy_rig)
    result = fit(_copy(noisy_log, drive), drive)
    assert set(result.parameters) == DRIVE_NAMES
    assert result.outcome == "ok"
    assert "no gear geometry" in (result.parameters["driving_encoder_arcsec"].reason or "")
    assert result.conditional_on == ()


def test_undetermined_parameters_have_a_reason_and_no_value(noisy_fit, noisy_rig, noisy_log):
    for result in (noisy_fit, fit(noisy_log, noisy_rig.pair, flank="A")):
        for parameter in result.parameters.values():
            if not parameter.determined:
                assert parameter.value is None
                assert parameter.reason


def test_one_direction_is_conditional_on_perfect_encoders(noisy_log, noisy_rig, noisy_fit):
    assert noisy_fit.conditional_on == ()
    result = fit(noisy_log, noisy_rig.pair, flank="A")
    assert result.flanks == ("A",)
    assert result.conditional_on == ("perfect_encoders",)
    assert result.outcome == "partly_determined"
    gap = result.parameters["constant_backlash_deg"]
    assert not gap.determined and "one direction" in (gap.reason or "")
    assert not result.parameters["driving_encoder_arcsec"].determined
    assert result.parameters["driving_eccentricity_mm"].determined
    # 18″ of encoder go into the eccentricity.
    moved = result.value("driving_eccentricity_mm") - noisy_fit.value("driving_eccentricity_mm")
    assert abs(moved) > 5 * (result.parameters["driving_eccentricity_mm"].std or 0)


def test_each_flank_is_its_own(noisy_log, noisy_rig):
    one, other = (fit(noisy_log, noisy_rig.pair, flank=flank) for flank in ("A", "B"))
    assert (one.flanks, other.flanks) == (("A",), ("B",))
    assert one.samples["backward"] == other.samples["forward"] == 0
    assert one.value("driving_phase_deg") != other.value("driving_phase_deg")


def test_a_forward_log_has_one_flank(noisy_rig):
    rig = replace(noisy_rig, motion=replace(noisy_rig.motion, passes=1))
    result = fit(rig.log(), rig.pair)
    assert result.flanks == ("A",)
    assert result.conditional_on == ("perfect_encoders",)


def test_trusted_encoders_are_left_out(noisy_log, noisy_rig):
    result = fit(noisy_log, noisy_rig.pair, perfect_encoders=True)
    assert result.conditional_on == ("perfect_encoders",)
    assert result.outcome == "ok"
    for name in ("driving_encoder_arcsec", "driven_encoder_phase_deg"):
        assert "taken to be perfect" in (result.parameters[name].reason or "")


def test_the_price_of_not_trusting_the_encoders(noisy_rig):
    """1/sin α_w, about 2.9; where the encoders may be trusted."""
    perfect = replace(noisy_rig, driving_encoder=EncoderError(), driven_encoder=EncoderError())
    log = perfect.log(0)
    price, cheap = (
        fit(log, perfect.pair, perfect_encoders=perfect_encoders)
        .parameters["driven_eccentricity_mm"]
        .std
        for perfect_encoders in (False, True)
    )
    assert price is not None and cheap is not None
    assert 2.5 < price / cheap < 3.3


def test_a_drift_is_found_and_taken_away(noisy_log, noisy_rig, noisy_fit):
    time = np.asarray(noisy_log.time)
    scaled = (2 * time - time[0] - time[-1]) / (time[-1] - time[0])
    drifting = EncoderLog.from_arrays(
        time,
        noisy_log.driving_angle / DEG,
        (noisy_log.driven_angle + 30 * ARCSEC * (scaled + 1)) / DEG,
        pair=noisy_rig.pair,
        unit="deg",
    )
    result = fit(drifting, noisy_rig.pair, delay="off")
    assert 20.0 < result.checks.drift_arcsec < 80.0
    assert "drift" in {one.slug for one in result.findings}
    assert "drift" not in {one.slug for one in noisy_fit.findings}
    gap = result.parameters["constant_backlash_deg"]
    assert abs((gap.value or 0.0) - 0.038) < 4 * (gap.std or np.nan)


def test_options_replace_those_of_the_pair(noisy_log, noisy_rig, noisy_fit):
    result = fit(noisy_log, noisy_rig.pair, orders=FIRST_ORDERS)
    assert {(o.shaft, o.order) for o in result.orders} == {("driving", 1), ("driven", 1)}
    assert result.residual_rms_deg > 1.2 * noisy_fit.residual_rms_deg
    # Without options those of the pair hold.
    drive = Drive(Fraction(45, 80), fit=FIRST_ORDERS)
    assert {o.order for o in fit(_copy(noisy_log, drive), drive).orders} == {1}


def test_an_order_that_was_not_asked_for_is_undetermined(noisy_log, noisy_rig):
    options = HarmonicOrders(driving_orders=(2, 3), driven_orders=(1, 2), mesh_orders=1)
    result = fit(noisy_log, noisy_rig.pair, orders=options)
    reason = result.parameters["driving_eccentricity_mm"].reason
    assert reason is not None and "not in the model" in reason
    assert result.parameters["driven_eccentricity_mm"].determined
    assert result.outcome == "partly_determined"


def test_json_keeps_the_schema(noisy_fit, noisy_log, noisy_rig):
    validator = jsonschema.Draft202012Validator(load_schema("vttig.fit/1"))
    drive = _as_drive(noisy_rig)
    short = replace(noisy_rig, motion=PassMotion(reversal_deg=450.0, ramp_s=0.1))
    results = (
        noisy_fit,
        fit(noisy_log, noisy_rig.pair, flank="A"),
        fit(_copy(noisy_log, drive), drive),
        fit(short.log(), noisy_rig.pair),
    )
    for result in results:
        record = result.to_json()
        validator.validate(record)
        del record["parameters"]["delay_s"]
        assert not validator.is_valid(record)


def test_samples_add_up(noisy_fit, noisy_log):
    samples = noisy_fit.samples
    assert samples["read"] == len(noisy_log) == samples["used"] + samples["masked"]
    assert samples["used"] == samples["forward"] + samples["backward"]


def test_the_noise_is_that_of_the_rows(noisy_fit):
    noise = noisy_fit.to_json()["noise"]
    assert noise["model"] == f"AR({len(noise['coefficients'])})"
    assert noise["innovation_std_deg"] < noise["std_deg"]
    assert noise["std_deg"] == pytest.approx(noisy_fit.residual_rms_deg, rel=0.1)
    assert 0 <= noise["slow_share"] < 1
    white = noisy_fit.noise.whitened(np.concatenate(noisy_fit.residuals))
    assert white.std() / DEG == pytest.approx(noise["innovation_std_deg"], rel=0.1)


def test_residuals_stand_beside_their_curves(noisy_fit):
    assert [len(r) for r in noisy_fit.residuals] == [len(c) for c in noisy_fit.curves]
    for residual, curve in zip(noisy_fit.residuals, noisy_fit.curves, strict=True):
        assert residual.std() < 0.3 * curve.transmission_error.std()


def test_64_bit_floats_are_required(monkeypatch):
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)  # the command line sets it
    program = (
        "import numpy as np, vttig_jax\n"
        "from vttig_jax.logs.encoder_log import EncoderLog\n"
        "from vttig_jax.rig.paper import paper_pair\n"
        "pair = paper_pair()\n"
        "angle = np.linspace(0, 1e6, 2000).astype(np.int64)\n"
        "log = EncoderLog.from_arrays(np.arange(2000.0), angle, angle * 9 // 16, pair=pair)\n"
        "try:\n"
        "    vttig_jax.fit(log, pair)\n"
        "except ValueError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("`fit` needs 64-bit floats")
    assert "enable_x64()" in done.stdout
