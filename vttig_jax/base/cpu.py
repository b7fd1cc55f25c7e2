"""How XLA is to use the CPU: its cores as devices, and fewer passes over memory."""

import os

import jax

_SHARED_WORK = "xla_cpu_use_multi_output_fusion"
_EXTRA = "--xla_backend_extra_options="


def prepare_cpu(devices: int = 1) -> None:
    """Let XLA use several cores for sweeps, and compute once what several results share.

    Sets `jax_num_cpu_devices` and an option of XLA that its CPU compiler leaves off by default:
    results that share operands are computed in one loop. A simulated step takes a third of the time
    with it. Both hold for the process and only before JAX has run anything. Options that are in
    `XLA_FLAGS` already are kept.

    **Arguments**
    - `devices`: cores, each of which becomes a device that `sweep` uses.

    **Raises** `ValueError` for less than one device and where JAX has run already.

    **Example**
    ```python
    import vttig_jax
    vttig_jax.prepare_cpu(devices=2)
    vttig_jax.enable_x64()
    ```
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
        os.environ["XLA_FLAGS"] = f"{flags} {_EXTRA}{_SHARED_WORK}".strip()


def shares_work() -> bool:
    """Whether XLA was told to compute once what several results share."""
    return _SHARED_WORK in os.environ.get("XLA_FLAGS", "")
