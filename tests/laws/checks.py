"""What every public function must keep, as checks that raise AssertionError where it does not.

A function under test takes arrays or pytrees of arrays, the first of them one-dimensional, and
works element by element on the first.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.compiler import fast_to_compile

Function = Callable[..., Any]
Arguments = tuple[Any, ...]


def as_arrays(tree: Any) -> Any:
    """Make every number of a pytree a JAX array, so that all of them can be moved."""
    return jax.tree.map(jnp.asarray, tree)


@cache
def _modes(function: Function) -> Function:
    """Value, forward and reverse derivative of `function`, compiled once.

    Both share one linear map, as inside `jax.vjp`, which halves the time to compile.
    """

    @partial(jax.jit, **fast_to_compile())
    def modes(arguments, direction, weights):
        value, push = jax.linearize(function, *arguments)
        backward = jax.linear_transpose(push, *arguments)(weights)
        return value, push(*direction), backward

    return modes


def check_double(function: Function, arguments: Arguments) -> None:
    """Double precision out, also where whole numbers or single precision go in."""
    assert function(*arguments).dtype == np.float64
    for kind in (np.float32, np.int64):
        angles = jnp.asarray(arguments[0]).astype(kind)
        traced = jax.make_jaxpr(function)(angles, *as_arrays(arguments[1:]))
        assert traced.out_avals[0].dtype == np.float64
        assert not _single(traced.jaxpr), "computed in single precision"


def check_jit_is_eager(function: Function, arguments: Arguments) -> None:
    """The value of the program that the derivatives need too is that of an eager evaluation."""
    with jax.disable_jit():
        eager = function(*arguments)
    arguments = as_arrays(arguments)
    ones = jax.tree.map(jnp.ones_like, arguments)
    value, *_ = _modes(function)(arguments, ones, ones[0])
    np.testing.assert_allclose(value, eager, rtol=1e-11, atol=1e-15)


def check_vmap_is_loop(function: Function, arguments: Arguments) -> None:
    """Elements do not know of each other, and `vmap` over all arguments equals a loop."""
    angles, *others = arguments
    alone = np.asarray(function(*arguments))
    for place in range(len(angles)):
        company = angles + 1.0
        company[place] = angles[place]
        found = function(company, *others)[place]
        np.testing.assert_allclose(found, alone[place], rtol=1e-11, atol=1e-15)
    moved = [
        jax.tree.map(lambda leaf, k=k: leaf * (1 + 1e-3 * k), tuple(others))
        for k in range(len(angles))
    ]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *moved)
    loop = np.array([function(angles, *other)[place] for place, other in enumerate(moved)])
    assert not np.allclose(loop, alone, rtol=1e-6, atol=0), "the other arguments do nothing"
    batched = jax.jit(jax.vmap(function), **fast_to_compile())(angles, *batch)
    np.testing.assert_allclose(batched, loop, rtol=1e-11, atol=1e-15)


def check_derivatives(function: Function, arguments: Arguments) -> None:
    """Forward mode, reverse mode and Richardson's central difference agree in eight digits."""
    arguments = as_arrays(arguments)
    draw = np.random.default_rng(0)
    leaves, tree = jax.tree.flatten(arguments)
    direction = [
        jnp.asarray(_step(leaf) * draw.normal(size=leaf.shape)).astype(leaf.dtype)
        for leaf in leaves
    ]
    weights = jnp.asarray(draw.normal(size=arguments[0].shape))
    _, forward, backward = _modes(function)(arguments, jax.tree.unflatten(tree, direction), weights)
    through = sum(
        jnp.sum(jnp.real(gradient * d))
        for gradient, d in zip(jax.tree.leaves(backward), direction, strict=True)
    )

    def difference(step):
        ends = [
            [x + way * step * d for x, d in zip(leaves, direction, strict=True)] for way in (1, -1)
        ]
        above, below = (function(*jax.tree.unflatten(tree, end)) for end in ends)
        return (above - below) / (2 * step)

    fine, coarse = difference(1e-3), difference(2e-3)
    size = float(jnp.max(jnp.abs(forward)))
    assert size > 0
    np.testing.assert_allclose(forward, (4 * fine - coarse) / 3, rtol=0, atol=1e-8 * size)
    np.testing.assert_allclose(through, jnp.sum(weights * forward), rtol=0, atol=1e-11 * size)


def check_finite_gradient(function: Function, arguments: Arguments) -> None:
    """At a kink the value and every entry of the gradient, in both modes, stay finite."""
    arguments = as_arrays(arguments)
    ones = jax.tree.map(jnp.ones_like, arguments)
    for leaf in jax.tree.leaves(_modes(function)(arguments, ones, ones[0])):
        assert np.all(np.isfinite(leaf))


def check_one_trace(function: Function, arguments: Arguments) -> None:
    """New values of any number, as arrays or as plain Python numbers, compile nothing."""
    _, *others = arguments
    function(*arguments)
    function(0.25, *others)
    with compilations() as seen:
        for factor in (1.01, 1.02):
            first, *moved = jax.tree.map(
                lambda leaf, factor=factor: np.asarray(leaf * factor), arguments
            )
            function(first, *moved)
            function(0.25 * factor, *moved)
    assert not seen, f"compiled again for new values: {seen}"


def check_dimensions(
    function: Function, arguments: Arguments, power: int, scale: Callable[[Any, float], Any]
) -> None:
    """All lengths times λ multiply the result by λ**power; `scale` does the former."""
    before = np.asarray(function(*arguments))
    for factor in (0.3, 7.0):
        after = function(*scale(arguments, factor))
        np.testing.assert_allclose(after, before * factor**power, rtol=1e-9, atol=1e-15)
    assert np.any(np.abs(before) > 1e-9)


@contextmanager
def compilations() -> Iterator[list[str]]:
    """Collect the names of everything XLA compiles inside the block."""
    seen: list[str] = []

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.getMessage().startswith("Compiling"):
                seen.append(record.getMessage().split(" with ")[0])

    handler, logger = Handler(), logging.getLogger("jax")
    propagate = logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    try:
        with jax.log_compiles(True):
            yield seen
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate


def _step(leaf: Any) -> float:
    """Length of a move for the central difference: a percent of the largest number."""
    return 1e-2 * max(float(jnp.max(jnp.abs(leaf), initial=0.0)), 0.1)


def _single(jaxpr: Any) -> bool:
    """Whether anything but a conversion works on float32, inner functions included."""
    for equation in jaxpr.eqns:
        inner = [p for v in equation.params.values() for p in jax.tree.leaves(v, is_leaf=_nested)]
        if any(_single(getattr(p, "jaxpr", p)) for p in inner if _nested(p)):
            return True
        kinds = {getattr(v.aval, "dtype", None) for v in equation.outvars}
        if np.dtype(np.float32) in kinds and not any(_nested(p) for p in inner):
            return True
    return False


def _nested(value: Any) -> bool:
    return hasattr(value, "eqns") or hasattr(value, "jaxpr")
