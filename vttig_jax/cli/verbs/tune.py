"""`vttig tune`: optimise the settings of a controller over all cases of a sweep."""

import re
from pathlib import Path
from typing import Literal

import click
import tomli_w

from ...base.errors import UsageError
from ...base.files.run_folder import write_files
from ..options import Finite, KeyValue, need, refuse_existing, verb
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
@click.argument("scenario", metavar="SWEEP", type=click.Path(path_type=Path))
@click.option(
    "--free",
    "free",
    type=KeyValue("key[=low:high]", _range, optional=True),
    multiple=True,
    help="Key to tune, such as judgement.margin_mm, with limits if need be; repeatable. By default"
    " all that the controller of SWEEP is set by.",
)
@click.option(
    "--objective",
    type=click.Choice(ObjectiveName.__args__),
    default="expected",
    help="Mean over the cases (the default), or the worst of them.",
)
@click.option(
    "--interference-weight",
    type=Finite(min=0),
    default=10.0,
    show_default=True,
    help="Degrees of gap left that one degree of closing too far is worth.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="TOML to write beside SWEEP, with the new values.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that exists.")
def command(
    output: Output,
    scenario: Path,
    free: tuple[tuple[str, tuple[float, float] | None], ...],
    objective: ObjectiveName,
    interference_weight: float,
    out: Path | None,
    overwrite: bool,
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
    _check_out(scenario, out, overwrite=overwrite)
    keys = [key for key, _ in free] or None
    limits = {key: ends for key, ends in free if ends is not None}
    _check_keys(scenario, keys, limits)
    prepare(None)
    from ...control.scenario.spec import spec_table
    from ...control.tuning.tune import STEPS
    from ...runs.simulations import tune

    with output.progress(len(STEPS), "tune") as bar:
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


def _check_out(scenario: Path, out: Path | None, *, overwrite: bool) -> None:
    """Raise `UsageError`, before the search, for a file that could not be written after it."""
    need("out", "overwrite")
    if out is None:
        return
    if out.suffix.lower() != ".toml":
        raise UsageError("--out writes TOML; choose a name that ends with .toml.", where=str(out))
    if out.resolve().parent != scenario.resolve().parent:
        raise UsageError(
            "the paths in SWEEP are relative to its folder; name an --out in that folder.",
            where=str(out),
        )
    refuse_existing(out, overwrite=overwrite)


def _check_keys(
    scenario: Path, keys: list[str] | None, limits: dict[str, tuple[float, float]]
) -> None:
    """Raise `UsageError` for keys or limits of `--free` that cannot be tuned in this sweep."""
    from ...control.scenario.spec import load_sweep_spec
    from ...control.tuning.tune import SETTINGS, free_keys

    spec = load_sweep_spec(scenario)
    if spec.controller not in SETTINGS:
        return  # `tune` raises this error and names the file
    try:
        free_keys(spec, keys, limits)
    except ValueError as error:
        said = re.sub(r"^Argument `(free|limits)`:? ?", "", str(error))
        raise UsageError(said, where="--free") from None
