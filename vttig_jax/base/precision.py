"""Double precision: switched on by the caller, asked for by whoever needs it."""

import jax


def enable_x64() -> None:
    """Switch JAX to 64-bit floats for this process.

    Angles over thousands of degrees at arcsecond resolution do not fit float32, so `fit` and all
    kinematics of logs need this. The library never calls it by itself.

    **Example**
    ```python
    >>> import jax.numpy as jnp, vttig_jax
    >>> vttig_jax.enable_x64()
    >>> jnp.asarray(1.0).dtype
    dtype('float64')

    ```
    """
    jax.config.update("jax_enable_x64", True)


def require_x64(who: str) -> None:
    """Raise `ValueError` with the cure when 64-bit floats are off; `who` is the public function."""
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            f"`{who}` needs 64-bit floats, but JAX is in 32-bit mode: call"
            " `vttig_jax.enable_x64()` once, before any other JAX code."
        )
