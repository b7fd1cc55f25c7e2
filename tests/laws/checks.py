"""What every public function must keep, as checks that raise AssertionError where it does not.

A function under test takes arrays or pytrees of arrays, the first of them one-dimensional, and works
element by element on the first.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

Function = Callable[..., Any]
Arguments = tuple[Any, ...]


def as_arrays(tree: Any) -> Any:
    """Make every number of a pytree a JAX array, so that all of them can be moved."""
    return jax.tree.map(jnp.asarray, tree)


def check_double(function: Function, arguments: Arguments) -> None:
    assert function(*arguments).dtype == np.float64
    narrow = jnp.asarray(arguments[0], jnp.float32)
    assert function(narrow, *arguments[1:]).dtype == np.float64
    assert np.allclose(
        function(narrow, *arguments[1:]),
        function(jnp.asarray(narrow, jnp.float64), *arguments[1:]),
        rtol=1e-13,
        atol=1e-17,
    )


def check_jit_is_eager(function: Function, arguments: Arguments) -> None:
    compiled = eqx.filter_jit(function)(*arguments)
    with jax.disable_jit():
        eager = function(*arguments)
    np.testing.assert_allclose(compiled, eager, rtol=1e-11, atol=1e-15)


def check_vmap_is_loop(function: Function, arguments: Arguments) -> None:
    """The whole array, `vmap` over all arguments moved together, and a loop agree."""
    angles, *others = arguments
    alone = np.array([function(angle, *others) for angle in angles])
    np.testing.assert_allclose(function(*arguments), alone, rtol=1e-11, atol=1e-15)
    moved = [
        jax.tree.map(lambda leaf, k=k: leaf * (1 + 1e-3 * k), tuple(others))
        for k in range(len(angles))
    ]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *moved)
    loop = np.array([function(angle, *other) for angle, other in zip(angles, moved, strict=True)])
    assert not np.allclose(loop, alone, rtol=1e-6, atol=0) or not others
    np.testing.assert_allclose(jax.vmap(function)(angles, *batch), loop, rtol=1e-11, atol=1e-15)


def check_derivatives(function: Function, arguments: Arguments) -> None:
    """Forward mode, reverse mode and Richardson's central difference agree in eight digits."""
    arguments = as_arrays(arguments)
    draw = np.random.default_rng(0)
    leaves, tree = jax.tree.flatten(arguments)
    direction = [jnp.asarray(_scale(leaf) * draw.normal(size=leaf.shape)) for leaf in leaves]
    direction = [d.astype(leaf.dtype) for d, leaf in zip(direction, leaves, strict=True)]
    compiled = jax.jit(function)

    @jax.jit
    def both(arguments, direction, weights):
        value, forward = jax.jvp(function, arguments, direction)
        backward = jax.vjp(function, *arguments)[1](jnp.broadcast_to(weights, value.shape))
        return forward, backward

    weights = jnp.asarray(draw.normal(size=arguments[0].shape))
    forward, backward = both(arguments, jax.tree.unflatten(tree, direction), weights)
    through = sum(
        jnp.sum(jnp.real(gradient * d))
        for gradient, d in zip(jax.tree.leaves(backward), direction, strict=True)
    )

    def difference(step):
        ends = [
            compiled(
                *jax.tree.unflatten(
                    tree, [x + way * step * d for x, d in zip(leaves, direction, strict=True)]
                )
            )
            for way in (1, -1)
        ]
        return (ends[0] - ends[1]) / (2 * step)

    fine, coarse = difference(1e-3), difference(2e-3)
    central = (4 * fine - coarse) / 3
    size = float(jnp.max(jnp.abs(forward)))
    assert size > 0
    np.testing.assert_allclose(forward, central, rtol=0, atol=1e-8 * size)
    np.testing.assert_allclose(through, jnp.sum(weights * forward), rtol=1e-9, atol=1e-12 * size)


def check_finite_gradient(function: Function, arguments: Arguments) -> None:
    """At a kink the value and every entry of the gradient, in both modes, stay finite."""
    arguments = as_arrays(arguments)

    @jax.jit
    def modes(arguments):
        value, pull = jax.vjp(function, *arguments)
        ones = jax.tree.map(jnp.ones_like, arguments)
        return value, pull(jnp.ones_like(value)), jax.jvp(function, arguments, ones)[1]

    for leaf in jax.tree.leaves(modes(arguments)):
        assert np.all(np.isfinite(leaf))


def check_one_trace(function: Function, arguments: Arguments) -> None:
    """New values of any number, as arrays or as plain Python numbers, compile nothing."""
    function(*arguments)
    function(0.25, *arguments[1:])
    with compilations() as seen:
        for factor in (1.01, 1.02):
            moved = jax.tree.map(lambda leaf, factor=factor: leaf * factor, arguments)
            function(*jax.tree.map(_like_before, moved, arguments))
            function(0.25 * factor, *jax.tree.map(_like_before, moved, arguments)[1:])
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


def _scale(leaf: Any) -> float:
    """A step for the central difference: a percent of the number, never less than 1e-3."""
    return 1e-2 * max(float(jnp.max(jnp.abs(leaf))), 0.1) if leaf.size else 0.0


def _like_before(new: Any, old: Any) -> Any:
    return np.asarray(new) if isinstance(old, np.ndarray) else jnp.asarray(new)
