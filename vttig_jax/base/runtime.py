"""Settings of the process: double precision and compiler options of XLA."""

import os

import jax


def enable_x64() -> None:
    """Switch JAX to 64-bit floats for this process.

    float32 cannot represent angles of thousands of degrees at arcsecond resolution, so `fit` and
    all kinematics of logs need 64-bit floats. The library never calls this function itself.

    **Example**
    ```python
    >>> import jax.numpy as jnp, vttig_jax
    >>> vttig_jax.enable_x64()
    >>> jnp.asarray(1.0).dtype
    dtype('float64')

    ```
    """
    jax.config.update("jax_enable_x64", True)


def require_x64(caller: str) -> None:
    """Raise `ValueError` with advice if 64-bit floats are off; `caller` names a public function."""
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            f"`{caller}` needs 64-bit floats, but JAX is in 32-bit mode: call"
            " `vttig_jax.enable_x64()` once, before any other JAX code."
        )


_FLAG = "--xla_backend_extra_options="
_OPTIONS = (
    "xla_cpu_use_multi_output_fusion",
    "xla_cpu_small_while_loop_byte_threshold=1000000000",
)
"""Options of XLA: results that share operands are computed in one loop, and a `lax.scan` of up to
1e9 bytes becomes one function."""


def prepare_cpu(devices: int = 1) -> None:
    """Let XLA use several cores for sweeps, and compile long loops as one function.

    Sets `jax_num_cpu_devices` and two options that the CPU compiler of XLA does not use by default:
    results that share operands are computed in one loop, and a `lax.scan` becomes one function
    instead of a call for each of its kernels. The options halve the time of a simulated step, and
    reduce it far more when traces of many runs are kept. They apply to the whole process and must
    be set before JAX runs anything. Backend options that `XLA_FLAGS` already contains are kept.

    **Arguments**
    - `devices`: number of cores; each becomes a device that `sweep` uses.

    **Raises** `ValueError` for less than one device and if JAX has already run.

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
    if _FLAG not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_FLAG}{','.join(_OPTIONS)}".strip()
