"""Conversion of encoder readings to the angles of a fit; a run folder stores the zeros for it."""

from typing import TYPE_CHECKING

from ..base.errors import InputError, NoAnswerError
from ..base.files.run_folder import data_sha256
from ..logs.readers.column_names import name_and_unit, units_of
from ..logs.recognition.request import SHAFTS, Statement
from ..pair.gear_pair import ShaftReading, shaft_reading
from ..pair.schema import as_fraction
from .run_file import RunRecord

if TYPE_CHECKING:
    from ..identify.result import Fit


def shaft_readings(run: RunRecord, fit: "Fit") -> tuple[ShaftReading, ShaftReading]:
    """Return the conversions from readings of both encoders to the angles φ₁ and φ₂ of a fit.

    If the fit counts its angles from the encoder reading zero, the angle is the reading times a
    sign and a scale. If it counts from the first sample of the log, the reading of that sample is
    subtracted first.

    **Raises** `NoAnswerError` for a log with a transmission error in place of the driven channel,
    and `InputError` if the unit of the first reading is unknown.
    """
    if fit.zero_readings["driven"] is None:
        raise NoAnswerError(
            "its log holds a transmission error in place of the driven channel, so that no reading"
            " of a driven encoder belongs to this fit; fit a log of both encoders.",
            where=fit.source,
        )
    statement = Statement.of(run.spec, run.options.reading)
    found = []
    for shaft, encoder in zip(SHAFTS, statement.encoders, strict=True):
        scale = as_fraction(getattr(run.spec.log, f"{shaft}_scale"), f"log.{shaft}_scale")
        first, zero = fit.zero_readings[shaft], 0.0
        if fit.zero != "reading" and first:
            radians = statement.radians(shaft, _unit(run, fit, statement, shaft))
            assert radians is not None  # ensured by the reader of the log
            zero = first * radians
        found.append(shaft_reading(encoder, zero, scale.numerator / scale.denominator))
    driving, driven = found
    return driving, driven


def _unit(run: RunRecord, fit: "Fit", statement: Statement, shaft: str) -> str:
    """Return the unit of the reading of `shaft` in the first sample.

    It is "counts" if the reading is an integer. Otherwise it comes from the column name, the pair
    file or the log, in this order.
    """
    if isinstance(fit.zero_readings[shaft], int):
        return "counts"
    name = getattr(statement.layout, shaft)
    written = name_and_unit(name, units_of(shaft), str(name))[1] if name else None
    if unit := written or getattr(statement.unit, shaft):
        return unit
    from ..logs.read import read_log

    log = run.logs[0]
    if not log.is_file() or data_sha256([log])[0] != run.sha256[0]:
        raise InputError(
            f"the angles of this fit count from the first sample, where the {shaft} encoder read"
            f" {fit.zero_readings[shaft]:g}, but in which unit only the log says, and that is gone"
            f" or has changed; put it back, or name the column with its unit in [log] of the pair"
            " file and fit again.",
            where=str(log),
        )
    return getattr(read_log(log, run.spec, **run.options.reading.keywords()), shaft).unit
