"""The pure fit beside `vttig_jax.fit`, its derivatives beside differences, and its codes."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, Mesh
from jax.sharding import PartitionSpec as P
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lfilter

import vttig_jax
from benchmarks.compiler import fast_to_compile
from vttig_jax.identify import (
    ArrayFit,
    BatchModel,
    Code,
    LogArrays,
    fit_arrays,
    fit_batch,
    prepared,
)
from vttig_jax.identify.many.log_arrays import stacked
from vttig_jax.identify.many.rows import shifted
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.rig import PassMotion, paper_rig

ORDERS = HarmonicOrders(driving_orders=(1,), driven_orders=(1,), mesh_orders=0)
MOTION = PassMotion(speed_rpm=240.0, reversal_deg=2880.0, dwell_s=0.2, ramp_s=0.2)
SAME = {"orders": ORDERS, "drift_order": 1, "delay": 2e-4}
"""A delay and a drift, so that both are compared too."""

LAGS = 8


@pytest.fixture(scope="module")
def logs():
    rig = replace(paper_rig(motion=MOTION), orders=())
    return rig.pair, [rig.log(seed) for seed in range(2)]


@pytest.fixture(scope="module")
def batch(logs) -> tuple[BatchModel, LogArrays]:
    model, arrays = prepared(logs[1], logs[0], **SAME, lags=LAGS)
    singles = [jax.tree.map(lambda x, k=k: x[k], arrays) for k in range(2)]
    return model, stacked(singles, model.shape.samples, count=4)


@pytest.fixture(scope="module")
def program(batch) -> Callable[[LogArrays], ArrayFit]:
    """The fit of a batch, spread over two devices where there are two."""
    model, _ = batch
    devices = np.array(jax.devices()[: 2 if len(jax.devices()) > 1 else 1])
    mesh = Mesh(devices, ("logs",), axis_types=(AxisType.Auto,))
    logs = P("logs")
    spread = jax.shard_map(
        lambda part: fit_batch(model, part),
        mesh=mesh,
        in_specs=logs,
        out_specs=logs,
        check_vma=False,
    )
    return jax.jit(spread, **fast_to_compile())


@pytest.fixture(scope="module")
def found(program, batch) -> ArrayFit:
    return program(batch[1])


def test_parameters_are_those_of_single_fits(logs, batch, found):
    pair, own = logs
    for place, log in enumerate(own):
        single = vttig_jax.fit(log, pair, **SAME, loss="square", lines="report")
        assert single.covariance_names == batch[0].names
        std = np.sqrt(np.diag(single.covariance))
        assert np.abs((found.values[place] - single.values) / std).max() < 1e-4
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance[place])), std, rtol=1e-6)
        assert found.order[place] == len(single.noise.partial)
        order = int(found.order[place])
        np.testing.assert_allclose(found.partial[place, :order], single.noise.partial, atol=1e-6)
        assert found.innovation_std[place] == pytest.approx(single.noise.innovation_std, rel=1e-6)
        assert found.std[place] == pytest.approx(single.noise.std, rel=1e-6)
    # The two logs differ by their noise, which the comparison above must see.
    std = np.sqrt(np.diag(found.covariance[0]))
    assert np.abs((found.values[0] - found.values[1]) / std).max() > 0.1


def test_empty_logs_have_a_code_and_zeros(found):
    assert found.code.tolist() == [Code.OK, Code.OK, Code.EMPTY, Code.EMPTY]
    for numbers in found[:5]:
        assert not np.any(np.asarray(numbers)[2:])


def test_whole_turns_may_be_taken_off(program, batch, found):
    model, arrays = batch
    wrapped = [np.remainder(angle, 2 * np.pi) for angle in (arrays.driving, arrays.driven)]
    assert np.ptp(wrapped[0]) < 2 * np.pi < np.ptp(arrays.driving)
    other = program(arrays._replace(driving=wrapped[0], driven=wrapped[1]))
    std = np.sqrt(np.diagonal(found.covariance[:2], axis1=1, axis2=2))
    moved = (other.values - found.values)[:2] / std
    offset = model.names.index("offset")
    assert np.abs(np.delete(moved, offset, axis=1)).max() < 1e-4


def test_bad_logs_have_codes(program, batch):
    model, arrays = batch
    first = jax.tree.map(lambda x: np.asarray(x)[0], arrays)
    middle = int(first.length) // 4
    broken = np.array(first.driven)
    broken[middle] = np.nan
    few = np.array(first.on_flank)
    few[:, : int(first.length)] = False
    few[:, middle : middle + 60] = True
    split = np.array(first.on_flank)
    split[0, middle] = False
    steps = np.random.default_rng(1).normal(size=model.shape.samples)
    wandering = lfilter([1e-4], [1.0, -0.9998], steps)
    bad = [
        first._replace(driven=broken),
        first._replace(on_flank=few),
        first._replace(on_flank=split),
        first._replace(driven=np.asarray(first.driven) + wandering),
    ]
    result = program(stacked(bad, model.shape.samples))
    codes = [Code.NOT_FINITE, Code.TOO_FEW_ROWS, Code.NO_ROOM, Code.LONG_MEMORY]
    assert result.code.tolist() == codes
    assert np.all(np.isfinite(np.asarray(result.values)))


def test_derivatives_are_those_of_differences_at_two_steps(batch, found):
    model, arrays = batch
    log = jax.tree.map(lambda x: jnp.asarray(x)[0], arrays)
    generator = np.random.default_rng(3)
    weights, order = generator.normal(size=2 * len(model.names)), int(found.order[0])
    std = np.sqrt(np.diag(found.covariance[0]))
    log = log._replace(length=log.length - 40)

    @partial(jax.jit, **fast_to_compile())
    @jax.value_and_grad
    def total(driven):
        """A sum of parameters, variances and the noise; `driven` is also behind the log."""
        fitted = fit_arrays(model, log._replace(driven=driven))
        spread = jnp.log(jnp.diagonal(fitted.covariance))
        numbers = jnp.concatenate([fitted.values / std, spread])
        return weights @ numbers + jnp.sum(fitted.partial)

    slope = total(log.driven)[1]
    behind = np.arange(model.shape.samples) >= log.length
    assert order > 0 and behind.sum() >= 40
    assert np.all(np.isfinite(slope)) and not np.any(slope[behind])
    change = 1e-6 * generator.normal(size=model.shape.samples)
    errors = []
    for step in (1.0, 0.1):
        ends = [total(log.driven + sign * step * change)[0] for sign in (1, -1)]
        errors.append(abs(float(ends[0] - ends[1]) / (2 * step) / float(slope @ change) - 1))
    # A Gauss–Newton last step differentiates wrongly by 2e-3.
    assert errors[0] < 1e-4 and errors[1] < 1e-6


@pytest.mark.parametrize("delay_s", [0.0137, -0.041])
def test_a_shifted_angle_is_that_of_a_cubic_spline(delay_s):
    """At unequal times and a jerky motion; the samples behind the log take no part."""
    generator = np.random.default_rng(4)
    time = 3.0 + np.cumsum(generator.uniform(0.01, 0.03, 60))
    angle = np.cumsum(generator.normal(1.0, 2.0, 60))
    spline = CubicHermiteSpline(time, angle, np.gradient(angle, time))
    expected = spline(np.clip(time - delay_s, time[0], time[-1]))
    behind = np.zeros(7)
    times, angles = (jnp.asarray(np.append(values, behind)) for values in (time, angle))
    found = shifted(times, angles, jnp.asarray(60), jnp.asarray(delay_s))[:60]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    assert np.abs(expected - np.interp(time - delay_s, time, angle)).max() > 0.1
