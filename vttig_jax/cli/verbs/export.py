"""`vttig export`: backlash or transmission error for a controller, as CSV, JSON or a C header."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import click

import vttig_jax

from ...base.errors import UsageError
from ...base.files.json_io import dumps
from ...base.logger import LOGGER
from ...base.units import ARCSEC, DEG
from ...control.scenario.axes import Gap
from ...runs.map_table import QuantityName, csv_text, resolution, run_table
from ...runs.run import Run
from ...runs.run_file import CHECKPOINT
from ..axis_options import AXIS, Axis
from ..options import (
    ConstantBacklash,
    NotNegative,
    Positive,
    Real,
    RunPath,
    StepDeg,
    given,
    refuse_existing,
    refuse_out,
    require_rows,
    takes_no,
    verb,
)
from ..output import Output

if TYPE_CHECKING:
    from ...kinematics.backlash_map import BacklashMap
    from ...kinematics.flank_model import FlankModel
    from ...runs.axis_table import AxisSetting

CONTROLS = ("linuxcnc", "twincat", "beckhoff", "csv", "json", "c")
"""Formats of error tables; beckhoff is another name of twincat."""

_PLACE = (*AXIS, "over_deg")
_AXIS = (*_PLACE, "step_deg", "quantity")
_HARMONICS = ("tolerance_arcsec", "accuracy_arcsec", "gap", "constant_backlash_deg", "quantity")
_OPTIONS = {
    "a .csv file": ("step_deg", "constant_backlash_deg", "quantity"),
    "a .json file": _HARMONICS,
    "a .h file": (*_HARMONICS, "name"),
    "--quantity error": ("step_deg", "quantity"),
    "--for linuxcnc": (*_AXIS, "acceleration_deg_s2", "servo_period_ms"),
    **dict.fromkeys(("--for twincat", "--for beckhoff", "--for c"), (*_AXIS, "name")),
    **dict.fromkeys(("--for csv", "--for json"), _AXIS),
}
"""What is written → the options that are valid only for some of it and valid for this."""

_DEVIATIONS, _LEAST_DEG = 6.0, 0.1
"""Default tolerance of the readings: six times the residual rms of the fit, and at least 0.1°, the
difference between two readings that are taken 0.3 ms apart at 100 rpm."""


@verb(
    "export",
    example="""
vttig export run --out compensation.h --name axis_2
vttig export run --out compensation.json
vttig export run --out compensation.csv --step-deg 0.5
vttig export run --quantity error --out error.csv
vttig export run --for linuxcnc --out axis.comp
""",
    groups={"The axis, with --for": _PLACE},
)
def command(
    output: Output,
    *,
    run_folder: RunPath,
    out: Annotated[
        Path,
        "File to write: .csv the map as a table, .json its harmonics (of the error: the table), .h"
        " C that evaluates them. With --for any name.",
    ],
    control: Annotated[
        str | None,
        "--for",
        click.Choice(CONTROLS),
        "Write the error table of the axis for a control: what it adds to the command in each"
        " direction, in degrees at equidistant positions. LinuxCNC reads it as COMP_FILE, TwinCAT"
        " as constants of Structured Text (beckhoff is the same); c is a header with a function for"
        " each direction.",
    ],
    axis: Axis,
    over_deg: Annotated[
        tuple[Real, Real] | None,
        "--over",
        {"metavar": "FROM TO"},
        "Travel of the axis, °, if it is not that of the table: what is left is predicted for it."
        " A control holds the ends of its table.",
    ],
    acceleration_deg_s2: Annotated[
        Positive | None,
        "With --for linuxcnc: MAX_ACCELERATION; prints the largest speed that follows the table.",
    ],
    servo_period_ms: Annotated[Positive, "With --for linuxcnc: its servo period."] = 1.0,
    name: Annotated[
        str | None,
        "With .h and --for c: what all names in C begin with, with --for twincat what follows"
        " axis_; made from the name of the pair by default.",
    ],
    quantity: Annotated[
        QuantityName | None,
        "With .h: axial shift and backlash (the default), or the backlash alone. With .csv and"
        " .json: the backlash (the default), the same with the axial shift as the first column, or"
        " the transmission error of each measured flank.",
    ],
    tolerance_arcsec: Annotated[
        NotNegative | None,
        "How far readings may put the driven shaft off its flanks, its speed times the time"
        " between both readings included; by default six times the residual of the fit, 360 at"
        " least.",
    ],
    accuracy_arcsec: Annotated[
        NotNegative,
        "Backlash that the harmonics left out may add up to; more leaves fewer to evaluate. By"
        " default only those below 1e-12 rad are left out.",
    ] = 0.0,
    step_deg: Annotated[
        StepDeg | None,
        "Of a table: distance of the rows, 1 by default. With --for: distance of the positions,"
        " the 255th part of the travel by default.",
    ],
    constant_backlash_deg: ConstantBacklash,
    gap: Annotated[
        str | None,
        click.Choice(get_args(Gap)[1:]),
        "With .h and .json, after `vttig sample`: the mean gap, lowered until it is nowhere above"
        " this edge of its band. The table of `vttig map` has the edge itself as a column.",
    ],
    overwrite: Annotated[bool, "Replace a file that exists."],
) -> None:
    """Write the backlash map, or the transmission error, of the fit in RUN for a controller.

    The C header needs no other header, not even math.h. Its functions take the angle of each shaft
    within one turn and find the turn within the hunting period from both angles. They return the
    status "unknown" if both angles cannot be readings of this pair at the same time. The JSON file
    contains the same harmonics, the CSV file the table of `vttig map`. The transmission error of a
    flank (--quantity error) needs no gap: a log of one direction is enough; CSV and JSON contain
    its table.

    With --for the file is the error table of an axis: what its control adds to the command in each
    direction, so that the axis stands where it is told. What the table leaves over the travel is
    predicted and printed, and a table that leaves more than none is refused.
    """
    from ...control.compensation.c_header import HeaderOrigin, c_header, identifier_of
    from ...control.compensation.compensation import compensation_of
    from ...runs.error_table import origin
    from ...runs.maps import lowered_map
    from ...runs.run import shaft_readings

    suffix = out.suffix.lower()
    quantity = quantity or ("error" if control else "shift" if suffix == ".h" else "backlash")
    opened = Run(run_folder)
    opened.refuse_own([out])
    _check_options(out, control, suffix, quantity, overwrite=overwrite)
    step, fit = step_deg or 1.0, opened.fit
    if control is not None:
        from ...runs.axis_table import AxisSetting

        rate = acceleration_deg_s2, servo_period_ms
        setting = AxisSetting(**axis._asdict(), over_deg=over_deg)
        text, record, shown = _axis_table(opened, out, control, setting, step_deg, rate, name)
    elif quantity == "error" or suffix == ".csv":
        posterior = opened.drawn if quantity == "error" else None
        if quantity != "error":
            _maps(opened, constant_backlash_deg, quantity)
        turns = float(opened.pair.hunting_turns)
        require_rows(turns, step)
        how: Any = {"constant_backlash_deg": constant_backlash_deg, "posterior": posterior}
        found = run_table(fit, quantity, step, turns, out=out, **how)
        record, shown, text = found.record, found.text, csv_text(found.columns)
        if suffix == ".json":
            record |= {"table": found.columns}
            text = dumps(record) + "\n"
    else:
        grid, contact = _maps(opened, constant_backlash_deg, quantity)
        lowered = None
        if gap is not None:
            grid, distance = lowered_map(opened, gap)
            lowered = gap, distance / DEG
        allowed_deg = max(_DEVIATIONS * fit.residual_rms_deg, _LEAST_DEG)
        allowed = allowed_deg * DEG if tolerance_arcsec is None else tolerance_arcsec * ARCSEC
        compensation = compensation_of(
            grid, contact, allowed_rad=allowed, left_out_rad=accuracy_arcsec * ARCSEC
        )
        fitted, interval = fit.parameters["constant_backlash_deg"], None
        low, high = fitted.low95, fitted.high95
        if constant_backlash_deg is None and low is not None and high is not None:
            interval = low, high
        record: dict[str, Any] = {
            "schema": "vttig.compensation/1",
            **origin(fit),
            "file": out.name,
            "constant_backlash_deg": interval and {"low95": low, "high95": high},
            **compensation.to_json(),
        }
        shown = str(compensation)
        if lowered is not None:
            record |= {"gap": gap, "lowered_deg": lowered[1]}
        text = dumps(record) + "\n"
        if suffix == ".h":
            made_of = HeaderOrigin(
                pair=fit.pair.name,
                version=vttig_jax.__version__,
                zero=fit.zero,
                conditional_on=fit.conditional_on,
                sha256=fit.sha256,
                readings=shaft_readings(opened.record, fit),
                backlash_deg=interval,
                lowered_deg=lowered,
            )
            prefix = identifier_of(fit.pair.name) if name is None else name
            text = c_header(compensation, made_of, name=prefix, quantity=quantity)
    if gap is None and (run_folder / CHECKPOINT).exists() and quantity != "error":
        LOGGER.warning(
            "these are the values of the fit; its draws know how far they may be wrong:"
            " `vttig map %s` has bands",
            run_folder,
        )
    opened.write_beside({out: text}, overwrite=overwrite)
    rows = f": {resolution(fit, step)}" if suffix == ".csv" and control is None else ""
    output.emit(record, f"{shown}\nwritten to {out}{rows}")


def _axis_table(
    run: Run,
    out: Path,
    control: str,
    axis: "AxisSetting",
    step_deg: float | None,
    rate: tuple[float | None, float],
    name: str | None,
) -> tuple[str, dict[str, Any], str]:
    """Return the error table of the axis for a control, its record, and its report."""
    from ...control.compensation import table_formats
    from ...control.compensation.c_header import identifier_of, table_header
    from ...runs.axis_table import axis_table

    found = axis_table(run.fit, run.drawn, axis, step_deg)
    record, lines = found.to_json(out), found.provenance(vttig_jax.__version__)
    shown = str(found)
    if control == "linuxcnc":
        text = table_formats.linuxcnc(found.table, lines)
        record["ini"] = {"COMP_FILE": out.name, "COMP_FILE_TYPE": 1}
        file = table_formats.plain(out.name)
        shown += (
            f"\nin the INI file, section [JOINT_n]:\n  COMP_FILE = {file}\n  COMP_FILE_TYPE = 1"
        )
        if rate[0] is not None:
            record["fastest_deg_s"] = found.fastest_deg_s(rate[0], 1e-3 * rate[1])
            shown += f"\nfollowed exactly up to {record['fastest_deg_s']:.4g}°/s"
    elif control == "c":
        prefix = identifier_of(run.pair.name) if name is None else name
        text = table_header(found.table, lines, name=prefix)
    elif control in ("twincat", "beckhoff"):
        text = table_formats.twincat(found.table, lines, name or run.pair.name)
    else:
        text = table_formats.csv(found.table) if control == "csv" else dumps(record) + "\n"
    return text, record, shown


def _check_options(
    out: Path, control: str | None, suffix: str, quantity: QuantityName, *, overwrite: bool
) -> None:
    kind = f"a {suffix} file" if control is None else f"--for {control}"
    if control is not None and quantity != "error":
        raise UsageError(f"{kind} writes the error; leave out --quantity {quantity}.")
    if control is None:
        refuse_out(out, ".csv", ".json", ".h", overwrite=overwrite)
        takes_no("without --for this export", *_PLACE)
        if quantity == "error" and suffix == ".h":
            raise UsageError(
                "this C header contains the backlash and the shift; write the transmission error to"
                " .csv or .json, or the error table of an axis with --for c.",
                where=str(out),
            )
        kind = "--quantity error" if quantity == "error" else kind
    refuse_existing(out, overwrite=overwrite)
    others = {option for options in _OPTIONS.values() for option in options}
    takes_no(kind, *others.difference(_OPTIONS[kind]))
    if given({"servo_period_ms"}) and not given({"acceleration_deg_s2"}):
        raise UsageError("--servo-period-ms needs --acceleration-deg-s2; give both.")
    if len(given({"gap", "constant_backlash_deg"})) == 2:
        raise UsageError(
            "--gap is that of the draws, which have a constant backlash of their own; leave out"
            " --constant-backlash-deg."
        )


def _maps(
    run: Run, constant_backlash_deg: float | None, quantity: QuantityName
) -> "tuple[BacklashMap, FlankModel]":
    """Return the backlash map of the fit, and its flank model.

    **Raises** the error of what makes the export impossible: a log at one speed if the user gave
    neither a delay nor its limit; the shift needs a pair that closes the gap by it.
    """
    from ...control.compensation.compensation import closing_of, require_closing
    from ...identify.backlash import contact_map

    found = contact_map(run.fit, constant_backlash_deg=constant_backlash_deg)
    if constant_backlash_deg is None:
        is_open = any(one.slug == "delay-open" for one in run.fit.findings)
        request = run.fit.request
        # The constant backlash of a log at one speed may contain the effect of an unknown delay.
        if is_open and not (request and request.settings.delay_within_ms is not None):
            raise UsageError(
                "a controller would take this map for the backlash, but the log has one speed, at"
                " which a delay between the channels looks the same; fit again with --delay (such"
                " as 0.5ms) if you know the delay or --delay-within if you know its limit, or give"
                " --constant-backlash-deg."
            )
    if quantity == "shift":
        require_closing(closing_of(run.pair))
    return found
