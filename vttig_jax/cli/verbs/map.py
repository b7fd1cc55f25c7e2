"""`vttig map`: backlash or transmission error at every driving angle, from a run folder."""

import shlex
from pathlib import Path
from typing import Annotated, Any

from ...base.errors import NoAnswerError, UsageError
from ...base.files.json_io import dumps, read_json
from ...base.logger import LOGGER
from ...runs.map_table import QuantityName, csv_text, resolution, run_table
from ...runs.run import Run
from ..options import (
    MOST_ROWS,
    Argument,
    ConstantBacklash,
    Finite,
    Positive,
    StepDeg,
    given,
    require_rows,
    takes_no,
    verb,
)
from ..output import Output

_MOST_ASKED = 20_000_000
_NO_NOISE = "These values do not contain the noise of the fit: draws of `vttig sample` add bands"
_NO_BAND = (
    f"{_NO_NOISE}, the interval of the smallest backlash, and how probable it is that a closing"
    " binds."
)
_NO_ERROR_BAND = f"{_NO_NOISE} and the interval of the peak-to-peak value."


@verb(
    "map",
    example="""
vttig map run --step-deg 0.5 --out map.csv
vttig map run --quantity error --out error.csv
""",
)
def command(
    output: Output,
    *,
    run_folder: Annotated[Path, Argument("D")],
    quantity: Annotated[
        QuantityName,
        "Backlash (the default), the axial shift that closes it as the first column, or the"
        " transmission error of each measured flank.",
    ] = "backlash",
    step_deg: StepDeg = 1.0,
    span_rev: Annotated[
        Positive | None,
        "Driving turns to cover; the hunting period by default, 200 000 rows at most.",
    ],
    constant_backlash_deg: ConstantBacklash,
    probability: Annotated[
        float,
        Finite(min=0, max=1, min_open=True, max_open=True),
        "Of the bands that draws of `vttig sample` in D give; 0.95 by default.",
    ] = 0.95,
    closing_mm: Annotated[
        tuple[Positive, ...],
        "With draws: say how probable it is that this axial closing binds somewhere; repeatable.",
    ],
    out: Annotated[Path | None, "CSV to write, with a JSON beside it."],
    overwrite: Annotated[bool, "Replace files that exist."],
) -> None:
    """Show the backlash of the fit in run folder D over the hunting period, and write it.

    The hunting period is the number of driving turns until the same teeth meet again. The CSV file
    contains the backlash with all fitted orders in degrees of the driven gear, in mm at its
    reference circle and in mm of axial displacement, and the first-order backlash. If D contains
    draws of `vttig sample`, it also contains two bands: one for each single angle, and one for the
    whole map at once. The report says which part of the hunting period the log covered on both
    flanks; the rest is extrapolated by the fitted orders. The JSON object lists the covered spans.

    With --quantity error, the CSV file contains the transmission error of each measured flank, also
    of a log of one direction, and the report its peak-to-peak value and rms.
    """
    if quantity == "error":
        takes_no("--quantity error", "closing_mm", "constant_backlash_deg")
    stored = read_json(run_folder / "fit.json")  # before the work; `Run` says if it is damaged
    flanks = stored.get("flanks") if isinstance(stored, dict) else None
    if quantity != "error" and constant_backlash_deg is None and flanks in (["A"], ["B"]):
        raise NoAnswerError(
            f"only flank {flanks[0]} was measured, which shows no backlash; `vttig map"
            f" {shlex.quote(str(run_folder))} --quantity error` shows its transmission error, and"
            " for gears of known teeth --constant-backlash-deg states a backlash that was measured"
            " in another way.",
            where=str(run_folder),
        )
    run = Run(run_folder)
    fit = run.fit
    turns = _span(run.pair.hunting_turns, step_deg, span_rev)
    posterior = run.drawn if constant_backlash_deg is None else None
    if posterior is None and (asked := given({"closing_mm", "probability"})):
        if constant_backlash_deg is not None:
            raise UsageError(
                f"{asked[0]} asks the draws, which hold a constant backlash of their own; leave out"
                " --constant-backlash-deg."
            )
        cure = f"make them with `vttig sample {run_folder}`"
        raise UsageError(f"{asked[0]} needs draws; {cure}.", where=str(run_folder))
    found = run_table(
        fit,
        quantity,
        step_deg,
        turns,
        posterior=posterior,
        constant_backlash_deg=constant_backlash_deg,
        probability=probability,
        closing_mm=closing_mm,
        out=out,
    )
    record: dict[str, Any] = found.record | {"run": run.record.digest}
    shown = found.text
    if posterior is None:
        shown += f"\n\n{_NO_ERROR_BAND if quantity == 'error' else _NO_BAND}"
    elif quantity != "error":
        for one in record["binding"]:
            shown += "\n  a closing of {closing_mm:g} mm binds with probability".format(**one)
            shown += " {probability:.3g} ± {std_error:.1g}".format(**one)
    if out is not None:
        texts = {out.with_suffix(".json"): dumps(record) + "\n", out: csv_text(found.columns)}
        run.write_beside(texts, overwrite=overwrite)
        shown = f"{shown}\n\n{out}: {resolution(fit, step_deg)}"
    else:
        rows = len(found.columns["driving_deg"])
        shown = f"{shown}\n\nno file is written; `--out map.csv` writes the map, {rows} rows"
    output.emit(record, shown)


def _span(hunting_turns: int, step_deg: float, span_rev: float | None) -> float:
    limit = MOST_ROWS * step_deg / 360.0
    if span_rev is not None:
        require_rows(span_rev, step_deg, _MOST_ASKED)
        return span_rev
    if hunting_turns > limit:
        LOGGER.warning(
            "the hunting period of %d turns is cut to %.4g turns (%d rows); --span-rev %d covers it"
            " all",
            hunting_turns,
            limit,
            MOST_ROWS,
            hunting_turns,
        )
    return min(float(hunting_turns), limit)
