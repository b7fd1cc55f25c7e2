"""`vttig tune`: optimise the settings of a controller over all cases of a sweep."""

from pathlib import Path
from typing import Annotated, Literal

import tomli_w

from ...base.errors import UsageError
from ...base.files.run_folder import write_files
from ..options import Argument, NotNegative, arguments_as_options, key_value, need, refuse_out, verb
from ..output import Output
from .sweep import prepare

ObjectiveName = Literal["expected", "worst"]


def _range(key: str, text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        cause = "is not of the form key=low:high, two numbers."
        raise ValueError(f"'{key}={text}' {cause}") from None
    return low, high


@verb(
    "tune",
    example="""
vttig tune sweep.toml
vttig tune sweep.toml --free judgement.margin_mm --free judgement.bandwidth_hz=5:60
vttig tune sweep.toml --objective worst --out tuned.toml
""",
)
def command(
    output: Output,
    *,
    scenario: Annotated[Path, Argument("SWEEP")],
    free: Annotated[
        tuple[tuple[str, tuple[float, float] | None], ...],
        key_value("key[=low:high]", _range, optional=True),
        "Key to tune, such as judgement.margin_mm, with limits if need be; repeatable. By default"
        " all that the controller of SWEEP is set by.",
    ],
    objective: Annotated[
        ObjectiveName, "Mean over the cases (the default), or the worst of them."
    ] = "expected",
    interference_weight: Annotated[
        NotNegative,
        {"show_default": True},
        "Degrees of gap left that one degree of closing too far is worth.",
    ] = 10.0,
    out: Annotated[Path | None, "TOML to write beside SWEEP, with the new values."],
    overwrite: Annotated[bool, "Replace a file that exists."],
) -> None:
    """Tune the controller of SWEEP (TOML) for all cases of its axes.

    Minimises the backlash left at the turn plus the weighted interference over speeds, turns, and
    rigs drawn from a posterior where SWEEP has rig = { from = "RUN", draws = 200 }. With several
    settings the search begins where a differential evolution ends; simplexes that shrink follow.
    The search is judged by up to 256 cases, its end by all of them, as `vttig sweep` has them, and
    values that are not better are not taken. For the controller feedforward, which moves no gear,
    it minimises the lost motion over the gap that the motor makes up for
    (map.constant_backlash_deg).
    """
    need("out", "overwrite")
    if out is not None:
        refuse_out(out, ".toml", overwrite=overwrite)
        if out.resolve().parent != scenario.resolve().parent:
            raise UsageError(
                "the paths in SWEEP are relative to its folder; name an --out in that folder.",
                where=str(out),
            )
    keys = [key for key, _ in free] or None
    limits = {key: ends for key, ends in free if ends is not None}
    prepare(None)
    from ...control.scenario.spec import spec_table
    from ...control.tuning.tune import STEPS
    from ...runs.simulations import tune

    with output.progress(len(STEPS), "tune") as bar, arguments_as_options({"limits": "--free"}):
        found = tune(
            scenario,
            free=keys,
            limits=limits,
            objective=objective,
            interference_weight=interference_weight,
            progress=bar.reach,
        )
    if out is not None:
        write_files({out: tomli_w.dumps(spec_table(found.spec))}, overwrite=overwrite)
    output.emit(found.to_json(), found if out is None else f"{found}\nwritten to {out}")
