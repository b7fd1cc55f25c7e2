"""`vttig export`: backlash or transmission error for a controller, as CSV, JSON or a C header."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click

import vttig_jax

from ...base.errors import UsageError, VttigError
from ...base.files.json_io import dumps
from ...base.logger import LOGGER
from ...base.units import ARCSEC, DEG
from ...control.scenario.axes import Gap
from ...runs.map_table import columns_of, csv_text, map_record, map_table, resolution, shift_first
from ...runs.run import Run
from ...runs.run_file import CHECKPOINT
from ..axis_options import AXIS, axis_options
from ..options import POSITIVE, STEP_DEG, Finite, given, refuse_existing, verb
from ..output import Output
from .map import MOST_ROWS, QuantityName

if TYPE_CHECKING:
    from ...control.compensation.compensation import Compensation
    from ...identify.result import Fit
    from ...kinematics.backlash_map import BacklashMap
    from ...kinematics.flank_model import FlankModel

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
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="File to write: .csv the map as a table, .json its harmonics (of the error: the table), .h"
    " C that evaluates them. With --for any name.",
)
@click.option(
    "--for",
    "control",
    type=click.Choice(CONTROLS),
    help="Write the error table of the axis for a control: what it adds to the command in each"
    " direction, in degrees at equidistant positions. LinuxCNC reads it as COMP_FILE, TwinCAT as"
    " constants of Structured Text (beckhoff is the same); c is a header with a function for each"
    " direction.",
)
@axis_options
@click.option(
    "--over",
    "over_deg",
    nargs=2,
    type=Finite(),
    metavar="FROM TO",
    help="Travel of the axis, °, if it is not that of the table: what is left is predicted for it."
    " A control holds the ends of its table.",
)
@click.option(
    "--acceleration-deg-s2",
    type=POSITIVE,
    help="With --for linuxcnc: MAX_ACCELERATION; prints the largest speed that follows the table.",
)
@click.option(
    "--servo-period-ms", type=POSITIVE, default=1.0, help="With --for linuxcnc: its servo period."
)
@click.option(
    "--name",
    help="With .h and --for c: what all names in C begin with, with --for twincat what follows"
    " axis_; made from the name of the pair by default.",
)
@click.option(
    "--quantity",
    type=click.Choice(get_args(QuantityName)),
    help="With .h: axial shift and backlash (the default), or the backlash alone. With .csv and"
    " .json: the backlash (the default), the same with the axial shift as the first column, or the"
    " transmission error of each measured flank.",
)
@click.option(
    "--tolerance-arcsec",
    type=Finite(min=0),
    help="How far readings may put the driven shaft off its flanks, its speed times the time"
    " between both readings included; by default six times the residual of the fit, 360 at least.",
)
@click.option(
    "--accuracy-arcsec",
    type=Finite(min=0),
    default=0.0,
    help="Backlash that the harmonics left out may add up to; more leaves fewer to evaluate. By"
    " default only those below 1e-12 rad are left out.",
)
@click.option(
    "--step-deg",
    type=STEP_DEG,
    help="Of a table: distance of the rows, 1 by default. With --for: distance of the positions,"
    " the 255th part of the travel by default.",
)
@click.option("--constant-backlash-deg", type=Finite(min=0), help="Replaces the fitted one.")
@click.option(
    "--gap",
    type=click.Choice(get_args(Gap)[1:]),
    help="With .h and .json, after `vttig sample`: the mean gap, lowered until it is nowhere above"
    " this edge of its band. The table of `vttig map` has the edge itself as a column.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that exists.")
def command(
    output: Output,
    run_folder: Path,
    out: Path,
    control: str | None,
    axis: dict[str, Any],
    over_deg: tuple[float, float] | None,
    acceleration_deg_s2: float | None,
    servo_period_ms: float,
    name: str | None,
    quantity: QuantityName | None,
    tolerance_arcsec: float | None,
    accuracy_arcsec: float,
    step_deg: float | None,
    constant_backlash_deg: float | None,
    gap: str | None,
    overwrite: bool,
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
    from ...control.compensation.map_harmonics import compensation_of
    from ...runs.error_table import origin
    from ...runs.maps import lowered_map

    suffix = out.suffix.lower()
    quantity = quantity or ("error" if control else "shift" if suffix == ".h" else "backlash")
    opened = Run(run_folder)
    opened.refuse_own([out])
    _check_options(out, control, suffix, quantity, overwrite=overwrite)
    step, fit = step_deg or 1.0, opened.fit
    if control is not None:
        rate = acceleration_deg_s2, servo_period_ms
        axis |= {"over_deg": over_deg}
        text, record, shown = _axis_table(opened, out, control, axis, step_deg, rate, name)
    elif quantity == "error":
        text, record, shown = _error(opened, out, step)
    else:
        shift = quantity == "shift"
        grid, contact = _maps(opened, constant_backlash_deg, header=suffix == ".h", shift=shift)
        lowered = None
        if gap is not None:
            grid, distance = lowered_map(opened, gap)
            lowered = gap, distance / DEG
        if suffix == ".csv":
            text, record, shown = _table(fit, grid, step, out, quantity)
        else:
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
                "constant_backlash_deg": interval
                and dict(zip(("low95", "high95"), interval, strict=True)),
                **compensation.to_json(),
            }
            shown = str(compensation)
            if lowered is not None:
                record |= {"gap": gap, "lowered_deg": lowered[1]}
            text = dumps(record) + "\n"
            if suffix == ".h":
                text = _header(opened, compensation, name, interval, lowered, shift=shift)
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
    axis: dict[str, Any],
    step_deg: float | None,
    rate: tuple[float | None, float],
    name: str | None,
) -> tuple[str, dict[str, Any], str]:
    """Return the error table of the axis for a control, its record, and its report."""
    from ...control.compensation import table_formats
    from ...control.compensation.c_header import identifier_of, table_header
    from ...runs.axis_table import AxisSetting, axis_table

    found = axis_table(run.fit, run.drawn, AxisSetting(**axis), step_deg)
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
    if kind not in _OPTIONS:
        raise UsageError(
            "--out writes .csv, .json or .h; choose a name that ends with one.", where=str(out)
        )
    if control is None and quantity == "error":
        if suffix == ".h":
            raise UsageError(
                "this C header contains the backlash and the shift; write the transmission error to"
                " .csv or .json, or the error table of an axis with --for c.",
                where=str(out),
            )
        kind = "--quantity error"
    others = {option for options in _OPTIONS.values() for option in options}
    if wrong := given(sorted(others.difference(_OPTIONS[kind]))):
        only = ", which need --for," * bool(given(_PLACE) and control is None)
        raise UsageError(f"{kind} takes no {' and no '.join(wrong)}{only}; leave it out.")
    if given({"servo_period_ms"}) and not given({"acceleration_deg_s2"}):
        raise UsageError("--servo-period-ms needs --acceleration-deg-s2; give both.")
    if len(given({"gap", "constant_backlash_deg"})) == 2:
        raise UsageError(
            "--gap is that of the draws, which have a constant backlash of their own; leave out"
            " --constant-backlash-deg."
        )
    refuse_existing(out, overwrite=overwrite)


def _maps(
    run: Run, constant_backlash_deg: float | None, *, header: bool, shift: bool
) -> "tuple[BacklashMap, FlankModel]":
    """Return the backlash map of the fit, and its flank model.

    If the export is impossible, one error names all reasons.

    **Arguments**
    - `header`: whether a C header is written, which needs the readings of both encoders.
    - `shift`: whether the header gives the axial shift that closes the gap.
    """
    from ...control.compensation.compensation import closing_of, require_closing
    from ...identify.backlash import contact_map
    from ...runs.zeros import shaft_readings

    fit = run.fit
    found: list[tuple[BacklashMap, FlankModel]] = []
    checks: list[Callable[[], object]] = [
        lambda: found.append(contact_map(fit, constant_backlash_deg=constant_backlash_deg))
    ]
    if constant_backlash_deg is None:
        checks.append(lambda: _require_delay(fit))
    if header:
        checks.append(lambda: shaft_readings(run.record, fit))
    if shift:
        checks.append(lambda: require_closing(closing_of(fit.pair)))
    _require_all(checks, run.folder)
    return found[0]


def _require_all(checks: Sequence[Callable[[], object]], folder: Path) -> None:
    """Call all `checks`; if some of them raise errors, raise one error with all their messages."""
    failed: list[VttigError] = []
    for check in checks:
        try:
            check()
        except VttigError as error:
            failed.append(error)
    if not failed:
        return
    gravest = type(max(failed, key=lambda error: error.exit_code))
    reasons = [error.message.removesuffix(".") for error in failed]
    if len(failed) > 1:
        reasons = [f"({number}) {reason}" for number, reason in enumerate(reasons, 1)]
        reasons[0] = f"{len(failed)} things are in the way: {reasons[0]}"
    raise gravest("; ".join(reasons) + ".", where=failed[0].where or str(folder))


def _require_delay(fit: "Fit") -> None:
    """Refuse a fit whose constant backlash may contain the effect of an unknown delay.

    **Raises** `UsageError` for a log at one speed if the user gave neither a delay nor its limit.
    """
    is_open = any(one.slug == "delay-open" for one in fit.findings)
    if not is_open or (fit.request and fit.request.settings.delay_within_ms is not None):
        return
    raise UsageError(
        "a controller would take this map for the backlash, but the log has one speed, at which a"
        " delay between the channels looks the same; fit again with --delay (such as 0.5ms) if you"
        " know the delay or --delay-within if you know its limit, or give --constant-backlash-deg."
    )


def _error(run: Run, out: Path, step_deg: float) -> tuple[str, dict[str, Any], str]:
    """Return the transmission error of each flank as CSV or JSON, its record, and its report."""
    from ...runs.error_table import error_table

    turns = _whole_period(run.pair.hunting_turns, step_deg)
    found = error_table(run.fit, run.drawn, step_deg, turns)
    record, table = found.to_json(out), found.table()
    if out.suffix.lower() == ".csv":
        return csv_text(table, found.columns), record, str(found)
    record["table"] = dict(zip(found.columns, table.T, strict=True))
    return dumps(record) + "\n", record, str(found)


def _table(
    fit: "Fit", grid: "BacklashMap", step_deg: float, out: Path, quantity: QuantityName
) -> tuple[str, dict[str, Any], str]:
    """Return the map over the hunting period as CSV, its record `vttig.map/1`, and its report."""
    turns = _whole_period(grid.pair.hunting_turns, step_deg)
    table, columns = map_table(grid, step_deg, turns), columns_of(grid)
    if quantity == "shift":
        table, columns = shift_first(table, columns, grid.pair)
    record = map_record(fit, grid=grid, step_deg=step_deg, turns=turns, rows=len(table), out=out)
    return csv_text(table, columns), record | {"quantity": quantity}, str(grid)


def _whole_period(hunting_turns: int, step_deg: float) -> float:
    """Return the driving turns of the hunting period.

    **Raises** `UsageError` for a step that gives too many rows.
    """
    if hunting_turns * 360.0 / step_deg > MOST_ROWS:
        least = math.ceil(hunting_turns * 360 / MOST_ROWS * 100) / 100
        raise UsageError(
            f"a hunting period of {hunting_turns} turns in steps of {step_deg:g}° is more than"
            f" {MOST_ROWS} rows; give --step-deg {least:g} or more."
        )
    return float(hunting_turns)


def _header(
    run: Run,
    compensation: "Compensation",
    name: str | None,
    interval: tuple[float, float] | None,
    lowered: tuple[str, float] | None,
    *,
    shift: bool,
) -> str:
    from ...control.compensation.c_header import HeaderOrigin, c_header, identifier_of
    from ...runs.zeros import shaft_readings

    fit = run.fit
    name = identifier_of(fit.pair.name) if name is None else name
    origin = HeaderOrigin(
        pair=fit.pair.name,
        version=vttig_jax.__version__,
        zero=fit.zero,
        conditional_on=fit.conditional_on,
        sha256=fit.sha256,
        readings=shaft_readings(run.record, fit),
        backlash_deg=interval,
        lowered_deg=lowered,
    )
    return c_header(compensation, origin, name=name, quantity="shift" if shift else "backlash")
