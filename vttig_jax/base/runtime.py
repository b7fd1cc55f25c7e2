"""Settings of the process: double precision, and how XLA uses the processor."""

import os

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


_EXTRA = "--xla_backend_extra_options="
_OPTIONS = (
    "xla_cpu_use_multi_output_fusion",
    "xla_cpu_small_while_loop_byte_threshold=1000000000",
)
"""Results that share operands in one loop; a whole `lax.scan` as one compiled function."""


def prepare_cpu(devices: int = 1) -> None:
    """Let XLA use several cores for sweeps, and compile long loops as a whole.

    Sets `jax_num_cpu_devices` and two options of XLA that its CPU compiler leaves off by default:
    results that share operands are computed in one loop, and a `lax.scan` becomes one function
    instead of a call for each of its kernels. A simulated step takes half of the time with them,
    keeping traces of many runs at once far more. They hold for the process and only before JAX has
    run anything. Options that are in `XLA_FLAGS` already are kept.

    **Arguments**
    - `devices`: cores, each of which becomes a device that `sweep` uses.

    **Raises** `ValueError` for less than one device and where JAX has run already.

    Call it as `vttig_jax.prepare_cpu(devices=2)` right after `import vttig_jax`.
    """
    if devices < 1:
        raise ValueError(f"Argument `devices` must be at least 1, but is {devices}.")
    try:
        jax.config.update("jax_num_cpu_devices", devices)
    except RuntimeError:
        raise ValueError(
            "`prepare_cpu` must be called before JAX runs anything, but it has; call it right after"
            " `import vttig_jax`."
        ) from None
    flags = os.environ.get("XLA_FLAGS", "")
    if _EXTRA not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_EXTRA}{','.join(_OPTIONS)}".strip()
