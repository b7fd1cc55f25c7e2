"""`run` as a pure function: equal to `simulate`, batched, and differentiated."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from benchmarks.compiler import fast_to_compile
from tests.control.scenarios import PAIR, case_of, spec_of
from vttig_jax.control import OUTCOMES, build_case, run, simulate
from vttig_jax.control.simulation.case import Case

SHORT: Mapping[str, Any] = {
    "plant": "play",
    "motion.reversal_deg": 180.0,
    "motion.dwell_s": 0.2,
    "motion.ramp_s": 0.1,
    "judgement.margin_mm": 0.02,
    "actuator.resolution_mm": 0.001,
}
MARGIN, HERTZ = "judgement.margin_mm", "judgement.bandwidth_hz"
AT = {MARGIN: 0.02, HERTZ: 20.0}


def with_settings(case: Case, values: Mapping[str, Any]) -> Case:
    """The case with other settings of its controller and its observer."""
    if MARGIN in values:
        case = replace(case, controller=replace(case.controller, margin_mm=values[MARGIN]))
    if HERTZ in values:
        case = replace(case, observer=replace(case.observer, bandwidth_hz=values[HERTZ]))
    return case


def with_slopes(case: Case, names: tuple[str, ...]) -> Any:
    """A compiled function of some settings: the metrics, and their derivatives."""

    def metrics(values: jax.Array) -> tuple[dict[str, Any], dict[str, Any]]:
        found = run(with_settings(case, dict(zip(names, values, strict=True)))).metrics
        return found, found

    return jax.jit(lambda values: jax.jacfwd(metrics, has_aux=True)(values), **fast_to_compile())


@pytest.fixture(scope="module")
def quantised() -> Case:
    return build_case(spec_of(SHORT, {"controller": "predictive"}), PAIR)


@pytest.fixture(scope="module")
def closing() -> Case:
    """A case whose metrics depend smoothly on the settings of its controller."""
    spec = spec_of(SHORT, {"controller": "predictive"})
    return build_case(spec, PAIR, rounding="none", smooth_width=0.3)


@pytest.fixture(scope="module")
def slopes_of_closing(closing) -> Any:
    return with_slopes(closing, tuple(AT))


def same_number(found: Any, expected: Any, **tolerances: float) -> None:
    """Not a number where the report has None."""
    expected = float("nan") if expected is None else expected
    assert float(found) == pytest.approx(expected, nan_ok=True, **tolerances)


def test_a_run_has_the_metrics_and_samples_of_a_simulation(quantised):
    expected = simulate(spec_of(SHORT, {"controller": "predictive"}), PAIR, trace_every=1)
    found = run(quantised, trace=True)
    assert OUTCOMES[int(found.outcome)] == expected.outcome == "ok"
    for name, value in found.metrics.items():
        same_number(value, expected.metrics[name], rel=1e-12, abs=1e-12)
    assert expected.trace is not None and found.trace is not None
    for one, other in zip(
        jax.tree.leaves(found.trace), jax.tree.leaves(expected.trace), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_stacked_cases_run_in_one_program_like_one_after_the_other():
    specs = [
        spec_of(SHORT, {"controller": "predictive", "motion.reversal_deg": angle, MARGIN: margin})
        for angle, margin in ((180.0, 0.02), (190.0, 0.0), (185.0, -0.05))
    ]
    longest = max(build_case(spec, PAIR).periods for spec in specs)
    cases = [build_case(spec, PAIR, periods=longest) for spec in specs]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *cases)
    together = jax.jit(jax.vmap(run), **fast_to_compile())(stacked)
    assert together.trace is None
    for lane, spec in enumerate(specs):
        alone = simulate(spec, PAIR, trace_every=1)
        assert OUTCOMES[int(together.outcome[lane])] == alone.outcome
        for name, values in together.metrics.items():
            # A count of the encoder is 0.004°, far above this.
            same_number(values[lane], alone.metrics[name], rel=1e-9, abs=1e-10)
    left = np.asarray(together.metrics["residual_gap_deg"]).round(5).tolist()
    assert len(set(left)) == 3


def test_derivatives_are_those_of_differences_at_two_steps(closing, slopes_of_closing):
    at = np.array(list(AT.values()))
    slopes, _ = slopes_of_closing(at)
    for name in ("residual_gap_deg", "jump_deg", "actuator_travel_mm", "te_mean_deg"):
        for place, value in enumerate(at):
            found = []
            for share in (1e-4, 3e-5):
                step = share * value * np.eye(len(at))[place]
                above, below = (slopes_of_closing(at + by)[1][name] for by in (step, -step))
                found.append(float(above - below) / (2 * share * value))
            assert found[0] == pytest.approx(found[1], rel=1e-5, abs=1e-9)
            assert float(slopes[name][place]) == pytest.approx(found[1], rel=1e-5, abs=1e-9)
    assert all(slopes["actuator_travel_mm"] != 0)
    # At the turn the smoothed controller closes as the original one: all but the margin.
    per_mm = np.degrees(float(closing.bounds.closing_sum))
    assert float(slopes["residual_gap_deg"][0]) == pytest.approx(per_mm, rel=1e-6)


@pytest.mark.slow
def test_reverse_mode_gives_the_same_derivative(closing, slopes_of_closing):
    def left(margin: jax.Array) -> Any:
        return run(with_settings(closing, {MARGIN: margin})).metrics["residual_gap_deg"]

    slope = float(jax.jit(jax.grad(left), **fast_to_compile())(AT[MARGIN]))
    expected = slopes_of_closing(np.array(list(AT.values())))[0]["residual_gap_deg"][0]
    assert slope == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.slow
def test_rounding_hides_a_derivative_unless_straight_through_is_chosen(quantised):
    straight = build_case(
        spec_of(SHORT, {"controller": "predictive"}), PAIR, rounding="straight_through"
    )
    found = [with_slopes(case, (MARGIN,))(np.array([0.0205])) for case in (quantised, straight)]
    (hidden, values), (seen, same) = found
    for name in values:
        same_number(values[name], float(same[name]))
    assert float(hidden["residual_gap_deg"][0]) == 0.0
    per_mm = np.degrees(float(quantised.bounds.closing_sum))
    assert float(seen["residual_gap_deg"][0]) == pytest.approx(per_mm, rel=1e-9)


def test_without_rounding_neither_counts_nor_steps_are_left():
    case = build_case(spec_of(SHORT), PAIR, rounding="none")
    kept = build_case(spec_of(SHORT), PAIR)
    for one, zero in ((case, True), (kept, False)):
        parts = one.driving_encoder.count, one.driven_encoder.count, one.actuator.resolution_mm
        assert all((float(part) == 0.0) is zero for part in parts)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"rounding": "never"}, "`rounding` must be one of exact, none, straight_through"),
        ({"smooth_width": float("nan")}, "`smooth_width` must be positive"),
        ({"periods": 2}, "`periods` must be at least"),
    ],
)
def test_a_bad_option_of_a_case_is_named(options, says, unchecked):
    with pytest.raises(ValueError, match=says):
        build_case(spec_of(SHORT), PAIR, **options)


def test_what_cannot_be_smoothed_or_traced_is_refused():
    with pytest.raises(ValueError, match="NoController"):
        build_case(spec_of(SHORT, {"controller": "none"}), PAIR, smooth_width=0.1)
    with pytest.raises(ValueError, match="build it with `build_case`"):
        jax.eval_shape(run, case_of(spec_of(SHORT), PAIR))
