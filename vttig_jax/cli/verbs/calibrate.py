"""`vttig calibrate`: check that 95 % intervals contain the truth in 95 % of simulated rigs."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...base.errors import NoAnswerError, UsageError
from ...base.logger import LOGGER
from ..options import verb
from ..output import Output

if TYPE_CHECKING:
    from ...posterior.calibration.calibrate import Calibration
    from ...posterior.calibration.scenarios import Length

_NAMES = (
    "white",
    "ar_1ms4",
    "ar_4ms75",
    "ar_25ms",
    "orders",
    "encoders",
    "counts",
    "one_direction",
    "missing_order",
    "encoders_left_out",
)
"""Names of the scenarios in `posterior.calibration.scenarios`. They are repeated here, because that
module imports JAX; a test compares both."""

_FEWEST = 20
_MOST_RIGS = 1_000_000  # largest number of rigs, as all results stay in memory; chosen value

_LENGTHS: dict[str, list["Length"]] = {
    "short": ["short"],
    "long": ["long"],
    "both": ["short", "long"],
}


@verb(
    "calibrate",
    example="""
vttig calibrate
vttig calibrate --scenario ar_4ms75 --scenario missing_order --rigs 500 --short
vttig calibrate --scenario encoders --rigs 400 --posterior 100 --out calibration
""",
)
@click.option(
    "--scenario",
    "names",
    type=click.Choice(_NAMES),
    multiple=True,
    help="Repeatable; all by default.",
)
@click.option(
    "--rigs",
    type=click.IntRange(_FEWEST, _MOST_RIGS),
    default=2000,
    show_default=True,
    help="Drawn and fitted in every scenario.",
)
@click.option("--short", "length", flag_value="short", help="Two turns of the driven shaft only.")
@click.option("--long", "length", flag_value="long", help="21 turns of the driving shaft only.")
@click.option("--both", "length", flag_value="both", default=True, help="Both, the default.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option(
    "--posterior",
    type=click.IntRange(min=0),
    default=0,
    help="How many of the rigs are sampled too; a few seconds each.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder for calibration.json.")
@click.option("--overwrite", is_flag=True, help="Replace the calibration in that folder.")
def command(
    output: Output,
    names: tuple[str, ...],
    rigs: int,
    length: str,
    seed: int,
    posterior: int,
    out: Path | None,
    overwrite: bool,
) -> None:
    """Say whether stated uncertainties hold, on rigs whose truth is known.

    Draws rigs from a prior, logs them through the exact kinematics, fits all of them, and counts
    how often the intervals hold the truth. Scenarios with a wrong model must be seen to fail. Exit
    code 4 where a right one fails or a wrong one passes.
    """
    if overwrite and out is None:
        raise UsageError("--overwrite is for the folder of --out, which is missing.")
    if posterior > rigs:
        raise UsageError(f"--posterior {posterior} is more than --rigs {rigs}; lower it.")
    chosen = list(dict.fromkeys(names or _NAMES))
    lengths = _LENGTHS[length]
    if out is None:
        found = _calibrated(
            output, names=chosen, lengths=lengths, rigs=rigs, seed=seed, posterior=posterior
        )
    else:
        found = _written(
            out,
            overwrite,
            lambda: _calibrated(
                output, names=chosen, lengths=lengths, rigs=rigs, seed=seed, posterior=posterior
            ),
        )
    output.emit(found.to_json(), found)
    if not found.is_calibrated:
        raise NoAnswerError(found.sentence, where="calibration")


def _calibrated(
    output: Output, names: list[str], lengths: list["Length"], rigs: int, seed: int, posterior: int
) -> "Calibration":
    import vttig_jax

    from ...posterior.calibration.calibrate import calibrate
    from ...posterior.calibration.scenarios import SCENARIOS

    vttig_jax.enable_x64()
    cases: list[Any] = [SCENARIOS[name].of_length(one) for one in lengths for name in names]
    sampled = f", {posterior} of them sampled too" if posterior else ""
    output.narrate(f"to run: {len(cases)} times {rigs} rigs{sampled}; Ctrl-C ends it")
    with output.progress((rigs + posterior) * len(cases), "rigs") as bar:

        def progress(case: str, done: int) -> None:
            bar.set_postfix_str(case, refresh=False)
            bar.update(done)

        return calibrate(cases, rigs=rigs, seed=seed, posterior=posterior, progress=progress)


def _written(out: Path, overwrite: bool, make: Any) -> "Calibration":
    """Compute a calibration with `make()`, write it to the folder `out`, and return it.

    A folder that must not be overwritten is refused before the computation.
    """
    from ...base.files.json_io import dumps
    from ...base.files.run_folder import RunFolder

    with RunFolder(out, overwrite=overwrite, results=("calibration.json",)) as folder:
        found = make()
        folder.write_text("calibration.json", dumps(found.to_json()) + "\n")
    LOGGER.info("written to %s", out)
    return found
