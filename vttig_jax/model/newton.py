"""Newton's method on the exact Hessian of the density, as a minimiser of optimistix."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..base.arrays import Numbers
from .columns import GROUPS
from .density import LAGS, Compressed, Solved, solved

_FAR = np.array([1.0] * LAGS + [1.5])
_FAR_SCALE = 3.0
_FLOOR, _LEAST = 0.2, 0.02
_MOMENTS = 2
_ROUGH = 0.1


class _State(eqx.Module):
    """The best θ so far with value, gradient and Hessian, and the promise of the present step."""

    theta: Float[Array, " p"]
    value: Float[Array, ""]
    gradient: Float[Array, " p"]
    hessian: Float[Array, "p p"]
    damping: Float[Array, ""]
    promise: Float[Array, ""]
    decrement: Float[Array, ""]
    number: Int[Array, ""]
    done: Bool[Array, ""]


class Newton(optx.AbstractMinimiser):
    """Damped Newton steps on a function that returns (value, `Solved`).

    The Hessian is scaled to a unit diagonal; directions of negative curvature are followed
    downhill. No step is longer than `far` in any coordinate. A step that raises the value is
    refused, and the damping grows. The search ends where the decrement gᵀ H⁻¹ g is below `atol` and
    no longer falls to a quarter: there a step squares it, so that what is left is rounding. A
    `rough` search ends at a decrement of a tenth already.
    The first `moments` steps are those of expectation and maximisation: from a far start the
    density is not convex in the noise.
    """

    rtol: float = 0.0
    atol: float = 1e-4
    norm: Any = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """Return the state before the first step."""
        zero, far = jnp.zeros(()), jnp.full((), jnp.inf)
        number, done = jnp.zeros((), int), jnp.zeros((), bool)
        hessian = jnp.eye(len(y))
        return _State(y, far, jnp.zeros(len(y)), hessian, zero, zero, far, number, done)

    def step(self, fn, y, args, options, state, tags):
        """Evaluate at `y`, keep or refuse it, and return the next `y`."""
        value, told = fn(y, args)
        better = value <= state.value + 1e-9 * jnp.abs(value)
        gain = jnp.where(state.promise > 0, (state.value - value) / state.promise, 1.0)
        eased = state.damping * jnp.where(gain > 0.5, 0.125, jnp.where(gain < 0.1, 2.0, 1.0))
        damping = jnp.where(better, eased, jnp.maximum(4 * state.damping, 0.3))
        pick = lambda new, old: jnp.where(better, new, old)  # noqa: E731
        theta, value = pick(y, state.theta), pick(value, state.value)
        gradient, hessian = (pick(told.gradient, state.gradient), pick(told.hessian, state.hessian))
        scale = 1 / jnp.sqrt(jnp.maximum(jnp.abs(jnp.diag(hessian)), _FLOOR))
        curvature, axes = jnp.linalg.eigh(hessian * scale[:, None] * scale[None])
        along, size = axes.T @ (gradient * scale), jnp.maximum(jnp.abs(curvature), _LEAST)
        step = -scale * (axes @ (along / (size + damping)))
        step = step / jnp.maximum(1.0, jnp.max(jnp.abs(step) / options["far"]))
        expected = better & (state.number < options["moments"])
        step = jnp.where(expected, told.moments - theta, step)
        decrement = jnp.sum(along**2 / size)
        promise = -(gradient @ step + 0.5 * step @ hessian @ step)
        rough = options["rough"]
        near = (decrement < jnp.where(rough, _ROUGH, self.atol)) & (curvature[0] > 0)
        done = better & near & (rough | (decrement >= 0.25 * state.decrement))
        number = state.number + 1
        decrement = jnp.where(near, decrement, jnp.inf)
        state = _State(theta, value, gradient, hessian, damping, promise, decrement, number, done)
        return jnp.where(done, theta, theta + step), state, told

    def terminate(self, fn, y, args, options, state, tags):
        """Return whether the decrement is small."""
        return state.done, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """Return the best θ."""
        return state.theta, aux, {}


def first_theta(logs: Compressed) -> Float[np.ndarray, " p"]:
    """Return where the search starts: correlated noise, large orders and drift, small parts."""
    small = np.array([name in ("delay_parts", "gap_by_speed") for name in GROUPS])
    # Large differences too: with small ones the search ends where noise remembers in their place.
    widths = np.where(small, np.log(logs.usual) - 2.0, np.maximum(np.log(logs.usual), 0.0))
    return np.concatenate([[1.0], np.zeros(LAGS - 1), [-0.5], widths])


def maximise(
    logs: Compressed, start: Float[Numbers, " p"] | None = None, *, rough: bool = False
) -> optx.Solution:
    """Return the θ of the largest density; its `aux` is the `Solved` there.

    Without a `start` the search begins at large orders and drift, with two steps of expectation and
    maximisation. `rough`: whether it is enough to tell this maximum from others.
    """
    moments = 0 if start is not None else _MOMENTS
    start = first_theta(logs) if start is None else start
    return _maximise(logs, np.asarray(start), np.asarray(moments), np.asarray(rough))


@eqx.filter_jit
def _maximise(
    logs: Compressed,
    start: Float[Numbers, " p"],
    moments: Int[Numbers, ""],
    rough: Bool[Numbers, ""],
) -> optx.Solution:
    far = jnp.concatenate([_FAR, jnp.full(len(logs.on), _FAR_SCALE)])

    def negative(theta: Float[Array, " p"], logs: Compressed) -> tuple[Float[Array, ""], Solved]:
        told = solved(theta, logs)
        return told.value, told

    options, start = {"far": far, "moments": moments, "rough": rough}, jnp.asarray(start)
    return optx.minimise(
        negative, Newton(), start, logs, options, has_aux=True, max_steps=60, throw=False
    )
