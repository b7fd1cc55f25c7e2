"""The fit as a whole: truth on noise-free rigs, every argument, refusals, and its JSON."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import jax
import jsonschema
import numpy as np
import pytest

from tests.identify.drives import near
from tests.identify.quick import TRUTH
from tests.schemas import load_schema
from vttig_jax.base import ARCSEC, DEG
from vttig_jax.identify import Fit, fit
from vttig_jax.logs import EncoderLog
from vttig_jax.pair import Drive, HarmonicOrders
from vttig_jax.rig import EncoderError, PassMotion
from vttig_jax.rig.imperfections import OrderError

SHAFTS = ("driving", "driven")
PARTS = ("eccentricity_mm", "phase_deg", "encoder_arcsec", "encoder_phase_deg")
PAIR_NAMES = {f"{shaft}_{part}" for shaft in SHAFTS for part in PARTS}
PAIR_NAMES |= {"constant_backlash_deg", "delay_s"}
DRIVE_NAMES = {name.replace("eccentricity_mm", "amplitude_arcsec") for name in PAIR_NAMES}
FIRST_ORDERS = HarmonicOrders(driving_orders=(1,), driven_orders=(1,), mesh_orders=0)
TEN_TURNS = PassMotion(speed_rpm=180.0, reversal_deg=3600.0)


@pytest.fixture(scope="module")
def one_flank(noisy_log, noisy_rig) -> dict[str, Any]:
    """Fits of each flank alone."""
    return {flank: fit(noisy_log, noisy_rig.pair, flank=flank) for flank in "AB"}


@pytest.fixture(scope="module")
def drive_fit(noisy_log, noisy_rig) -> Fit:
    """Fit of the same readings without geometry."""
    return fit(noisy_log, Drive(Fraction(45, 80), fit=noisy_rig.pair.fit))


def test_encoder_errors_are_told_from_the_gears(clean_rig):
    errors = {"driving": (18.0, 30.0), "driven": (12.0, 200.0)}
    encoders: Any = {f"{shaft}_encoder": EncoderError(*one) for shaft, one in errors.items()}
    rig = replace(clean_rig, motion=TEN_TURNS, **encoders)
    result = fit(rig.log(), rig.pair)
    for shaft, (size, phase) in errors.items():
        assert result.value(f"{shaft}_encoder_arcsec") == pytest.approx(size, rel=3e-2)
        assert result.value(f"{shaft}_encoder_phase_deg") == pytest.approx(phase, rel=3e-2)
    # The zero of gear 2 moves with its encoder's reading: 12″ sin 200° of phase.
    for name, value in TRUTH.items():
        assert result.parameters[name].value == pytest.approx(value, rel=5e-3), name


def test_orders_carry_their_amplitude_and_phase(clean_rig):
    errors = (
        OrderError("driving", 3, "A", 0.002, 40.0),
        OrderError("driven", 2, "B", 0.001, 250.0),
        OrderError("mesh", 1, "B", 0.003, 10.0),
    )
    rig = replace(clean_rig, orders=errors, motion=TEN_TURNS)
    table = {(o.shaft, o.order, o.flank): o for o in fit(rig.log(), rig.pair).orders}
    for error in errors:
        order = table[error.shaft, error.order, error.flank]
        assert order.amplitude_arcsec == pytest.approx(error.amplitude_deg * 3600, rel=0.1)
        assert order.phase_deg == pytest.approx(error.phase_deg, abs=6.0)
        other = table[error.shaft, error.order, "A" if error.flank == "B" else "B"]
        assert other.amplitude_arcsec < 0.15 * order.amplitude_arcsec
    # Without noise the product of two orders is seen as a line.
    assert {(o.shaft, o.order) for o in table.values() if float(o.order).is_integer()} == {
        *((shaft, k) for shaft in SHAFTS for k in range(1, 9)),
        ("mesh", 1),
    }


def test_names_of_the_contract_are_always_there_and_json_keeps_the_schema(
    noisy_fit, one_flank, drive_fit, noisy_rig
):
    """What is undetermined has a reason and no value."""
    for result in (noisy_fit, *one_flank.values(), drive_fit):
        assert set(result.parameters) == (DRIVE_NAMES if result is drive_fit else PAIR_NAMES)
        for parameter in result.parameters.values():
            assert parameter.determined or (parameter.value is None and parameter.reason)
    assert drive_fit.outcome == "ok" and drive_fit.conditional_on == ()
    assert "no gear geometry" in (drive_fit.parameters["driving_encoder_arcsec"].reason or "")
    validator = jsonschema.Draft202012Validator(load_schema("vttig.fit/1"))
    short = replace(noisy_rig, motion=PassMotion(reversal_deg=450.0, ramp_s=0.1))
    for result in (noisy_fit, one_flank["A"], drive_fit, fit(short.log(), noisy_rig.pair)):
        record = result.to_json()
        validator.validate(record)
        del record["parameters"]["delay_s"]
        assert not validator.is_valid(record)


def test_one_direction_is_conditional_on_perfect_encoders(one_flank, noisy_rig, noisy_fit):
    assert noisy_fit.conditional_on == ()
    one_pass = replace(noisy_rig, motion=replace(noisy_rig.motion, passes=1))
    for result in (one_flank["A"], fit(one_pass.log(), noisy_rig.pair)):
        assert result.flanks == ("A",) and result.conditional_on == ("perfect_encoders",)
    result, other = one_flank["A"], one_flank["B"]
    assert result.outcome == "partly_determined"
    gap = result.parameters["constant_backlash_deg"]
    assert not gap.determined and "one direction" in (gap.reason or "")
    assert not result.parameters["driving_encoder_arcsec"].determined
    # 18″ of encoder go into the eccentricity.
    moved = result.value("driving_eccentricity_mm") - noisy_fit.value("driving_eccentricity_mm")
    assert abs(moved) > 5 * result.parameters["driving_eccentricity_mm"].std
    assert other.flanks == ("B",)
    assert result.samples["backward"] == other.samples["forward"] == 0
    assert result.value("driving_phase_deg") != other.value("driving_phase_deg")


def test_trusted_encoders_are_left_out(noisy_log, noisy_rig, noisy_fit):
    """The price of not trusting them is 1/sin α_w, about 2.9."""
    result = fit(noisy_log, noisy_rig.pair, perfect_encoders=True)
    assert result.conditional_on == ("perfect_encoders",) and result.outcome == "ok"
    for name in ("driving_encoder_arcsec", "driven_encoder_phase_deg"):
        assert "taken to be perfect" in (result.parameters[name].reason or "")
    dear, cheap = (one.parameters["driven_eccentricity_mm"].std for one in (noisy_fit, result))
    assert dear is not None and cheap is not None and 2.5 < dear / cheap < 3.3


def test_a_drift_is_found_and_taken_away(noisy_log, noisy_rig, noisy_fit):
    time = noisy_log.time
    drift = 60 * ARCSEC * (time - time[0]) / (time[-1] - time[0])
    angles = noisy_log.driving_angle / DEG, (noisy_log.driven_angle + drift) / DEG
    drifting = EncoderLog.from_arrays(time, *angles, pair=noisy_rig.pair, unit="deg")
    result = fit(drifting, noisy_rig.pair, delay="off")
    assert 20.0 < result.checks.drift_arcsec < 80.0
    assert "drift" in {one.slug for one in result.findings}
    assert "drift" not in {one.slug for one in noisy_fit.findings}
    assert near(result.parameters["constant_backlash_deg"], 0.038)


def test_orders_replace_those_of_the_pair_and_others_are_undetermined(
    noisy_log, noisy_rig, noisy_fit
):
    result = fit(noisy_log, noisy_rig.pair, orders=FIRST_ORDERS)
    assert {(o.shaft, o.order) for o in result.orders} == {("driving", 1), ("driven", 1)}
    assert result.residual_rms_deg > 1.2 * noisy_fit.residual_rms_deg
    # Without options those of the pair hold.
    assert {o.order for o in fit(noisy_log, Drive(Fraction(45, 80), fit=FIRST_ORDERS)).orders} == {
        1
    }
    options = HarmonicOrders(driving_orders=(2, 3), driven_orders=(1, 2), mesh_orders=1)
    result = fit(noisy_log, noisy_rig.pair, orders=options)
    reason = result.parameters["driving_eccentricity_mm"].reason
    assert reason is not None and "not in the model" in reason
    assert result.parameters["driven_eccentricity_mm"].determined
    assert result.outcome == "partly_determined"


def test_samples_residuals_and_noise_are_those_of_the_log(noisy_fit, noisy_log):
    samples = noisy_fit.samples
    assert samples["read"] == len(noisy_log) == samples["used"] + samples["masked"]
    assert samples["used"] == samples["forward"] + samples["backward"]
    for residual, curve in zip(noisy_fit.residuals, noisy_fit.curves, strict=True):
        assert len(residual) == len(curve)
        assert residual.std() < 0.3 * curve.transmission_error.std()
    noise = noisy_fit.to_json()["noise"]
    assert noise["model"] == f"AR({len(noise['coefficients'])})"
    assert noise["innovation_std_deg"] < noise["std_deg"]
    assert noise["std_deg"] == pytest.approx(noisy_fit.residual_rms_deg, rel=0.1)
    assert 0 <= noise["slow_share"] < 1
    white = noisy_fit.noise.whitened(np.concatenate(noisy_fit.residuals))
    assert white.std() / DEG == pytest.approx(noise["innovation_std_deg"], rel=0.1)


def test_64_bit_floats_are_required(noisy_log, noisy_rig):
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match=r"^`fit` needs 64-bit floats.*enable_x64\(\)"):
            fit(noisy_log, noisy_rig.pair)
    finally:
        jax.config.update("jax_enable_x64", True)
