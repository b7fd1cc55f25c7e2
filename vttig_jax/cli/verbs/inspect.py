"""`vttig inspect`: report the content of a log and its faults. It does not import JAX."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from ...base.errors import InputError, UsageError
from ...logs.readers.column_names import ROLES
from ...logs.readers.open_table import with_standard_input
from ..drive_options import GROUPS, Drive
from ..options import Argument, given, need, refuse_out, takes_no, verb
from ..output import Output
from .plot import PICTURES, write_picture

if TYPE_CHECKING:
    from ...logs.inspection import Inspection
    from ...logs.preview import Preview


@verb(
    "inspect",
    compiles=False,
    example="vttig inspect log.csv\n"
    "vttig inspect log.csv --ratio 64:23\n"
    "vttig inspect log.csv --pair pair.toml\n"
    "vttig inspect log.csv --column time=t_s --column driving=motor_deg\n"
    "vttig inspect axis.comp --for linuxcnc",
    groups=GROUPS,
)
def command(
    output: Output,
    *,
    log: Annotated[Path, Argument()],
    control: Annotated[
        str | None,
        "--for",
        click.Choice(["linuxcnc"]),
        "LOG is no log but an error table: say what LinuxCNC reads of this COMP_FILE, and what it"
        " leaves out without a word.",
    ],
    picture: Annotated[
        Path | None,
        "Draw the transmission error before any fit, and its spectrum, in this .png, .svg or .pdf"
        " file.",
    ],
    overwrite: Annotated[bool, "Replace a picture that exists."],
    drive: Drive,
) -> None:
    """Say what LOG holds: columns, rate, turns, ratio, flanks, speeds and orders.

    LOG may be - for stdin. The command to fit it is printed at the end, with all that was
    recognised; one for each reading if no name says which column is which shaft.
    """
    from ...logs.preview import preview_log
    from ...logs.recognition.request import fit_command

    (log,) = with_standard_input([log])
    if control is not None:
        takes_no("--for", "picture", *(name for names in GROUPS.values() for name in names))
        output.emit(*_comp_file(log))
        return
    need("picture", "overwrite")
    pair, request, reading = drive.pair, drive.request, drive.reading
    report: Preview | Inspection
    if pair is None and not request.names_a_drive:
        for name in given(("write_pair", "picture")):
            raise UsageError(f"{name} needs the ratio; give --ratio 64:23 or --teeth 45/80.")
        report = preview_log(log, request=request, reading=reading)
        output.emit(report.to_json(), report)
        return
    from ...logs.inspection import inspect_log
    from ...logs.read import read_log
    from ...runs.stated_drive import stated_spec

    if picture is not None:
        refuse_out(picture, *PICTURES, overwrite=overwrite, option="--picture")
    spec, opened = stated_spec((log,), pair, request, reading)
    guesses = [guess for one in opened for guess in one.roles.guesses]
    if drive.only_explains(output, (log,), spec, guesses):
        return
    found = opened[0].log if opened else read_log(log, spec, **reading.keywords())
    report = inspect_log(found, spec)
    # Otherwise a fit would refuse the log; the notes name the remedies.
    if pair is None and report.ratio.verdict not in ("swapped", "swapped_sign", "differs"):
        if report.ratio.verdict == "sign":
            request = request.with_driven_inverted()
        names = {role: name for role in ROLES if (name := getattr(spec.log, role)) is not None}
        report = replace(report, fit_command=fit_command(log, request, names, reading))
    if picture is not None:
        from ...plotting.residual import plot_log

        write_picture(plot_log(found), picture, overwrite=overwrite)
    output.emit(report.to_json(), str(report) + f"\n\npicture: {picture}" * (picture is not None))


def _comp_file(path: Path) -> tuple[dict[str, Any], str]:
    """Return what LinuxCNC reads of a file, as `vttig.comp-file/1` and as a sentence.

    **Raises** `InputError` that says each fault of the file.
    """
    from ...base.files.limits import kept_bytes, read_regular
    from ...control.compensation.table_formats import read_linuxcnc

    found = read_linuxcnc((kept_bytes(path) or read_regular(path)).decode("utf-8", "replace"))
    if found.faults:
        raise InputError(" ".join(found.sentences), where=str(path))
    rows, kind = found.rows, found.type
    record = {"schema": "vttig.comp-file/1", "source": str(path), "comp_file_type": kind}
    record |= {"rows": len(rows), "positions": rows[[0, -1], 0].tolist()}
    record["largest"] = abs(rows[:, 1:] - (not kind) * rows[:, :1]).max().item()
    said = f"{path}: {len(rows)} rows of {'corrections' if kind else 'positions'} from"
    said += f" {rows[0, 0]:g} to {rows[-1, 0]:g}, which move the axis by {record['largest']:.4g} at"
    return record, f"{said} most; LinuxCNC reads all of them with COMP_FILE_TYPE = {kind}"
