"""Rows of a report on the noise of a fit."""

from ...base.units import REV
from .noise_model import NoiseModel


def noise_rows(noise: NoiseModel, log_s: float) -> list[tuple[str, str]]:
    """Return the report rows (label, text) of the noise of a log that lasts `log_s` seconds.

    If each speed has its own noise model, there is one row for each speed.
    """
    if noise.plateaus:
        return [
            (f"noise at {speed * 60 / REV:.4g} rpm", _one_noise(own, log_s))
            for speed, own in noise.plateaus
        ]
    return [("noise", _one_noise(noise, log_s))]


def _one_noise(noise: NoiseModel, log_s: float) -> str:
    if noise.is_rounding:
        return "none: what is left is below a millionth of the transmission error"
    model, blocks = noise.name, f"blocks of {duration_text(noise.block_s)}"
    if order := len(noise.coefficients):
        several = "one" if order == 1 else str(order)
        model, blocks = blocks, f"each follows the {several} before it ({model})"
    if noise.choice.stationary_in == "angle":
        model += ", stationary in angle"
    memory = f", {_memory(noise, log_s)}" if noise.kind.has_memory else ""
    if noise.by == "moments":
        memory += "; from moments, because the model leaves slow structure in the residual"
    return f"{model}, {blocks}{memory}"


def _memory(noise: NoiseModel, log_s: float) -> str:
    if noise.correlation_s < noise.block_s:
        return "correlated over less than a block"
    if noise.correlation_s > log_s:
        return f"correlated over longer than the log ({duration_text(log_s)})"
    return f"correlation time {duration_text(noise.correlation_s)}"


def duration_text(seconds: float) -> str:
    """Return a duration in s or ms."""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"
