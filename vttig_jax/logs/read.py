"""Reading of a log file into an `EncoderLog`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ..base.errors import UsageError
from ..base.logger import LOGGER
from ..pair.schema import PairSpec
from .encoder_log import EncoderLog
from .readers.open_table import open_table
from .readers.table import Table
from .recognition.answers import all_questions, in_one
from .recognition.assign import Roles, assign
from .recognition.request import (
    DriveRequest,
    ReadingOptions,
    Statement,
    TwoShafts,
    counts_of,
    fit_command,
    roles_of,
    units_of_options,
)


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
    start: str | float | None = None,
    stop: str | float | None = None,
    cut: str | Sequence[str] = (),
    missing: str | None = None,
    lead_mm: int | float | None = None,
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
      "torque", "speed" and "acceleration" of the driving shaft) → column name, or a formula of
      columns such as "0.5*(m1+m2)" with +, -, * and brackets. This argument and those that follow
      override `pair.log`.
    - `decimal`: decimal mark, "." or ",".
    - `sample_rate_hz`: sampling rate in Hz if there is no time column.
    - `start`, `stop`: first and last time in s since the first sample, or turns of the driving
      shaft since then, such as "3rev". `cut`: parts that are left out, such as "18:21".
    - `missing`: "skip" leaves out the rows in which a column that is used has no number.
    - `lead_mm`: travel in one turn of a shaft that is logged in mm or µm; 2π r for lengths that a
      dial gauge showed at the radius r in mm.

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
    units = {"": unit} if isinstance(unit, str) else unit or {}
    request = DriveRequest(
        ratio=None if ratio is None else str(ratio),
        teeth=teeth,
        counts=counts if counts is None or isinstance(counts, tuple) else counts_of(str(counts)),
        units=units_of_options(f"{role}={one}" if role else one for role, one in units.items()),
        inverted=(invert,) if isinstance(invert, str) else tuple(invert),
        driving_rpm=None if driving_rpm is None else str(driving_rpm),
    )
    if pair is not None and request.states_something:
        raise UsageError(
            "a pair is given, which states ratio, encoders and units; leave out the other keywords"
            " or the pair.",
            where=str(path),
        )
    if pair is None and not request.names_a_drive:
        raise UsageError(
            "the ratio of the drive is missing; give a pair file, or the ratio as driving turns to"
            ' driven turns, such as "64:23".',
            where=str(path),
        )
    text = {"decimal": decimal, "missing": missing}
    numbers = {"start": start, "stop": stop, "lead_mm": lead_mm}
    reading = ReadingOptions.of(columns, sample_rate_hz, cut, **text, **numbers)
    opened = open_log(path, request if pair is None else pair, reading)
    log, guesses = opened.log, tuple(guess.fact for guess in opened.roles.guesses)
    log = replace(log, spec=opened.roles.spec, notes=(*guesses, *log.notes))
    LOGGER.info("%s: %d samples", path, len(log))
    for note in log.notes:
        LOGGER.info("%s: %s", path, note)
    return log


@dataclass(frozen=True)
class OpenLog:
    """Log whose table is open, with the roles of its columns; its values are not checked yet.

    - `reading`: options for reading.
    """

    path: Path
    table: Table
    roles: Roles
    reading: ReadingOptions

    @property
    def spec(self) -> PairSpec:
        """Content of the pair file that says the same as the options and the columns."""
        assert self.roles.spec is not None  # a pair file was given, and has this content
        return self.roles.spec

    @cached_property
    def log(self) -> EncoderLog:
        """The log with validated values; the table is then closed."""
        log = EncoderLog.of(self.table, self.roles)
        return replace(log, keywords=self.reading.keywords(), path=self.path.resolve())


def open_log(
    path: str | Path, drive: DriveRequest | TwoShafts, reading: ReadingOptions = ReadingOptions()
) -> OpenLog:
    """Open a log, and find the columns by the options of a user or by a pair file.

    **Raises** `LogError` or `UsageError` if the log can be read in two ways; the message names the
    option that decides.
    """
    if isinstance(drive, DriveRequest):
        statement = drive.statement(reading)
    else:
        statement = Statement.of(drive, reading)
    table = open_table(path, statement.layout)
    roles = assign(table, statement)
    if roles.questions:
        questions, command = list(roles.questions), ""
        if isinstance(drive, DriveRequest):
            questions, options = all_questions(path, roles, drive, reading)
            if options:
                columns = roles_of(reading.columns)
                command = fit_command(path, drive, columns, reading, options)
        raise in_one(questions, command, str(path))
    return OpenLog(Path(path), table, roles, reading)
