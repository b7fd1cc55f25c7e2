"""`vttig inspect`: report the content of a log and its faults. It does not import JAX."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...base.errors import UsageError
from ...logs.readers.column_names import ROLES
from ...logs.readers.open_table import with_standard_input
from ..drive_options import GROUPS, DriveOptions, drive_options
from ..options import log_options, verb
from ..output import Output

if TYPE_CHECKING:
    from ...logs.inspection import Inspection
    from ...logs.preview import Preview
    from ...logs.recognition.request import ReadingOptions


@verb(
    "inspect",
    compiles=False,
    example="vttig inspect log.csv\n"
    "vttig inspect log.csv --ratio 64:23\n"
    "vttig inspect log.csv --pair pair.toml\n"
    "vttig inspect log.csv --column time=t_s --column driving=motor_deg",
    groups=GROUPS,
)
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--pair",
    type=click.Path(path_type=Path),
    help="TOML of the pair or drive; without it only what the columns show by themselves.",
)
@drive_options
@log_options
def command(
    output: Output,
    log: Path,
    pair: Path | None,
    drive: DriveOptions,
    **options: Any,
) -> None:
    """Say what LOG holds: columns, rate, turns, ratio, flanks, speeds and orders.

    LOG may be - for stdin. The command to fit it is printed at the end, with all that was
    recognised; one for each reading if no name says which column is which shaft.
    """
    from ...logs.preview import preview_log
    from ...logs.recognition.request import ReadingOptions

    (log,) = with_standard_input([log])
    reading = ReadingOptions(**options)
    report: Preview | Inspection
    if pair is None and not drive.request.names_a_drive:
        if drive.write_pair is not None:
            raise UsageError("--write-pair needs the ratio; give --ratio 64:23 or --teeth 45/80.")
        report = preview_log(log, request=drive.request, reading=reading)
    else:
        report = _inspected(log, pair, reading, drive, output)
    output.emit(report.to_json(), report)


def _inspected(
    log: Path, pair: Path | None, reading: "ReadingOptions", drive: DriveOptions, output: Output
) -> "Inspection | Preview":
    """Return the report on a log whose ratio is known."""
    from ...logs.inspection import inspect_log
    from ...logs.preview import preview_log
    from ...logs.read import read_log
    from ...logs.recognition.request import fit_command
    from ...runs.stated_drive import stated_spec

    spec, opened = stated_spec((log,), pair, drive.request, reading)
    guesses = [guess for one in opened for guess in one.roles.guesses]
    drive.tell(() if drive.explain_columns else guesses, spec, output)
    if drive.explain_columns:
        first = preview_log(log, spec=spec, reading=reading)
        return replace(first, notes=(*map(str, guesses), *first.notes))
    found = opened[0].log if opened else read_log(log, spec, **reading.keywords())
    report = inspect_log(found, spec)
    if pair is not None or report.ratio.verdict in ("swapped", "swapped_sign", "differs"):
        return report  # a fit would refuse the log; the notes name the remedies
    request = drive.request
    if report.ratio.verdict == "sign":
        request = request.with_driven_inverted()
    names = {role: name for role in ROLES if (name := getattr(spec.log, role)) is not None}
    return replace(report, fit_command=fit_command(log, request, names, reading))
