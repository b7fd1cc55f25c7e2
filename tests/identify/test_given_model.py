"""Fits of a flank model of the user's own: a two-stage drive, and the exact relation itself."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from msgspec import convert
from scipy.optimize import least_squares
from scipy.signal import lfilter

import vttig_jax
from tests.identify.drives import known
from vttig_jax.base import ARCSEC, DEG, InputError, NoAnswerError, UsageError
from vttig_jax.identify import Fit, FitSettings, fit
from vttig_jax.logs import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments
from vttig_jax.pair import Drive, HarmonicOrders
from vttig_jax.runs.run_file import read_run, require_same_data

DRIVE = Drive(Fraction(391, 3200), name="two stages")
PLAIN: dict[str, Any] = {"delay": "off", "lines": "report", "ratio_within": 0.0}
"""Settings with which nothing is selected, for a fit beside an oracle."""

GAP = 0.02 * DEG
TRUTH = np.array([20.0, 50.0, 30.0, 4.0, 6.0, -12.0]) * ARCSEC


class TwoStages(eqx.Module):
    """Sines of three shafts and two meshes, and the cosine of the shaft without an encoder."""

    shafts: jax.Array
    meshes: jax.Array
    cosine: jax.Array
    orders: tuple[float, ...] = eqx.field(
        static=True, default=(1.0, 23 / 64, 391 / 3200, 5.0, 17 * 23 / 64)
    )

    def transmission_error(self, angle, flank):
        phase = angle[:, None] * jnp.asarray(self.orders)[None, :]
        waves = jnp.sin(phase) @ jnp.concatenate([self.shafts, self.meshes])
        lag = 0.3 if flank == "B" else 0.0
        return waves + self.cosine * jnp.cos(self.orders[1] * angle + lag)


def two_stages(values: Any) -> TwoStages:
    shafts, meshes, cosine = values[:3], values[3:5], values[5]
    return TwoStages(jnp.asarray(shafts), jnp.asarray(meshes), jnp.asarray(cosine))


START = two_stages(np.zeros(6))


def flanks_of(values: np.ndarray, angle: np.ndarray) -> list[np.ndarray]:
    """Transmission error of both flanks."""
    model, places = two_stages(values), jnp.asarray(angle)
    return [np.asarray(model.transmission_error(places, flank)) for flank in ("A", "B")]


def two_stage_log(
    seed: int, *, rho: float = 0.0, delay_s: float = 0.0, rpms: tuple[float, ...] = (30.0,)
) -> EncoderLog:
    """A log of 20 turns forth and back at every speed, with white or AR(1) noise."""
    rate = 200.0
    pieces = [np.zeros(40)]
    for rpm in rpms:
        steps = int(20 * 60 / rpm * rate)
        pieces += [np.full(steps, rpm), np.zeros(40), np.full(steps, -rpm), np.zeros(40)]
    speed = np.concatenate(pieces) * 2 * np.pi / 60
    driving = np.concatenate([[0.0], np.cumsum(speed) / rate])
    time = np.arange(len(driving)) / rate
    seen = np.interp(time - delay_s, time, driving)
    backward = np.interp(time - delay_s, time, np.append(speed, 0.0)) < -1e-9
    forth, back = flanks_of(TRUTH, seen)
    error = np.where(backward, back + GAP, forth)
    white = np.random.default_rng(seed).standard_normal(len(time)) * np.sqrt(1 - rho**2)
    shocks = np.asarray(lfilter([1.0], [1.0, -rho], white))
    driven = seen * float(DRIVE.ratio) + error + 2.0 * ARCSEC * shocks
    return EncoderLog.from_arrays(
        time, np.degrees(driving), np.degrees(driven), pair=DRIVE, unit="deg", source=f"two {seed}"
    )


def parameter(result: Fit, name: str) -> Any:
    """A parameter of a fit, whose numbers the test compares."""
    return result.parameters[name]


def model_part(result: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard errors of the parameters of the model."""
    own: list[Any] = [p for name, p in result.parameters.items() if name.startswith("model.")]
    return np.array([p.value for p in own]), np.array([p.std for p in own])


@pytest.fixture(scope="module")
def white_log() -> EncoderLog:
    return two_stage_log(0)


@pytest.fixture(scope="module")
def white_fit(white_log):
    return fit(white_log, DRIVE, model=START, **PLAIN)


def test_least_squares_of_the_samples_gives_the_same_numbers(white_log, white_fit):
    """At 400 samples a turn and orders up to 6.1 a row is four samples, which lose 0.1 %."""
    used = assigned_segments(white_log).segments
    joined = lambda array: np.concatenate([array[s.start : s.stop] for s in used])  # noqa: E731
    angle, error = joined(white_log.driving_angle), joined(white_log.transmission_error)
    back = np.concatenate([np.full(s.stop - s.start, s.flank == "B") for s in used])

    def left(scaled):
        sides = flanks_of(scaled[:6] * ARCSEC, angle)
        fitted = np.where(back, sides[1] + scaled[7] * ARCSEC, sides[0]) + scaled[6] * ARCSEC
        return (error - fitted) / ARCSEC

    found = least_squares(left, np.zeros(8))
    variance = 2 * found.cost / (len(angle) - 8)
    std = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * variance) * ARCSEC
    gap = parameter(white_fit, "constant_backlash_deg")
    value, own = model_part(white_fit)
    value, own = np.append(value, gap.value * DEG), np.append(own, gap.std * DEG)
    places = [0, 1, 2, 3, 4, 5, 7]
    # The gap lies beside a level that may drift, which least squares of the samples do not know.
    np.testing.assert_allclose(own[:-1], std[places][:-1], rtol=0.15)
    assert np.max(np.abs(value - found.x[places] * ARCSEC) / std[places]) < 1.0


def test_one_flank_without_orders_has_the_numbers_of_its_flank_model_alone(white_log):
    log, none = white_log, HarmonicOrders(driving_orders=(), driven_orders=())
    value, std = model_part(fit(log, DRIVE, model=START, flank="A", **PLAIN))
    assert np.max(np.abs(value - TRUTH) / std) < 4.0
    nothing = fit(log, DRIVE, orders=none, flank="A", **PLAIN)
    assert nothing.outcome == "not_determined"
    assert all(one.value is None for one in nothing.parameters.values())


@pytest.mark.parametrize("seed", range(2))
def test_parameters_lie_within_their_intervals(seed):
    """Beside a delay and correlated noise, which the same machinery as in every fit finds."""
    log = two_stage_log(seed, rho=0.6, delay_s=2e-3, rpms=(30.0, 60.0))
    result = fit(log, DRIVE, model=START)
    value, std = model_part(result)
    assert np.max(np.abs(value - TRUTH) / std) < 4.0
    assert result.noise.slow_share > 0.01
    delay, gap = parameter(result, "delay_s"), parameter(result, "constant_backlash_deg")
    assert abs(delay.value - 2e-3) < 4 * delay.std and delay.std < 2e-4
    assert abs(gap.value * DEG - GAP) < 4 * gap.std * DEG
    assert result.outcome == "ok" and result.conditional_on == ("flank_model",)


class Turning(eqx.Module):
    """The middle shaft alone, with its order as a parameter: not linear in it."""

    waves: jax.Array
    order: jax.Array

    def transmission_error(self, angle, flank):
        rest = two_stages(TRUTH * [1, 0, 1, 1, 1, 0]).transmission_error(angle, "A")
        lag = 0.3 if flank == "B" else 0.0
        middle = self.waves[0] * jnp.sin(self.order * angle)
        return rest + middle + self.waves[1] * jnp.cos(self.order * angle + lag)


def test_an_order_of_the_model_is_a_parameter_like_others(white_log):
    start = Turning(jnp.array([1e-4, 1e-5]), jnp.asarray(0.3605))
    result = fit(white_log, DRIVE, model=start, **PLAIN)
    order = parameter(result, "model.order")
    assert abs(order.value - 23 / 64) < 4 * order.std and order.std < 3e-5
    value, std = model_part(result)
    assert np.max(np.abs(value[:2] - TRUTH[[1, 5]]) / std[:2]) < 4.0


def test_the_report_the_folder_and_the_curves_of_a_model(white_fit, tmp_path):
    """A run with a model is not repeated from its file, and has no eccentricities."""
    text = str(white_fit)
    assert "flank model          TwoStages" in text and "model.shafts[1]" in text
    white_fit.save(tmp_path / "run", figures=True)
    assert (tmp_path / "run" / "figures" / "te_fit.png").is_file()
    run = vttig_jax.open_run(tmp_path / "run")
    assert run.fit.parameters == white_fit.parameters and str(run.fit) == text
    assert run.fit.to_json() == white_fit.to_json()
    np.testing.assert_array_equal(run.fit.covariance, white_fit.covariance)
    with pytest.raises(UsageError, match="TwoStages, whose code a run folder does not hold"):
        vttig_jax.backlash_map(run.fit)
    with pytest.raises(InputError, match=r"whose code run\.toml does not hold"):
        require_same_data(read_run(tmp_path / "run"))
    with pytest.raises(NoAnswerError, match="TwoStages has no eccentricities"):
        white_fit.eccentricities()
    fitted = white_fit.given.fitted
    np.testing.assert_allclose(fitted.shafts, model_part(white_fit)[0][:3], rtol=1e-12)
    curve, residual = white_fit.curves[0], white_fit.residuals[0]
    model = white_fit.flank_model.transmission_error(jnp.asarray(curve.driving_angle), curve.flank)
    away = curve.transmission_error - residual - np.asarray(model)
    assert np.max(np.abs(away)) < 0.02 * np.ptp(curve.transmission_error)


def test_settings_and_models_that_do_not_fit_are_refused(white_log, white_fit, unchecked):
    for name in ("perfect_encoders", "perfect_gears"):
        settings = convert({name: True}, FitSettings)
        with pytest.raises(UsageError, match=f"{name} says what the exact relation contains"):
            fit(white_log, DRIVE, model=START, settings=settings)
    with pytest.raises(UsageError, match="several logs with zeros of their own"):
        fit([white_log, replace(white_log, source="other")], DRIVE, model=START)
    with pytest.raises(ValueError, match=r"`orders`.*HarmonicOrders"):
        fit(white_log, DRIVE, model=START, orders={"driving": (1,)})  # pyright: ignore
    with pytest.raises(ValueError, match=r"`fit`.*band_map"):
        vttig_jax.backlash_map(white_fit.parameters)  # pyright: ignore
    kink = of(lambda m, angle, _: jnp.sqrt(m.size) * jnp.cos(angle), 0.0)
    words = "Wave has no finite derivative by model.size on flank A at the driving angle"
    with pytest.raises(NoAnswerError, match=words):
        fit(white_log, DRIVE, model=kink)


class Wave(eqx.Module):
    """One wave with a leaf of any kind, or another formula of the model, angle and flank."""

    size: Any
    extra: Any = None
    formula: Callable = eqx.field(static=True, default=lambda m, angle, _: m.size * jnp.cos(angle))

    def transmission_error(self, angle, flank):
        return self.formula(self, angle, flank)


def of(formula: Callable, size: float = 1e-4, extra: Any = None) -> Wave:
    return Wave(jnp.asarray(size), extra, formula)


def failing(model, angle, flank):
    raise RuntimeError("mine")


ONE = jnp.asarray(1e-4)
WRONG = [
    (3, "a int has no method `transmission_error", "model"),
    (Wave(2), "Wave has no parameters", "model"),
    (Wave(1e-4), "the leaf is a Python float", "model.size"),
    (Wave(ONE + 1j), "the leaf is a complex number", "model.size"),
    (Wave(ONE, {1}), "Wave fails on flank A, .* unhashable type: 'set'", "model"),
    (of(lambda m, *_: m.size), r"Wave returns float64 of shape \(\) on flank A", "model"),
    (of(lambda m, a, _: a if a > 1 else m.size), r"on flank A, where JAX traces it \(", "model"),
    (of(failing), r"fails on flank A, .*\(RuntimeError: mine, in test_g", "model"),
    (Wave, "Wave is a class; give an instance", "model"),
]


@pytest.mark.parametrize(("model", "words", "where"), WRONG)
def test_a_wrong_model_is_refused_in_one_sentence(white_log, model, words, where):
    with pytest.raises(UsageError, match=words) as caught:
        fit(white_log, DRIVE, model=model)
    assert caught.value.where == where and "\n" not in str(caught.value)


@pytest.mark.slow
def test_what_free_orders_or_the_constant_backlash_explain_stays_at_its_start(white_log):
    result = fit(white_log, DRIVE, model=Wave(ONE), orders=HarmonicOrders((1,), (), 0), **PLAIN)
    size = parameter(result, "model.size")
    assert not size.determined and "free orders of the fit explain it" in size.reason
    assert "stays at 0.0001" in size.reason
    (order, _) = result.orders
    assert (order.shaft, order.order) == ("driving", 1)
    formula = lambda m, a, flank: m.size * jnp.sin(a) + (m.extra if flank == "B" else 0.0)  # noqa: E731
    models = [of(formula, extra=jnp.asarray(gap)) for gap in (3 * GAP, 0.0)]
    fits = [fit(white_log, DRIVE, model=model, **PLAIN) for model in models]
    gaps = [parameter(one, "constant_backlash_deg").value for one in fits]
    assert gaps[1] - gaps[0] == pytest.approx(3 * GAP / DEG, abs=1e-6)
    covered = [known(one.checks.gap_over_angles_covered.value) for one in fits]
    assert covered[0] == pytest.approx(covered[1], abs=1e-6)
    assert "explain it as well" in parameter(fits[0], "model.extra").reason


def test_free_orders_stand_beside_a_model(white_log):
    """A model of the first order with a leaf that does nothing, and a mesh on each flank."""
    orders = HarmonicOrders((5,), (), 0)
    result = fit(white_log, DRIVE, model=Wave(ONE, ONE), orders=orders, **PLAIN)
    assert "no sample depends on it" in parameter(result, "model.extra").reason
    assert result.outcome == "partly_determined"
    for order in result.orders:
        assert order.order == 5 and abs(order.amplitude_arcsec - 4.0) < 5 * order.std_arcsec
