"""Reading of a log file into an `EncoderLog`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import UsageError
from ..base.logger import LOGGER
from .encoder_log import EncoderLog
from .protocols import TwoShafts
from .raw import read_raw
from .readers.column_roles import ROLES
from .recognition.recognise import Recognition, recognise
from .recognition.request import DriveRequest, counts_of, units_of_options


def read_log(
    path: str | Path,
    pair: TwoShafts | None = None,
    *,
    ratio: str | int | float | None = None,
    teeth: str | None = None,
    counts: int | tuple[int, int] | str | None = None,
    unit: str | Mapping[str, str] | None = None,
    invert: str | Sequence[str] = (),
    driving_rpm: str | int | float | None = None,
    columns: Mapping[str, str] | None = None,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> EncoderLog:
    """Read a log of two encoders, or of one encoder and the transmission error.

    The file is delimited text (CSV, TSV, TXT, and the layouts of some recording programs), MATLAB,
    HDF5, NumPy, Parquet, Feather, Arrow, TDMS, MDF or a ROS bag. Columns of
    nested files have paths as names, and the last part is enough: `rec.pos_deg(1,:)` or
    `pos_deg(1,:)`. In text `#1` is the first column; in all files `#row` is 0, 1, 2, ….

    **Arguments**
    - `pair`: pair file, or result of `load_pair`: encoders, ratio, and in `log` and `unit` the
      names and units of the columns. Without it `ratio` or `teeth` is needed; the columns are then
      recognised from their names and the ratio, and `log.spec` is the equivalent pair file. If they
      are not unique, the error asks for the missing information.
    - `ratio`: "64:23", driving turns to driven turns; "9/16" or a number is driven over driving
      speed.
    - `teeth`: "45/80", teeth of the driving and of the driven gear.
    - `counts`: counts per revolution of both encoders, one number if they are equal.
    - `unit`: unit of the shaft columns whose names contain no unit, or role → unit.
    - `invert`: "driving", "driven" or both, whose encoder counts backwards.
    - `driving_rpm`: speed in rpm of a driving shaft that turns at constant speed and has no
      encoder; "sidereal" for the worm of a telescope mount, whose driven shaft follows the stars.
    - `columns`: role ("time", "driving", "driven", "transmission_error", "direction", "axial_mm",
      "torque", "speed" and "acceleration" of the driving shaft) → column name. This argument and
      the next two override `pair.log`.
    - `decimal`: decimal mark, "." or ",".
    - `sample_rate_hz`: sampling rate in Hz if there is no time column.

    **Raises** `LogError` naming the file, line or channel and the cure; `UsageError` for HDF5
    without the package h5py.

    **Example**
    ```python
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from vttig_jax.logs import read_log
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "log.csv"
    ...     _ = path.write_text("".join(f"{8 * k}.0,{4 * k}.0\\n" for k in range(9)))
    ...     log = read_log(path, ratio="2:1", unit="deg", sample_rate_hz=50)
    >>> len(log), round(float(log.time[-1]), 2), log.spec.log.driving
    (9, 0.16, '#1')

    ```
    """
    request = _request(ratio, teeth, counts, unit, (invert, driving_rpm))
    found: Recognition | None = None
    if pair is None:
        found = recognise(
            path,
            request,
            columns=columns or {},
            decimal=decimal,
            sample_rate_hz=sample_rate_hz,
        )
        pair = found.spec
    elif request.states_something:
        raise UsageError(
            "a pair is given, which states ratio, encoders and units; leave out the other keywords"
            " or the pair.",
            where=str(path),
        )
    check_arguments(columns or {}, decimal, sample_rate_hz)
    raw = read_raw(
        path, pair, columns=columns or {}, decimal=decimal, sample_rate_hz=sample_rate_hz
    )
    keywords: dict[str, Any] = {"decimal": decimal, "sample_rate_hz": sample_rate_hz}
    log = EncoderLog.from_raw(raw, pair)
    del raw
    keywords["columns"] = dict(columns or {})
    log = replace(log, keywords=keywords, path=Path(path).resolve())
    if found is not None:
        told = tuple(guess.fact for guess in found.guesses)
        log = replace(log, spec=found.spec, notes=(*told, *log.notes))
    LOGGER.info("%s: %d samples", path, len(log))
    for note in log.notes:
        LOGGER.info("%s: %s", path, note)
    return log


def _request(
    ratio: str | int | float | None,
    teeth: str | None,
    counts: int | tuple[int, int] | str | None,
    unit: str | Mapping[str, str] | None,
    further: tuple[str | Sequence[str], str | float | None],
) -> DriveRequest:
    """Return the keywords of `read_log` as a request; `further` is (`invert`, `driving_rpm`)."""
    invert, driving_rpm = further
    if counts is not None and not isinstance(counts, tuple):
        counts = counts_of(str(counts))
    if isinstance(unit, Mapping):
        texts = tuple(f"{role}={name}" for role, name in unit.items())
    else:
        texts = () if unit is None else (unit,)
    return DriveRequest(
        ratio=None if ratio is None else str(ratio),
        teeth=teeth,
        counts=counts,
        units=units_of_options(texts),
        inverted=(invert,) if isinstance(invert, str) else tuple(invert),
        driving_rpm=None if driving_rpm is None else str(driving_rpm),
    )


def check_arguments(
    columns: Mapping[str, str], decimal: str | None, sample_rate_hz: int | float | None
) -> None:
    """Raise `UsageError` for invalid or contradictory keywords."""
    for role in columns:
        if role not in ROLES:
            raise UsageError(f"`{role}` is no role of a column; roles are {', '.join(ROLES)}.")
    if decimal not in (None, ".", ","):
        raise UsageError(f'decimal must be "." or ",", but is {decimal!r}.')
    if sample_rate_hz is not None and not 0 < sample_rate_hz < np.inf:
        raise UsageError(f"the sample rate must be a positive number, but is {sample_rate_hz!r}.")
    if sample_rate_hz is not None and "time" in columns:
        raise UsageError("a sample rate and a time column are both given; keep the one of the log.")
