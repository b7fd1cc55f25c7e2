"""The `vttig fit` command that states all options and columns with which a log was read."""

import shlex
from collections.abc import Mapping
from pathlib import Path

from ...base.files.standard_input import STDIN, kept_bytes
from .request import SHAFTS, DriveRequest


def fit_command(
    path: str | Path,
    request: DriveRequest,
    columns: Mapping[str, str],
    *,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> str:
    """Return a command that the user can copy and that names every column.

    `path` is the log, and `columns` is role → name of its column.

    **Example**
    ```python
    >>> from vttig_jax.logs.recognition.command import fit_command
    >>> from vttig_jax.logs.recognition.request import DriveRequest
    >>> print(fit_command("log.csv", DriveRequest(ratio="16:9"), {"driving": "motor angle"}))
    vttig fit log.csv --ratio 16:9 --column 'driving=motor angle'

    ```
    """
    words = ["vttig", "fit", _argument(path)]
    if request.ratio is not None:
        words += ["--ratio", request.ratio]
    if request.teeth is not None:
        words += ["--teeth", request.teeth]
    if request.counts is not None:
        words += ["--counts", ",".join(map(str, request.counts))]
    for role, unit in request.units.items():
        words += ["--unit", f"{role}={unit}"]
    for shaft in request.inverted:
        words += ["--invert", shaft]
    if request.driving_rpm is not None:
        words += ["--driving-rpm", request.driving_rpm]
    for shaft in SHAFTS:
        if (scale := getattr(request, f"{shaft}_scale")) is not None:
            words += [f"--{shaft}-scale", scale]
    for role, name in columns.items():
        words += ["--column", f"{role}={name}"]
    if decimal is not None:
        words += ["--decimal", decimal]
    if sample_rate_hz is not None:
        words += ["--sample-rate", f"{sample_rate_hz:.12g}"]
    return shlex.join(words)


def _argument(path: str | Path) -> str:
    """Return a path as text that is not taken for an option: `./-x.csv` for `-x.csv`.

    Standard input is `-`.
    """
    if kept_bytes(path) is not None:
        return str(STDIN)
    return f"./{path}" if str(path).startswith("-") else str(path)
